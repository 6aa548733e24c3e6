"""The result of a run in virtual time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from os import PathLike
from typing import TYPE_CHECKING

from hapnet.control.two_port import TwoPort
from hapnet.loading import extension
from hapnet.recording.samples import Recording
from hapnet.side.device import DeviceSide
from hapnet.side.world import WorldSide
from hapnet.summary.run import Summary
from hapnet.summary.words import verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


@dataclass(frozen=True)
class Result:
    """The result of a simulated run.

    summary : as `hapnet simulate --json -` prints it; its keys are in `hapnet.summary.structure`. recording : the
    samples as numpy's arrays, `recording.device["position_m"]` (N, n) and so on.
    """

    summary: Summary
    recording: Recording
    device: DeviceSide
    world: WorldSide
    warnings: tuple[str, ...]
    hand: TwoPort
    """The margin over the hand's port and the world's, whatever the servo. Some couplings claim passivity there,
    because they rely on the device's own damping. With a sampled servo the summary's margin is over the actuator's
    port."""

    def __repr__(self) -> str:
        seed, duration_s = self.summary["seed"], self.summary["duration_s"]
        return f"Result({verdict(self.summary)}; seed {seed}, {duration_s:g} s; {self.recording})"

    def _repr_html_(self) -> str:
        return str(extension("pictures").html(replace(self.recording, summary=self.summary)))

    def to_pandas(self, side: str = "device") -> DataFrame:
        """The samples of the device or the world as a table of pandas; see `hapnet.recording.frames.to_pandas`."""
        return self.recording.to_pandas(side)

    def plot(self, file: str | PathLike[str] | None = None) -> Figure:
        """The run's figure, as matplotlib has it; it is written to `file` (.png, .pdf, .svg), if that is given."""
        pictures = extension("pictures")
        drawn: Figure = pictures.also_to(pictures.figure(self.recording), file)
        return drawn
