"""Re-indexing at a robot: when its leader leads again from another place, the robot goes on from where it stands.

`frame` shifts the leader's positions when they arrive, and the robot's positions when they are sent. So the robot's
coupling and its account see no jump, and for the leader the robot is where the leader is.

The opening of a jaw is not shifted for good: then a hand that is open could not open a jaw that is closed. A jaw holds
its set-position until the leader's opening has come to it, and follows from then on; until then the leader's jaw is
free.
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
"""A jaw follows its leader if their openings differ by less than this [m] or [rad], or have just crossed."""

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
        self._held: float | None = None
        """The jaw's set-position while it waits for its leader; None: it follows, or there is none."""
        self._gap: float | None = None
        """How far that is from the leader's opening at the newest sample, while it waits."""
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
        if self.frame.jaw and before_ns is None:
            self._held, self._gap = coupling.set_position[-1], None
        if self._held is not None:
            self._hold_jaw(vector_of(sample)[-1])
        return self._inward(sample) if self.moved or self._gap is not None else sample

    def _hold_jaw(self, opening: float) -> None:
        """Hold the jaw's set-position until the leader's `opening` has come to it."""
        assert self._held is not None, "it is held"
        gap, before = self._held - opening, self._gap
        crossed = before is not None and before * gap <= 0.0
        self._gap = None if crossed or abs(gap) <= CATCH_M else gap
        if self._gap is None:
            self._held = None

    def watch(self, coupling: CouplingState, now_ns: int) -> None:
        """Hold the robot where it is if nothing came for a while. Call it once a tick."""
        if self._came_ns is not None and not self._paused and now_ns - self._came_ns > PAUSE_NS:
            self._paused = True
            rest(coupling)

    def _inward(self, sample: CouplingSample) -> CouplingSample:
        match sample:
            case PositionSample(position, level):
                return PositionSample(self._own(position), level)
            case MotionSample(position, velocity):
                return MotionSample(self._own(position), velocity)
            case PortSample(position, energy):
                return PortSample(self._own(position), energy)
            case ProxySample() | WaveSample():
                raise TypeError("no leader's law sends proxies or waves to a robot that re-indexes")
            case _:
                return self._own(sample)

    def _own(self, x: Vector) -> Vector:
        own = self.frame.own(x)
        return own if self._gap is None else (*own[:-1], own[-1] + self._gap)

    def outward(self, sample: CouplingSample) -> CouplingSample:
        """Return a sample of the robot's coupling in the coordinates of the link."""
        if not self.moved and self._gap is None:
            return sample
        frame = self.frame
        match sample:
            case ProxySample(position, _, force, planes, _, _):
                seen = None if planes is None else tuple([frame.plane(one) for one in planes if self._sees(one)])
                return sample._replace(
                    position=self._coupled(position), force=self._seen(frame.coupled_force(force), 0.0), planes=seen
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
        opening = 0.0 if self._held is None or self._gap is None else self._held - self._gap
        return self._seen(self.frame.coupled(own), opening)

    def _seen(self, along: Vector, last: float) -> Vector:
        """Values along the axes as the leader sees them; `last` replaces the last one while the jaw waits."""
        return along if self._gap is None else (*along[:-1], last)

    def _sees(self, plane: Plane) -> bool:
        return self._gap is None or plane.normal[-1] == 0.0

    def recorded(self, sample: Any) -> Any:
        """A sample of the robot in the leader's coordinates, for recordings."""
        if not self.moved or not isinstance(sample, WorldSample):
            return sample
        frame = self.frame
        return sample.moved(frame.coupled, frame.velocity, frame.coupled_force)
