"""Re-indexing at a robot: when its leader leads again from another place, the robot goes on from where it stands.

`frame` shifts the leader's positions when they arrive, and the robot's positions when they are sent. So the robot's
coupling and its account see no jump, and for the leader the robot is where the leader is.

The opening of a jaw is 0 where it is closed, so its shift must vanish again. The jaw never moves by itself meanwhile:

* If the leader's is more open, the jaw holds its set-position until the leader's has closed to it: it drops nothing.
  Until then the leader's jaw is free.
* If the leader's is more closed, the jaw moves with it, and the shift shrinks by each closing motion of the leader.
"""

from __future__ import annotations

from typing import Any

from hapnet.checks import Vector
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
from hapnet.mechanics.plane import Plane
from hapnet.recording.samples import WorldSample


def rest(coupling: CouplingState) -> None:
    """Keep the set-position of a coupling that has one until a sample arrives."""
    if isinstance(coupling, SetPositionCoupling):
        coupling.rest()


CATCH_M = 1e-3
"""A jaw follows a leader that is more open by no more than this [m], or [rad]."""

PAUSE_NS = 100_000_000
"""A leader from which nothing arrived for this time is away [ns]. A robot that follows a prediction takes some 50 ms to
stop, and stands 0.2 s and the link's delay after its leader's last message."""


class Reindexing:
    """Shifts samples between the link and a robot's coupling, which holds its set-position while its leader is away.

    frame : its own coordinates are those of the robot's coupling, its coupled coordinates those of the link.
    silence_ns : after a longer silence of the leader the robot is re-indexed [ns].
    meets : whether the robot is re-indexed at all; otherwise it moves to the leader's position.
    """

    def __init__(self, frame: Frame, silence_ns: int, *, meets: bool) -> None:
        self.frame = frame
        self._waits = False
        """Whether the jaw waits for its leader's to close."""
        self._opening = 0.0
        """The opening of the leader's jaw."""
        self.leads = True
        """Whether the leader reports that it leads."""
        self._meets = meets
        self._paused = False
        self.moved = False
        """Whether the robot was re-indexed yet."""
        self.due = False
        """True: re-index at the next sample of the leader, so that its position becomes the robot's."""
        self._silence_ns = silence_ns
        self._came_ns: int | None = None

    def led(self, coupling: CouplingState, sample: CouplingSample, came_ns: int) -> CouplingSample:
        """The leader's sample, which came at `came_ns`, in the coordinates of the robot's coupling.

        If the leader was disconnected, the robot's set-position stays where it is.
        """
        before_ns, self._came_ns, self._paused = self._came_ns, came_ns, False
        if not self._meets:
            return sample
        if self.due or (before_ns is not None and came_ns - before_ns > self._silence_ns):
            rest(coupling)
            self.due, self.moved = False, True
            self.frame.meet(coupling.set_position, vector_of(sample))
            before_ns = None
        if self.frame.jaw:
            self._shift_jaw(vector_of(sample)[-1], coupling.set_position[-1] if before_ns is None else None)
        return self._inward(sample) if self.moved else sample

    def _shift_jaw(self, opening: float, held: float | None) -> None:
        """Update the shift of the jaw for the leader's `opening`. held : its set-position, if it is re-indexed now."""
        before, self._opening = self._opening, opening
        shift = self.frame.offset[-1]
        if held is not None:
            shift, self.moved = held - opening, True
        elif self._waits:
            shift += before - opening
        elif shift > 0.0:
            shift = max(0.0, shift - max(0.0, before - opening))
        self._waits = shift < -CATCH_M
        self.frame.offset = (*self.frame.offset[:-1], shift if self._waits else max(0.0, shift))

    def watch(self, coupling: CouplingState, now_ns: int) -> None:
        """Hold the robot where it is if nothing came for a while. Call it once a tick."""
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
                raise TypeError("no leader's law sends proxies or waves to a robot that re-indexes")
            case _:
                return self.frame.own(sample)

    def outward(self, sample: CouplingSample) -> CouplingSample:
        """Return a sample of the robot's coupling in the coordinates of the link."""
        if not self.moved:
            return sample
        frame = self.frame
        match sample:
            case ProxySample(position, _, force, planes, _, _):
                seen = None if planes is None else tuple([frame.plane(one) for one in planes if self._sees(one)])
                return sample._replace(
                    position=self._coupled(position), force=self._free(frame.coupled_force(force), 0.0), planes=seen
                )
            case PositionSample(position, level):
                return PositionSample(self._coupled(position), level)
            case MotionSample(position, velocity):
                return MotionSample(self._coupled(position), frame.velocity(velocity))
            case PortSample() | WaveSample():
                return sample
            case _:
                return self._coupled(sample)

    def _coupled(self, own: Vector) -> Vector:
        return self._free(self.frame.coupled(own), self._opening)

    def _free(self, along: Vector, jaw: float) -> Vector:
        """Values along the axes, with this one for the jaw while it waits."""
        return (*along[:-1], jaw) if self._waits else along

    def _sees(self, plane: Plane) -> bool:
        return not self._waits or plane.normal[-1] == 0.0

    def recorded(self, sample: Any) -> Any:
        """A sample of the robot in the leader's coordinates, for recordings; a jaw's opening is not shifted."""
        if not self.moved or not isinstance(sample, WorldSample):
            return sample
        frame = self.frame

        def placed(own: Vector) -> Vector:
            return (*frame.coupled(own)[:-1], own[-1]) if frame.jaw else frame.coupled(own)

        return sample.moved(placed, frame.velocity, frame.coupled_force)
