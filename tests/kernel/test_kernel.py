"""The compiled kernel gives what the reference gives, in every covered feature: the same bits."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
import numpy as np
import pytest

from hapnet import cli, simulate_batch
from hapnet.couplings.registry import COUPLINGS
from hapnet.ext.compiled import memory, names, progress, samples, sources, twins
from hapnet.ext.compiled.whole_runs import coverage
from hapnet.params import Params
from hapnet.records import machine_code, vectors
from hapnet.simulation.simulation import Simulation
from tests.conftest import ENVIRONMENT, mostly_slow
from tests.support.kernel_cases import LOSSY, differences, kernel_case
from tests.support.kernel_edges import ONE_AXIS, SEVERAL_AXES
from tests.support.paper import PAPER

ROOT = Path(__file__).resolve().parents[2]
SAMPLED = Params().set({"device.servo": "sampled", "duration_s": 2.0})
LEAVES = "it leaves the range that messages can carry"


def test_numba_is_there() -> None:
    """It is in extra `test`; without it the tests of this file would compare the reference with itself."""
    assert machine_code.no_compiler() is None


@pytest.mark.parametrize("servo", mostly_slow(["sampled", "continuous"], 1))
@pytest.mark.parametrize("seed", mostly_slow(range(6), 3))
def test_one_axis_gives_the_same_bits(seed: int, servo: str) -> None:
    assert not differences(kernel_case(seed, 1, servo), seed)


@pytest.mark.parametrize("seed", mostly_slow(range(100, 104), 1))
def test_several_axes_give_the_same_bits_with_a_held_force(seed: int) -> None:
    assert not differences(kernel_case(seed, 0), seed)


@pytest.mark.parametrize("seed", mostly_slow(range(200, 204), 2))
def test_several_axes_give_the_same_bits_with_the_continuous_servo(seed: int) -> None:
    assert not differences(kernel_case(seed, 0, "continuous"), seed)


def test_energy_that_is_lost_and_sent_again_gives_the_same_bits() -> None:
    assert not differences(LOSSY, 1)


@pytest.mark.parametrize("servo", mostly_slow(["sampled", "continuous"], 1))
@pytest.mark.parametrize("edge", mostly_slow([(one,) for one in ONE_AXIS], 4))
def test_at_the_edges_one_axis_gives_the_same_bits(edge: str, servo: str) -> None:
    params = PAPER.set({"duration_s": 1.2, **ONE_AXIS[edge], "device.servo": servo})
    assert not differences(params, 1)


@pytest.mark.parametrize("edge", SEVERAL_AXES)
def test_at_the_edges_several_axes_give_the_same_bits(edge: str) -> None:
    assert not differences(PAPER.set({"duration_s": 1.2, **SEVERAL_AXES[edge]}), 1)


@pytest.mark.parametrize("servo", ["sampled", "continuous"])
@pytest.mark.parametrize("seed", mostly_slow(range(1000, 1025), 0, 5))
def test_many_cases_give_the_same_bits(seed: int, servo: str) -> None:
    assert not differences(kernel_case(seed, seed % 2, servo, 5.0), seed)


COMPILED = [name for name in COUPLINGS if COUPLINGS[name].compiled is not None]
LAWS = sorted(set(COMPILED) - {"pspm", "zoh"})
ROUGH = {"link.up": "delay 5ms 4ms loss 20% resend 2 3ms unordered limit 4", "link.down": "delay 20ms 10ms reorder 20%"}
OF_LAWS: dict[str, dict[str, Any]] = {
    "over 4g": {"link.up": "4g", "link.down": "4g"},
    "in a box, over a slow link": {
        "scene": "box", "operator": "hand-3", "link.up": "delay 20ms 5ms loss 20% rate 1mbit", "link.down": "wifi",
    },
    "lost, late and again": {"operator": "sine", **ROUGH},
    "with encoders and a limit": {"device.resolution_m": 5e-5, "record_hz": 130.0, "device.force_limit_N": 0.5},
    "as first published": {"rendering": "paper", "wave.recovery_s": 0.0, "tdpa.recovery_s": 0.0, **ROUGH},
    "predicting": {"tdpa.predict": True, "wave.missing": "hold", "link.up": "wifi", "link.down": "wifi"},
    "another servo and three axes": {
        "device.servo_hz": 500.0, "scene": "box", "dof": 3, "operator": "sine", "link.down": "4g", "duration_s": 1.0,
    },
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("case", OF_LAWS)
@pytest.mark.parametrize("coupling", LAWS)
def test_every_law_gives_the_same_bits(coupling: str, case: str) -> None:
    assert not differences(SAMPLED.set({"duration_s": 1.5, "coupling": coupling, **OF_LAWS[case]}), 5)


def test_every_law_is_compiled_on_its_own() -> None:
    """Of the eight that are compiled only PSPM and the plain one are of one kind."""
    kinds = {name: coverage.kind_of(SAMPLED.set({"coupling": name})) for name in COUPLINGS}
    assert [name for name, kind in kinds.items() if kind is not None] == COMPILED
    assert len({kind.name for kind in kinds.values() if kind is not None}) == 7
    assert kinds["pspm"] == kinds["zoh"]


@pytest.mark.parametrize("coupling", ["pspm", "zoh"])
@pytest.mark.parametrize("operator", mostly_slow(["press", "sine", "rest", "hand-4"], 1))
def test_what_studies_compare_by_default_gives_the_same_bits(coupling: str, operator: str) -> None:
    params = SAMPLED.set({"coupling": coupling, "operator": operator, "link.up": "4g", "link.down": "4g"})
    assert not differences(params, 3)


def test_a_study_records_the_motion_alone() -> None:
    one, other = (Simulation(SAMPLED, 2, motion_only=True, kernel=kernel).run() for kernel in (False, True))
    for side in ("device", "world"):
        expected, found = getattr(one.recording, side), getattr(other.recording, side)
        assert list(expected) == list(found)
        assert all(expected[name].tobytes() == found[name].tobytes() for name in expected)


def test_progress_does_not_change_the_result() -> None:
    shares: list[float] = []
    one = Simulation(SAMPLED, 1, kernel=True).run()
    other = Simulation(SAMPLED, 1, kernel=True).run(shares.append)
    assert shares == pytest.approx([0.5, 1.0, 1.5, 2.0])
    assert one.summary == other.summary


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning", "ignore:invalid value:RuntimeWarning")
def test_a_run_that_leaves_the_range_of_messages_goes_to_the_reference() -> None:
    """A device that is too light for its spring, with no limit of force: held for a tick, the spring throws it away.

    A law's force that has neither account nor limits does that; a set-position's guard has an account.
    """
    changes: dict[str, Any] = {
        "coupling": "pd", "device.force_limit_N": 0.0, "device.stiffness": 1e5, "device.mass": 0.001,
        "device.step_limit_N": 0.0, "device.greatest_speed": 1e6,
        "device.own_damping": 0.0, "operator_model.damping": 0.0, "operator_model.mass": 0.0,
    }  # fmt: skip
    params = SAMPLED.set({**changes, "rendering": "paper"})
    assert not differences(params, 1, LEAVES)


@pytest.mark.parametrize(
    ("where", "words"),
    mostly_slow(
        [
            ("link.up", "delay 3s limit 5000"),
            ("link.down", "rate 100kbit limit 5000"),
            ("link.up", "rate 100kbit limit 5000"),
            ("link.down", "delay 3s limit 5000"),
        ],
        1,
        3,
    ),
)
def test_a_run_with_more_on_a_link_than_the_kernel_has_room_for_goes_to_the_reference(where: str, words: str) -> None:
    """At the handshake's end, or later, as a slow line's queue grows."""
    often = {"device.pspm_period_s": 0.001, "world.step_min_s": 0.001, "world.step_max_s": 0.001}
    ideal = {"coupling": "zoh", "duration_s": 3.0, "link.up": "", "link.down": ""}
    simulation = Simulation(SAMPLED.set({**often, **ideal, where: words}), 1, kernel=True)
    simulation.run()
    assert simulation.not_compiled == LEAVES


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"coupling": "tests.support.kernel_cases:MINE"}, "the coupling tests.support.kernel_cases:MINE"),
        ({"coupling": "popc", "rendering": "hapnet"}, "the stages before the coupling popc"),
        ({"scene": "moving"}, "the scene moving"),
        (
            {"scene": "box", "dof": 2, "world.stiffness": [[500.0, 100.0], [100.0, 400.0]]},
            "walls that act on one another",
        ),
        ({"link.up": "delay 5ms slot 10ms"}, "slots in the uplink"),
        ({"link.down_timeline": "at 1s: down"}, "a timeline of the downlink"),
        ({"link.up": "rate 1mbit loss 1% resend 2 1ms unordered"}, "unordered resends before a rate in the uplink"),
        ({"link.up": "delay 5ms limit bytes 5000"}, "a limit in bytes in the uplink"),
        ({"wire.deadband": 0.1}, "a deadband"),
        ({"wire.admission_burst_J": 5.0}, "wire.admission_burst_J above 4"),
    ],
)
def test_says_why_it_does_not_cover_a_run(changes: dict[str, object], reason: str) -> None:
    assert Simulation(SAMPLED.set(changes), kernel=True).not_compiled == reason


def test_a_simulation_that_watches_its_events_is_not_compiled() -> None:
    class Watching(Simulation):
        def hindrance(self, kind: int) -> int:
            return super().hindrance(kind)

    assert Watching(SAMPLED, kernel=True).not_compiled == "Watching watches the events"
    assert Simulation(PAPER, kernel=True).not_compiled is None


def test_a_batch_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "are_compiled", lambda kind: True)
    (run,) = simulate_batch(SAMPLED, [4])
    assert run.not_compiled is None
    assert run.summary == Simulation(SAMPLED, 4, kernel=False).run().summary


def test_machine_code_of_other_sources_does_not_count(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert not sources.are_compiled("one")
    sources.mark("one")
    assert sources.are_compiled("one")
    assert not sources.are_compiled("other")
    assert [path.parent for path in tmp_path.rglob("compiled-*")] == [tmp_path / "cache" / "hapnet"]
    monkeypatch.setattr(sources, "digest", lambda: "another")
    assert not sources.are_compiled("one")
    (tmp_path / "file").write_text("no directory")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    sources.mark("one")  # as where nothing can be written
    assert not sources.are_compiled("one")


@pytest.mark.soak
def test_ends_that_two_processes_compiled_run_in_one(tmp_path: Path) -> None:
    """Numba numbers functions in each process anew; records of other sizes under the same name crashed the third."""
    environment = {**ENVIRONMENT, "XDG_CACHE_HOME": str(tmp_path)}

    def run(code: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen([sys.executable, "-c", code], env=environment)

    make = "from hapnet.ext.compiled import real_time; real_time.make_ready({!r})"
    both = [run(make.format(names.named(names.SERVO, axes))) for axes in (3, 7)]
    assert [process.wait(200.0) for process in both] == [0, 0]
    rows = "from hapnet.ext.bench import registry, row; o = row.Options(seconds=0.1, rounds=1); "
    assert run(rows + "[registry.ROWS[one](o) for one in ('device_tick', 'side_tick_joints')]").wait(100.0) == 0


def test_a_mark_is_there_all_the_time(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Each process that loads a kind marks it, and may be stopped meanwhile: none may empty the file first."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    sources.mark("one")
    (file,) = tmp_path.rglob("compiled-*")
    before = file.stat()
    sources.mark("one")
    assert (file.stat().st_ino, file.stat().st_mtime_ns) == (before.st_ino, before.st_mtime_ns)
    with file.open() as read, monkeypatch.context() as patch:
        patch.setattr(sources, "digest", lambda: "another")
        sources.mark("one")
        assert sources.are_compiled("one")
        assert len(read.read()) == 64  # the former file is whole: a reader that has opened it sees no part of the next
    assert list(tmp_path.rglob("compiled-*")) == [file]


def test_machine_code_of_two_kinds_shares_no_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Two processes that compile at the same time would each overwrite what the other one made."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for name in ("one", "other"):
        length = twins.entry(vectors.dot, name, {}).run
        assert length(2, np.array([3.0, 4.0]), np.array([3.0, 4.0])) == 25.0
    made = [path.name.split("-")[0] for path in tmp_path.rglob("*.nbi")]
    assert sorted(made) == ["vectors.one", "vectors.other"]


@pytest.mark.parametrize("make", [machine_code.compiled, lambda function: twins.entry(function, "one", {}).run])
def test_where_nothing_can_be_kept_nothing_is_written(
    make: Callable[[Any], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numba itself would write beside the package then."""
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nowhere")
    folder = Path(vectors.__file__).parent
    before = set(folder.rglob("*.nb?"))
    length = make(FunctionType(vectors.dot.__code__, vars(vectors), "dot"))
    assert length(2, np.array([3.0, 4.0]), np.array([3.0, 4.0])) == 25.0
    assert set(folder.rglob("*.nb?")) == before


@pytest.mark.slow
def test_where_nothing_can_be_written_machine_code_is_made_for_one_process() -> None:
    """Nor beside the package. A handle is the kind that takes the compiler least time."""
    run = "from hapnet.ext.compiled import names, real_time; real_time.make_ready(names.HANDLE)"
    before = set((ROOT / "hapnet").rglob("*.nb?"))
    environment = os.environ | {"XDG_CACHE_HOME": "/proc/nowhere"}
    subprocess.run([sys.executable, "-c", run], cwd=ROOT, env=environment, check=True)
    assert set((ROOT / "hapnet").rglob("*.nb?")) == before


@pytest.mark.parametrize(("missing", "has_room"), [((1, 1), True), ((0, 1), False), ((1, 0), False)])
def test_a_kernel_stops_when_either_side_has_no_room_for_another_sample(
    missing: tuple[int, int], has_room: bool
) -> None:
    """What it writes beyond that would be another record's memory."""
    rows = memory.new(samples.Rows)
    rows.device_rows, rows.world_rows = (samples.MOST - one for one in missing)
    assert samples.have_room(rows) == has_room


def test_the_compiler_tells_how_far_it_is() -> None:
    """Each function that it compiles, and the end; of what is compiled already it reports nothing."""
    shares: list[float] = []
    double: Any = numba.njit(lambda x: 2 * x)
    token = progress.reported.set(shares.append)
    try:
        with progress.reporting(4):
            assert double(3) == 6
        assert shares == [0.25, 1.0]
        with progress.reporting(4):
            assert double(4) == 8
        assert len(shares) == 2
    finally:
        progress.reported.reset(token)


def test_without_numba_the_reference_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine_code, "find_spec", lambda name: None)
    simulation = Simulation(SAMPLED.set({"duration_s": 0.2}), 1)
    assert simulation.not_compiled == "numba is not installed (extra fast)"
    assert simulation.run().summary["theorem"]["margin_J"] > 0.0
    assert Simulation(SAMPLED, 1, kernel=True).not_compiled == "numba is not installed (extra fast)"


def test_with_numbas_own_switch_the_reference_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    assert Simulation(SAMPLED, 1).not_compiled == "NUMBA_DISABLE_JIT is set"


@pytest.mark.parametrize(
    ("words", "line"), [([], "run by the compiled kernel"), (["--scene", "moving"], "scene moving")]
)
def test_the_command_says_whether_the_kernel_runs_it(
    words: list[str], line: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sources, "are_compiled", lambda kind: True)
    assert cli.main(["simulate", "-v", "--no-files", "--duration", "0.3", *words]) == 0
    assert line in capsys.readouterr().out
    assert cli.main(["simulate", "--no-files", "--duration", "0.3", *words]) == 0
    assert "kernel" not in capsys.readouterr().out
