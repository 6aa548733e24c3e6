"""Laws by name: found as files or entry points, their parameters are sections, what one lacks is said in a line."""

import dataclasses
import importlib.metadata
import json
import pickle
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from examples.own_law import ENDS, Mine, MineParams, SpringAndDamper, Tuning, tune
from hapnet import cli, laws
from hapnet.commands import complete
from hapnet.couplings.ends import held_law
from hapnet.couplings.registry import COUPLINGS, coupling, jointly_passive
from hapnet.couplings.spec import CouplingSpec
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.loading import published, shared_with_children
from hapnet.param_values import parameter
from hapnet.params import Params
from hapnet.plant.worlds.registry import GROUP as WORLDS, make_scene
from hapnet.simulation.simulation import simulate
from tests.conftest import ROOT

OWN = "examples.own_law:Mine"
SHORT: dict[str, object] = {"duration_s": 0.2, "link.up": "lan", "link.down": "lan"}


@pytest.fixture
def packages(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What other packages publish: a law, one that cannot be loaded, one with a name of hapnet's, and a world."""
    points = {
        laws.GROUP: [("mine", OWN), ("broken", "nowhere:X"), ("pspm", OWN)],
        WORLDS: [("planet", "examples.planet:planet")],
    }
    made = {group: [importlib.metadata.EntryPoint(*one, group) for one in of] for group, of in points.items()}
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: made.get(group, []))
    published.cache_clear()
    yield
    published.cache_clear()


def test_a_laws_file_has_its_name() -> None:
    files = {file.stem.replace("_", "-") for file in (ROOT / "hapnet" / "ext" / "laws").glob("[!_]*.py")} | {"pspm"}
    assert set(laws.COUPLING_NAMES) == files
    assert [coupling(name).name for name in laws.COUPLING_NAMES] == list(laws.COUPLING_NAMES) == list(COUPLINGS)


def test_names_are_known_without_a_law() -> None:
    code = "import sys\nfrom hapnet.params import Params\nParams().set({'device.stiffness': 3})\nprint(*sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert "hapnet.params" in found.stdout.split()
    assert not {name for name in found.stdout.split() if name == "numpy" or name.startswith("hapnet.couplings")}


# Parameters


def test_a_strangers_parameters_are_a_section_once_its_law_is_chosen() -> None:
    params = Params().set({"coupling": OWN, "mine.stiffness": "50"})
    assert params.of(MineParams) == MineParams(stiffness=50.0)
    assert params.get("mine.stiffness") == 50.0
    assert params.flat()["mine.damping"] == 1.5
    assert "[mine]\nstiffness = 50.0 " in params.toml()
    assert Params().set(params.changes()) == params
    assert pickle.loads(pickle.dumps(params)) == params
    assert eval(repr(params), {"Params": Params}) == params
    assert "mine.damping" not in Params().flat()
    with pytest.raises(InvalidParameter, match=r"^unknown parameter 'mine\.stiffness'; did you mean"):
        Params().set({"mine.stiffness": 50})


def test_they_are_read_from_a_file_and_checked(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text(Params().set({"coupling": OWN, "mine.damping": 2.5}).toml(), "utf-8")
    assert Params().load(file).of(MineParams).damping == 2.5
    with pytest.raises(InvalidParameter, match=r"^mine\.damping is 'much'; allowed: a number$"):
        Params().set_words([f"coupling={OWN}", "mine.damping=much"])
    with pytest.raises(InvalidParameter, match=r"^unknown parameter 'mine\.dampin'; did you mean mine\.damping"):
        Params().set_words([f"coupling={OWN}", "mine.dampin=1"])


def test_a_law_that_cannot_be_loaded_says_so_and_nothing_else_fails() -> None:
    assert "mine.damping" not in Params(coupling="nowhere:X").flat()
    with pytest.raises(InvalidParameter, match=r"^coupling nowhere:X: cannot import module 'nowhere'"):
        Params().set({"coupling": "nowhere:X", "mine.damping": 1})


def test_a_recording_can_be_read_where_its_law_is_not_installed() -> None:
    flat = Params().set({"coupling": OWN, "mine.stiffness": 50}).flat()
    assert Params.recorded(flat).of(MineParams).stiffness == 50.0
    there = Params.recorded(flat | {"coupling": "nowhere:X"})
    assert there.coupling == "nowhere:X"
    assert not there.laws


def test_sections_that_are_as_by_default_do_not_count() -> None:
    assert Params().set({"wave.impedance": 2.0}).unset("wave.impedance") == Params()
    assert not Params().set({"wave.impedance": 2.0}).set({"wave.impedance": 0.0}).laws
    assert hash(Params().set({"pd.damping": 2.0})) != hash(Params())
    assert Params().set({"pd.damping": 2.0, "popc.predict_s": 0}).set({"pd.damping": 3.0}).flat()["popc.predict_s"] == 0


def test_they_tune_the_law() -> None:
    """50 N/m and no delay; the spring of 100 N/m is there by default."""
    ideal = {**SHORT, "coupling": OWN, "link.up": "ideal", "link.down": "ideal"}
    found = simulate({**ideal, "mine.stiffness": 50, "mine.damping": 2}, seed=1).summary
    assert found["tuning"] == {"stiffness_N_m": 50.0, "damping_Ns_m": 2.0}
    assert simulate(ideal, seed=1).summary["tuning"]["stiffness_N_m"] == 100.0


# Entry points


@pytest.mark.usefixtures("packages")
def test_a_published_law_has_a_name_of_its_own() -> None:
    assert coupling("mine") is Mine
    assert coupling("pspm") is COUPLINGS["pspm"]  # a package cannot replace hapnet's own
    assert jointly_passive("mine")
    assert {"mine", "pspm"} < set(complete.couplings())
    params = Params().set({"mine.stiffness": 50})  # also while another one is chosen, as in a comparison
    assert params.set({"coupling": "mine"}).of(MineParams).stiffness == 50.0
    assert simulate({**SHORT, "coupling": "mine"}, seed=1).summary["coupling"] == "mine"
    with pytest.raises(InvalidParameter, match=r"coupling nowhere:X: cannot import module 'nowhere'"):
        coupling("broken")
    with pytest.raises(InvalidParameter, match="did you mean mine"):
        coupling("mien")
    assert Params().set({"pd.damping": 1.0}).flat()["pd.damping"] == 1.0  # though one is broken


@pytest.mark.usefixtures("packages")
def test_a_published_world_has_one_too() -> None:
    assert make_scene("planet").dof == make_scene("examples.planet:planet").dof
    assert "planet" in dict(complete.scenes())


# Checks


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"tune": None}, "tune of the coupling mine is None; allowed: a function"),
        ({"device": 3}, "device of the coupling mine is 3; allowed: a function"),
        ({"tuning": dict}, "tuning of the coupling mine is .*; allowed: a dataclass"),
        ({"shared": ("mass",)}, "shared of the coupling mine is .*mass.*; allowed: fields of its tuning"),
        ({"set_positions": frozenset({"hand"})}, "set_positions of the coupling mine is .*; allowed: of device and"),
        ({"section": "world"}, "section of the coupling mine is 'world'; allowed: a name that no other section has"),
        ({"section": "a.b"}, "section of the coupling mine is 'a.b'; allowed: a name such as mine"),
        ({"parameters": Tuning}, "parameter stiffness_N_m of the coupling mine is .*; allowed: hapnet.param_values"),
    ],
)  # fmt: skip
def test_what_a_law_must_have_is_checked_when_it_is_made(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(InvalidParameter, match=f"^{says}"):
        dataclasses.replace(Mine, **{"section": "mine", **changes})
    dataclasses.replace(Mine, section="mine", shared=tuple(Tuning.__dataclass_fields__))  # all of them


@dataclasses.dataclass(frozen=True)
class Other:
    damping: float = parameter(1.0, "another's")


def test_two_laws_have_no_section_together() -> None:
    law = CouplingSpec("mine", "", "", "", *ENDS, Tuning, tune, parameters=Other, section="tdpa")
    with (
        shared_with_children(law, "law") as name,
        pytest.raises(InvalidParameter, match=r"^section of the coupling .* is 'tdpa'"),
    ):
        coupling(name)


def test_an_end_that_lacks_a_part_is_named_before_the_run() -> None:
    class Mute(SpringAndDamper):
        def __getattribute__(self, name: str) -> Any:
            if name == "release":
                raise AttributeError(name)
            return super().__getattribute__(name)

    with (
        shared_with_children(dataclasses.replace(Mine, device=held_law(Mute)), "law") as name,
        pytest.raises(HapnetError, match=r"^the coupling .* failed: Mute has no release; allowed: .*DeviceLaw$"),
    ):
        simulate({**SHORT, "coupling": name}, seed=1)


# Add to it


@pytest.mark.slow
def test_the_pages_example_is_a_coupling_once_it_is_in_the_folder(tmp_path: Path) -> None:
    """One file is touched."""
    folder = tmp_path / "hapnet"
    shutil.copytree(Path(cli.__file__).parent, folder, ignore=shutil.ignore_patterns("__pycache__"))
    page = (folder / "README.md").read_text("utf-8").partition("**A coupling.**")[2].partition("\n\n")[0]
    source, target = re.findall(r"`(\w+/[\w/]*\.py)`", page)[:2]
    (law, own), (name, mine) = re.findall(r"`([\w-]+)` for `(\w+)`", page)
    ((section, value),) = re.findall(r"`--set (\S+)\.stiffness=(\d+)`", page)
    text = (ROOT / source).read_text("utf-8").replace(f"{own} = ", f"{law} = ").replace(f'"{mine}"', f'"{name}"')
    (tmp_path / target).write_text(text, "utf-8")

    def hapnet(*argv: str) -> str:
        command = [sys.executable, "-m", "hapnet", *argv]
        found = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
        assert found.returncode == 0, found.stderr
        return found.stdout

    assert name in " ".join(hapnet("simulate", "--help").split())
    assert f"[{section}]\n# stiffness" in hapnet("simulate", "--show-params")
    asked = ("--coupling", name, "--set", f"{section}.stiffness={value}", "--link", "ideal", "--duration", "0.2")
    assert json.loads(hapnet("simulate", *asked, "--json", "-"))["tuning"]["stiffness_N_m"] == float(value)
