"""The two lines that a run prints, against an account that watches the simulation from outside."""

import io
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, strategies as st
from rich.console import Console

from hapnet import cli
from hapnet.commands import output
from hapnet.params import Params
from hapnet.simulation.simulation import Simulation
from hapnet.summary.servos import milli_above, milli_up
from hapnet.summary.structure import read
from hapnet.summary.tables import felt_line, summary_text
from tests.conftest import mostly_slow
from tests.support.independent_account import Witness, account

Capture = pytest.CaptureFixture[str]
SENTENCE = r"(PASSIVE): gave out at most ([0-9.]+) mJ of the 150 mJ allowed|(NOT PASSIVE): gave out ([0-9.]+) mJ, more"


def lines(summary: dict[str, Any], *, verbose: bool = False) -> list[str]:
    out = io.StringIO()
    console = Console(file=out, width=400, soft_wrap=True)
    output.show_verdict(console, summary, verbose=verbose)
    if not verbose:
        output.show_fact(console, summary, "More: -v")
    return out.getvalue().splitlines()


LOOSE = {
    "rendering": "paper",
    "operator_model.stiffness": 10.0,
    "operator_model.damping": 0.1,
    "device.stiffness": 1000.0,
}


@pytest.mark.parametrize(
    ("coupling", "link", "hand", "more", "passive"),
    mostly_slow(
        [
            ("pspm", "delay 150ms 50ms loss 10%", "sine", {"operator_model.amplitude_m": 0.06}, True),
            ("pspm", "delay 150ms", "hand-2", {"device.stiffness": 1500.0}, True),
            ("zoh", "delay 150ms", "sine", LOOSE, False),
        ],
        1,
    ),
)
def test_both_lines_have_the_numbers_of_an_independent_account(
    coupling: str, link: str, hand: str, more: dict[str, object], passive: bool
) -> None:
    """Energies of forces and ways that were watched; two springs and a wall in a row."""
    changes: dict[str, object] = {"coupling": coupling, "link.up": link, "link.down": link, "duration_s": 8.0}
    changes |= {"operator": hand, "device.servo": "sampled", "device.substeps": 1, **more}
    simulation = Simulation(Params().set(changes), 4, kernel=False)
    params = simulation.setup.params
    witness = Witness(simulation)
    summary: Any = simulation.run().summary
    first, second = lines(summary)
    found = re.match(SENTENCE, first)
    assert found is not None, first
    assert (found[1] == "PASSIVE") == passive == (summary["verdict"]["passive"] is True)
    K, K_v, K_w = params.device.stiffness, params.world.stiffness, params.world.wall.stiffness
    least = account(witness).both_least
    assert least is not None
    out_mJ = 1e3 * (params.device.ceiling_J + params.world.ceiling_J - least)
    assert out_mJ > 0.05
    shown_mJ = float(found[2] or found[4])
    if passive:
        assert out_mJ - 1e-6 <= shown_mJ <= out_mJ + 0.1
    else:
        assert shown_mJ == pytest.approx(out_mJ, rel=1e-3)
        assert shown_mJ > 150.0
    limit = " of the 600 N/m that this device can render"  # 2 b/T, unless K is stiffer than that
    wall = re.fullmatch(rf"The wall of ([0-9]+) N/m felt like ([0-9.]+)(?: N/m|{limit})\. More: -v", second)
    assert wall is not None, second
    assert float(wall[1]) == K_w
    assert float(wall[2]) == pytest.approx(1.0 / (1.0 / K + K_v / (K * K_w)), rel=0.005)


@given(st.floats(1e-7, 1.0), st.floats(0.0, 1.0))
def test_the_energy_is_rounded_upwards_and_stays_within_what_is_allowed(allowed_J: float, share: float) -> None:
    energy_J = share * allowed_J
    shown = float(milli_up(energy_J, allowed_J))
    assert shown <= float(f"{1e3 * allowed_J:.4g}")
    assert shown >= 1e3 * energy_J * (1.0 - 1e-3) - 1e-9  # the allowed energy itself has four digits
    assert shown <= 1e3 * energy_J + max(0.1, 1e-5 * allowed_J) + 1e-9


@pytest.mark.parametrize(
    ("energy_J", "shown"), [(0.0, "0"), (0.4259e-3, "0.5"), (12.4e-3, "12.4"), (0.14996, "150"), (2e-9, "0.1")]
)
def test_of_150_mJ(energy_J: float, shown: str) -> None:
    assert milli_up(energy_J, 0.15) == shown


@pytest.mark.parametrize("claimed_J", [1.8e304, 1.8e305, 1.7e308])
def test_a_claim_of_any_size_is_shown(claimed_J: float) -> None:
    """A peer may claim any bound; the verdict on this side's own account must not fail of it."""
    assert float(milli_up(claimed_J, claimed_J)) > 1e300
    assert milli_up(0.0, claimed_J) == "0"


@given(st.floats(1e-9, 0.1))
def test_what_is_above_is_shown_above(beyond_J: float) -> None:
    assert float(milli_above(0.15 + beyond_J, 0.15)) > 150.0


def test_without_a_wall_the_force_counts_and_a_wall_that_was_not_touched_is_said_to_be() -> None:
    moved = {"peak_force_N": 1.5774, "contacts": 0}
    assert felt_line(read({"motion": moved})) == "The largest force was 1.58 N."
    assert felt_line(read({"motion": moved | {"peak_torque_Nm": 0.25}, "units": "pose"})) == (
        "The largest force was 1.58 N and the largest torque 0.25 Nm."
    )
    wall = {"stiffness_N_m": 3000.0, "felt_stiffness_N_m": 171.43}
    assert felt_line(read({"motion": moved, "environment": wall})) == (
        "The wall of 3000 N/m was not touched; it would feel like 171 N/m."
    )
    assert felt_line(read({})) == ""


@pytest.mark.slow
def test_warnings_have_a_line_each_and_figures_come_with_v(tmp_path: Path, capsys: Capture) -> None:
    summary: Any = Simulation(Params().set({"duration_s": 1.0}), 1).run().summary
    summary["device"]["servo"] |= {"overruns": 3, "longest_ms": 27.0}
    short, long = lines(summary), lines(summary, verbose=True)
    assert len(short) == 3
    assert short[2] == "warning: the servo stalled for longer than watchdog_s 3 times, for up to 27 ms"
    assert short[0] in long[0]
    assert "energy came from" not in " ".join(short)
    assert any(line.startswith("margin: the 150 mJ allowed, plus the energy that hand and world") for line in long)
    assert any(line.startswith("tracking error (rms): ") for line in long)
    assert "margin at the end" in " ".join(long)
    files = ["--duration", "0.3", "--out", str(tmp_path)]
    assert cli.main(["simulate", *files]) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[1].endswith(f" More: -v, or hapnet report {tmp_path / 'run.mcap'}")
    assert cli.main(["report", str(tmp_path / "run.mcap")]) == 0
    assert capsys.readouterr().out == out.replace(f"hapnet report {tmp_path / 'run.mcap'}", str(tmp_path / "run.html"))
    assert cli.main(["simulate", "--duration", "0.3", "--no-files"]) == 0
    assert capsys.readouterr().out.splitlines()[1].endswith(" More: -v")
    console = Console(file=io.StringIO())
    console.print(summary_text({}))
