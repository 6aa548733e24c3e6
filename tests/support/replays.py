"""What tests of replays share: recordings that are simulated, changed, and replayed."""

import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapnet import cli
from hapnet.assembly.scenes import for_its_scene
from hapnet.params import Params
from hapnet.recording.mcap import RecordingWriter, read_recording, save
from hapnet.recording.samples import DeviceSample, Event, Recording, WorldSample
from hapnet.simulation.replay import compare, read_original
from hapnet.simulation.simulation import Result, simulate

Capture = pytest.CaptureFixture[str]
QUICK: dict[str, object] = {"duration_s": 1.2, "operator_model.wait_s": 0.1, "operator_model.reach_s": 0.4}

OWN = """
import math
from hapnet.plant.operator import Impedance

class Smooth:
    '''x_d = a (1 - cos w t): it starts at rest.'''
    def __init__(self, dof, impedance):
        self.impedance, self.dof = impedance, dof
    def reference(self, t):
        return (0.01 * (1.0 - math.cos(9.0 * t)),) * self.dof
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Every test runs in a directory of its own, with a hand of the user's own in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.delitem(sys.modules, "own_hand", raising=False)
    (tmp_path / "own_hand.py").write_text(OWN, "utf-8")
    return tmp_path


def recorded(path: Path, seed: int = 5, **changes: object) -> Result:
    """Simulated, with its recording in a file."""
    result = simulate(Params().set({**QUICK, **{name.replace("__", "."): v for name, v in changes.items()}}), seed)
    save(result.recording, path)
    return result


def replayed(*files: Path, **changes: object) -> tuple[Result, dict[str, Any]]:
    original = read_original(files)
    params = original.params.set({name.replace("__", "."): value for name, value in changes.items()})
    result = simulate(for_its_scene(params), original.seed)
    return result, compare(original, result.recording, result.summary)


def rewritten(path: Path, change: Callable[[Recording], Recording], name: str) -> Path:
    """A copy of a recording, with something else in it."""
    target = path.with_name(name)
    save(change(read_recording(path)), target)
    return target


def with_meta(recording: Recording, **meta: Any) -> Recording:
    return dataclasses.replace(recording, meta={**recording.meta, **meta})


def with_params(recording: Recording, **params: Any) -> Recording:
    return with_meta(recording, params={**recording.meta["params"], **params}, operator_sha256=None)


def run(*argv: str | Path) -> int:
    return cli.main([str(word) for word in argv])


def session(
    tmp_path: Path,
    side: str,
    *,
    link: str = "delay 5ms",
    origin_ns: int = 7_000_000_000,
    begins_s: float = 0.0,
    ends_s: float = 2.0,
    pauses: tuple[tuple[float, float], ...] = (),
    events: tuple[tuple[float, str, str], ...] = (),
    **params: object,
) -> Path:
    """A side's recording in real time, by hand: its device is where its hand is led, x_d = 0.01 m/s t, but in pauses.

    Times count from the session's start; a sample comes every 5 ms, of the world every 20 ms.
    """
    given = {"operator": "mouse", "scene": "free", "link.up": "delay 1ms", "link.down": "delay 1ms", **params}
    way = "up" if side == "device" else "down"
    meta = {
        "params": Params().set({name.replace("__", "."): value for name, value in given.items()}).as_dict(),
        "seed": 3,
        "role": side,
        "clock": "boot:1",
        "origin_ns": origin_ns,
        "coupling": "pspm",
        "links": {way: link},
        "operator_sha256": None,
    }
    path = tmp_path / f"{side}.mcap"
    writer = RecordingWriter(path, meta)
    reported = list(events)
    for stop_s, go_s in pauses:
        reported += [(stop_s, "pause", "paused"), (go_s, "pause", "goes on")]
    for at_s, kind, text in sorted(reported):
        writer.write(Event(origin_ns + round(at_s * 1e9), kind, text))
    step_ms = 5 if side == "device" else 20
    for at_ms in range(step_ms, round(ends_s * 1e3) + 1, step_ms):
        at_s = at_ms / 1e3
        if at_s < begins_s or any(start < at_s <= end for start, end in pauses):
            continue
        moved_s = at_s - sum(max(0.0, min(at_s, end) - start) for start, end in pauses)
        x, zero = (0.01 * moved_s,), (0.0,)
        time_ns = origin_ns + at_ms * 1_000_000
        if side == "device":
            writer.write(DeviceSample(time_ns, x, x, x, zero, zero, 0.05, 0.0, 0.0, 0.0, 0.0, 0.1, 0.1, x))
        else:
            energies = (0.0, 0.05, 0.0, 0.0, 0.0, 0.1, 0.1)
            writer.write(WorldSample(time_ns, 0.02, x, zero, x, x, zero, zero, *energies))
    writer.close(None)
    return path


def changed(at_s: float, words: str) -> tuple[float, str, str]:
    return at_s, "netem", f"emulated link, {words}"
