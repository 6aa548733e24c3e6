"""Compiling beside a run: plain Python serves meanwhile; the bits are the same whenever compiled code takes over."""

import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest

from hapnet import cli
from hapnet.assembly.build import prepare
from hapnet.ext.compiled import catalogue, sources
from hapnet.ext.compiled.background import Background
from hapnet.ext.compiled.names import HANDLE
from hapnet.ext.compiled.progress import reported
from hapnet.ext.compiled.whole_runs import coverage
from hapnet.params import Params
from hapnet.simulation.batch import simulate_batch
from hapnet.simulation.simulation import Simulation
from tests.conftest import ROOT, mostly_slow
from tests.support.kernel_cases import differing

FOUR_G = Params().set({"link.up": "4g", "link.down": "4g", "duration_s": 3.0})


class Soon:
    """A compiler that is done when it has been asked so many times."""

    def __init__(self, times: int) -> None:
        self._left = times

    def __enter__(self) -> "Soon":
        return self

    def __exit__(self, *exc: object) -> None:
        pass

    @property
    def is_done(self) -> bool:
        self._left -= 1
        return self._left < 0


@pytest.mark.parametrize("scene", mostly_slow(["wall", "sphere?friction=0.5"], 1))
@pytest.mark.parametrize("times", mostly_slow([0, 1, 4], 1))
def test_compiled_code_takes_over_in_the_middle_of_a_run(
    times: int, scene: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    params = FOUR_G.set({"scene": scene})
    expected = Simulation(params, 3, kernel=False).run()
    with monkeypatch.context() as patched:
        patched.setattr(sources, "are_compiled", lambda kind: False)
        run = Simulation(params, 3)
    assert run.not_compiled == coverage.NOT_YET
    monkeypatch.setattr(coverage, "beside", lambda setup: Soon(times))
    found = run.run()
    assert run.not_compiled is None
    assert not differing(expected, found)


@pytest.mark.slow
def test_a_process_compiles_and_reports(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Machine code is kept with the user's caches, and not beside the package."""
    before = set((ROOT / "hapnet").rglob("*.nb?"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    shares: list[float] = []
    token = reported.set(shares.append)
    try:
        with Background(HANDLE) as compiling:
            assert not compiling.is_done
            deadline = time.monotonic() + 120.0
            while not compiling.is_done and time.monotonic() < deadline:
                time.sleep(0.1)
            assert compiling.is_done
            assert sources.are_compiled(HANDLE)
        assert list(tmp_path.rglob("*.nbc"))
        assert set((ROOT / "hapnet").rglob("*.nb?")) == before
    finally:
        reported.reset(token)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert len(shares) > 3


def test_the_process_ends_with_its_parent(tmp_path: Path) -> None:
    """Also if that is killed."""
    lines = (
        "import time",
        "from hapnet.ext.compiled.background import Background",
        "made = Background('servo')",
        "print(made._process.pid, flush=True)",
        "time.sleep(60)",
    )
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    with subprocess.Popen(
        [sys.executable, "-c", "\n".join(lines)], cwd=ROOT, env=environment, stdout=subprocess.PIPE
    ) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        parent.send_signal(signal.SIGKILL)
        parent.wait()
    deadline = time.monotonic() + 60.0
    while Path(f"/proc/{child}").exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not Path(f"/proc/{child}").exists()


@pytest.mark.parametrize(("seconds", "seeds", "names"), [(90.0, 12, ["SetPosition-SetPosition"]), (90.0, 11, None)])
def test_only_what_takes_longer_than_compiling_is_compiled_beside(
    seconds: float, seeds: int, names: list[str] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That is a million ticks of the servo, in all runs together."""
    made: list[Any] = []
    monkeypatch.setattr(sources, "are_compiled", lambda kind: False)
    monkeypatch.setattr(coverage, "Background", lambda *given: made.append(list(given)) or Soon(0))
    long = Params().set({"duration_s": seconds})
    with coverage.background((long, seconds * 1000.0) for _ in range(seeds)):
        pass
    assert made == ([] if names is None else [names])


@pytest.mark.parametrize(
    ("scene", "kind"), [("wall", ""), ("sphere", "-Solids"), ("tests.kernel.test_solids:ball", "-Solids")]
)
def test_a_long_run_has_its_own_kind_compiled(scene: str, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also that of a scene of the user's, whose text does not tell that solids are in it."""
    made: list[Any] = []
    monkeypatch.setattr(sources, "are_compiled", lambda kind: False)
    monkeypatch.setattr(coverage, "Background", lambda *given: made.extend(given) or Soon(0))
    with coverage.beside(prepare(Params().set({"scene": scene, "duration_s": 1000.0}), "sampled")):
        pass
    assert made == [f"SetPosition-SetPosition{kind}"]


def test_a_batch_compiles_beside_its_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[Any] = []

    def background(runs: Any) -> Soon:
        given.extend(runs)
        return Soon(0)

    monkeypatch.setattr(coverage, "background", background)
    params = Params().set({"duration_s": 0.25})
    simulate_batch(params, range(3))
    assert given == [(params, 750.0)]


def test_the_command_compiles_what_is_not_compiled(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made: list[str] = []
    monkeypatch.setattr(sources, "are_compiled", lambda kind: kind == "world")
    monkeypatch.setattr(catalogue, "makers", lambda: defaultdict(lambda: lambda: made.append("one")))
    assert cli.main(["compile"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(made) == len(lines) - 2  # the one that was, and where they are kept
    assert "world in real time: was compiled before" in lines
    assert lines[0].startswith("pspm, zoh among walls: ")
    made.clear()
    assert cli.main(["compile", "tdpa"]) == 0  # its ends are not compiled by themselves
    assert len(made) == 2
    assert cli.main(["compile", "tpda"]) == 2
    assert "tdpa" in capsys.readouterr().err
