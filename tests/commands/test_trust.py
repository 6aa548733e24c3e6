"""Modules that a recording names are not imported, unless the user says so."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from hapnet.cli import main
from hapnet.commands.replay import permits
from hapnet.errors import InvalidParameter
from hapnet.loading import load, permitting
from hapnet.params import Params
from hapnet.recording.mcap import save
from hapnet.simulation.simulation import Simulation
from tests.conftest import mostly_slow

RAN = "ran.txt"


@pytest.fixture
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A directory with a module that leaves a trace when it is imported."""
    (tmp_path / "strangers_part.py").write_text(
        f"open({str(tmp_path / RAN)!r}, 'w').close()\n"
        "from hapnet.plant.scenes.wall import wall\nfrom hapnet.ext.laws.zoh import LAW\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    yield tmp_path
    sys.modules.pop("strangers_part", None)


def recorded(directory: Path, **changes: str) -> Path:
    """A recording of a short run whose settings name other parts than it had."""
    recording = Simulation(Params().set({"duration_s": 0.3}), 1, kernel=False).run().recording
    meta = {**recording.meta, "params": {**recording.meta["params"], **changes}}
    save(replace(recording, meta=meta), file := directory / "stranger.mcap")
    return file


PARTS = [
    {"scene": "strangers_part:wall"},
    {"scene": "subprocess:run?args=true"},  # imported already, and called with what stands there
    {"scene": "sdf:strangers_part:wall"},
    {"coupling": "strangers_part:LAW"},
    {"operator": "strangers_part:Hand"},
]


@pytest.mark.parametrize(
    "named", mostly_slow([(one,) for one in PARTS], 1), ids=lambda named: next(iter(named.values()))
)
def test_replay_asks_first(stranger: Path, named: dict[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    """Without a terminal that is a no: one line, exit code 2. A recorded operator's motion needs no module."""
    code = main(["replay", str(recorded(stranger, **named)), "--out", str(stranger / "out")])
    assert not (stranger / RAN).exists()
    said = capsys.readouterr().err.strip()
    assert "Traceback" not in said
    if "operator" in named:
        assert code == 0
        return
    assert code == 2
    assert said.count("\n") == 0
    assert "--trust" in said
    assert str(stranger / "stranger.mcap") in said


@pytest.mark.slow
def test_with_trust_or_when_it_was_typed_it_is_imported(stranger: Path) -> None:
    file = str(recorded(stranger, scene="strangers_part:wall"))
    assert main(["replay", file, "--trust", "--out", str(stranger / "one")]) == 0
    assert (stranger / RAN).exists()
    assert main(["replay", file, "--scene", "strangers_part:wall", "--out", str(stranger / "two")]) == 0
    assert main(["replay", file, "--scene", "wall", "--out", str(stranger / "three")]) == 0


@pytest.mark.parametrize(
    ("command", "named"), mostly_slow([("report", PARTS[3]), ("export", PARTS[3]), ("export", PARTS[0])], 1), ids=str
)
def test_no_other_command_imports_it(stranger: Path, command: str, named: dict[str, str]) -> None:
    assert main([command, str(recorded(stranger, **named)), "--out", str(stranger / "out")]) in (0, 2)
    assert not (stranger / RAN).exists()


def test_the_question_names_the_file_and_is_put_once() -> None:
    asked: list[str] = []

    def answer(question: str) -> bool:
        asked.append(question)
        return "yes_" in question

    permit = permits("run.mcap", ["own:World?size=2"], trust=False, ask=answer)
    permit("scene", "own:World")  # it was typed
    permit("scene", "yes_:World")
    permit("scene", "yes_:World")
    with pytest.raises(InvalidParameter, match=r"run\.mcap names it"):
        permit("scene", "own:World2")
    with pytest.raises(InvalidParameter, match="--trust"):
        permit("coupling", "down:World")
    assert len(asked) == 3
    assert all("run.mcap" in question and "your rights" in question for question in asked)


def test_what_hapnet_itself_has_is_not_asked_for_but_its_functions_are() -> None:
    asked: list[str] = []

    def refuse(parameter: str, name: str) -> None:
        asked.append(name)
        raise InvalidParameter(parameter, name, "nothing")

    with permitting(refuse):
        load("hardware", "hapnet.ext.devices.inverse3:Inverse3", "")
        for name in ("hapnet.recording.mcap:repair", "hapnet.ext.devices.inverse3:Inverse3", "os:system"):
            with pytest.raises(InvalidParameter):
                load("scene", name, "")
    assert len(asked) == 3
