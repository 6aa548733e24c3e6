"""Nothing grows with the length of a run."""

import gc
import tracemalloc
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from hapnet.params import Params
from hapnet.recording.mcap import RecordingWriter, read_recording
from hapnet.recording.samples import Recording, Sample
from hapnet.simulation import simulation as virtual_time
from hapnet.simulation.simulation import Simulation
from tests.conftest import mostly_slow

LOOKS = 8
"""In each span."""


@pytest.mark.parametrize(
    ("spans", "span_s"),
    mostly_slow([(3, 5.0), (3, 10.0), (10, 60.0)], 0, 1),
)
def test_memory_is_flat(spans: int, span_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both sides, both links, energy in both directions and a recording on disk: after the first span nothing is
    added."""

    class OnDisk:
        """In place of the recorder in memory."""

        def __init__(self, meta: Mapping[str, Any]) -> None:
            self._path = tmp_path / "run.mcap"
            self._writer = RecordingWriter(self._path, dict(meta))

        def write(self, sample: Sample) -> None:
            self._writer.write(sample)
            self._writer.flush(sample.time_ns)

        def recording(self, summary: Mapping[str, Any]) -> Recording:
            self._writer.close(summary)
            return read_recording(self._path)

    monkeypatch.setattr(virtual_time, "MemoryRecorder", OnDisk)
    words = {"operator": "sine", "device.shuffle": "all", "world.shuffle": "all", "duration_s": span_s * spans}
    params = Params().set({**words, "link.up": "4g", "link.down": "lossy-wifi"})
    simulation = Simulation(params, seed=1, kernel=False)  # the objects that real time uses
    looks: list[int] = []

    def look(elapsed_s: float) -> None:
        if elapsed_s >= span_s / LOOKS * (len(looks) + 1):
            gc.collect()
            looks.append(tracemalloc.get_traced_memory()[0])

    tracemalloc.start()
    try:
        result = simulation.run(look)
    finally:
        tracemalloc.stop()
    assert len(looks) == spans * LOOKS
    assert result.summary["device"]["sent_nJ"] > 30_000_000 * span_s * spans
    # what waits on the links, and for a tick, goes up and down: the most of one span is held against that of another
    second, last = max(looks[LOOKS : 2 * LOOKS]), max(looks[-LOOKS:])
    print(f"\nin {span_s * (spans - 2):g} s: {(last - second) / 1e3:.1f} kB")
    assert last - second <= 20_000
