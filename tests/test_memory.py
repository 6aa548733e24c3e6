"""Nothing grows with the length of a run, but the recording's index, a little with every flush."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Mapping
from pathlib import Path
from tracemalloc import Filter
from typing import Any

import pytest

from hapnet.params import Params
from hapnet.recording.mcap import FLUSH_NS, RecordingWriter, read_recording
from hapnet.recording.samples import Recording, Sample
from hapnet.simulation import simulation as virtual_time
from hapnet.simulation.simulation import Simulation

INDEX_BYTES = 1000.0
"""Of a chunk in the index of the file, which holds the place of each of seven topics in it."""

TIMES_BYTES = 80.0
"""Of the index too: the two times of a chunk are the samples' own."""


@pytest.mark.parametrize(
    ("spans", "span_s"),
    [pytest.param(3, 20.0, marks=pytest.mark.slow), pytest.param(10, 60.0, marks=pytest.mark.soak)],
)
def test_memory_is_flat(spans: int, span_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both sides, both links, energy both ways and a recording on disk: after the first span nothing is added."""

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
    seen: list[tracemalloc.Snapshot] = []

    def look(elapsed_s: float) -> None:
        if elapsed_s >= span_s * (len(seen) + 1):
            gc.collect()
            seen.append(tracemalloc.take_snapshot())

    tracemalloc.start()
    try:
        result = simulation.run(look)
    finally:
        tracemalloc.stop()
    assert len(seen) == spans
    assert result.summary["device"]["sent_nJ"] > 1_000_000_000
    flushes = span_s * (spans - 1) * 1e9 / FLUSH_NS
    index, rest = (seen[-1].filter_traces([which]).compare_to(seen[0].filter_traces([which]), "lineno")
                   for which in (Filter(True, "*/mcap/*"), Filter(False, "*/mcap/*")))  # fmt: skip
    print(f"\nin {span_s * (spans - 1):g} s: index {grown(index) / 1e3:.0f} kB, all else {grown(rest) / 1e3:.1f} kB")
    assert grown(index) <= INDEX_BYTES * flushes
    assert grown(rest) <= TIMES_BYTES * flushes + 20_000, "\n".join(map(str, rest[:10]))


def grown(statistics: list[tracemalloc.StatisticDiff]) -> int:
    return sum(statistic.size_diff for statistic in statistics)
