"""Re-indexing at a robot: when its leader leads again, wherever that one then is, it is led from where it stands.

The positions of the leader are moved when they come, and those of the robot when they go: `frame`. So nothing changes
for the robot's coupling and its account, and for the leader the robot is where the leader is.
"""

from __future__ import annotations

from typing import Any

from hapnet.control.coupling import (
    CouplingSample,
    CouplingState,
    MotionSample,
    PortSample,
    PositionSample,
    ProxySample,
    WaveSample,
    vector_of,
)
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.mechanics.frame import Frame
from hapnet.recording.samples import WorldSample


def rest(coupling: CouplingState) -> None:
    """Let a coupling with set-positions stay where it is until a sample arrives."""
    if isinstance(coupling, SetPositionCoupling):
        coupling.rest()


PAUSE_NS = 100_000_000
"""A leader that was not heard for so long is away [ns]. A robot that is led on by prediction needs some 50 ms to stop,
and stands 0.2 s and the link's delay after its leader's last message."""


class Reindexing:
    """Between what crosses the link and a robot's coupling, which holds its set-position while its leader is away.

    frame : its own coordinates are those of the robot's coupling, the coupled ones those of the link.
    silence_ns : a leader that was silent for longer is met where it then is [ns].
    meets : whether the robot meets it at all, and does not go to where it is.
    """

    def __init__(self, frame: Frame, silence_ns: int, *, meets: bool) -> None:
        self.frame = frame
        self.leads = True
        """Does the leader say that it leads?"""
        self._meets = meets
        self._paused = False
        self.moved = False
        """Was the robot re-indexed yet?"""
        self.due = False
        """The next position of the leader is where the robot is."""
        self._silence_ns = silence_ns
        self._came_ns: int | None = None

    def led(self, coupling: CouplingState, sample: CouplingSample, came_ns: int) -> CouplingSample:
        """The leader's sample, which came at `came_ns`, as the robot's coupling takes it.

        If the leader was away, the robot's set-position stays where it is.
        """
        before_ns, self._came_ns, self._paused = self._came_ns, came_ns, False
        if not self._meets:
            return sample
        if self.due or (before_ns is not None and came_ns - before_ns > self._silence_ns):
            rest(coupling)
            self.due, self.moved = False, True
            self.frame.meet(coupling.set_position, vector_of(sample))
        return self._inward(sample) if self.moved else sample

    def watch(self, coupling: CouplingState, now_ns: int) -> None:
        """Let the robot stay where it is if nothing came for a while. Once a tick."""
        if self._came_ns is not None and not self._paused and now_ns - self._came_ns > PAUSE_NS:
            self._paused = True
            rest(coupling)

    def _inward(self, sample: CouplingSample) -> CouplingSample:
        match sample:
            case PositionSample(position, level):
                return PositionSample(self.frame.own(position), level)
            case MotionSample(position, velocity):
                return MotionSample(self.frame.own(position), velocity)
            case PortSample(position, energy):
                return PortSample(self.frame.own(position), energy)
            case ProxySample() | WaveSample():
                raise TypeError("of these no leader's law sends any to a robot that re-indexes")
            case _:
                return self.frame.own(sample)

    def outward(self, sample: CouplingSample) -> CouplingSample:
        """Return the sample of the robot's coupling as it crosses the link."""
        if not self.moved:
            return sample
        frame = self.frame
        match sample:
            case ProxySample(position, _, force, planes, _, _):
                seen = None if planes is None else tuple([frame.plane(one) for one in planes])
                return sample._replace(position=frame.coupled(position), force=frame.coupled_force(force), planes=seen)
            case PositionSample(position, level):
                return PositionSample(frame.coupled(position), level)
            case MotionSample(position, velocity):
                return MotionSample(frame.coupled(position), frame.velocity(velocity))
            case PortSample() | WaveSample():
                return sample
            case _:
                return frame.coupled(sample)

    def recorded(self, sample: Any) -> Any:
        """A sample of the robot in the leader's coordinates, as recordings have it."""
        if not self.moved or not isinstance(sample, WorldSample):
            return sample
        frame = self.frame
        return sample.moved(frame.coupled, frame.velocity, frame.coupled_force)
