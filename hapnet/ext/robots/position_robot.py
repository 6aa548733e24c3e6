"""A robot that takes positions: its interface, and the limits that it declares. positions.md describes its use."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any, ClassVar

from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.units import METRES

RATES_HZ = 10.0, 1000.0
WATCHDOG_S = 0.02, 1.0


class PositionRobot(ABC):
    """A robot with a position loop of its own, given as ``module:Class`` after ``--follower``. It needs no base class.

    Its constructor takes ``dof``, and the options that follow the robot's name, as keywords. Positions are in `units`,
    forces in N, or Nm where the axes are angles. None means the default of `SetPointLimits`.
    """

    about: ClassVar[str] = ""
    tested: ClassVar[str] = "untested"

    dof: int
    units: str = METRES
    """``m`` or ``rad``: the units of all axes."""
    rate_hz: float = 100.0
    """The number of set-points that it takes in a second [Hz]."""
    simulated: bool = False
    """Whether it is simulated: `move` advances it by `dt`. So it runs in virtual time too."""
    speed_limit: float | None = None
    """The greatest speed of its set-point [m/s] or, for each joint, [rad/s]."""
    step_limit: float | None = None
    """The largest distance between two set-points [m] or [rad]."""
    lag_limit: float | None = None
    """The largest distance of the set-point from the measured position [m] or [rad]."""
    watchdog_s: float = 0.1
    """The time without news of the leader, or of the robot, after which the set-point stays where it is [s]."""
    tie_stiffness: float | None = None
    """Without a measured force, the spring from the set-point to the measured position that the hand feels [N/m]."""

    @abstractmethod
    def read(self) -> Vector:
        """The measured position now. Raises DeviceSilent: there is none now. It must not wait for longer than a period.

        Anything else that it raises ends the run.
        """

    @abstractmethod
    def move(self, dt: float, position: Vector, velocity: Vector) -> None:
        """Go to `position` within `dt` [s], the time since the last call; `velocity` is the set-point's.

        Raises DeviceSilent: the command was not sent. Anything else ends the run.
        """

    def hold(self, dt: float, position: Vector) -> None:
        """Stop at `position`, the last set-point. It is called in each period while the set-point must not move."""
        self.move(dt, position, (0.0,) * len(position))

    def contact_force(self) -> Vector | None:
        """The measured force of the surroundings on the robot; None: it is not measured."""
        return None

    def close(self) -> None:
        """Release the robot, after the last `hold`."""
        return


@dataclass(frozen=True)
class SetPointLimits:
    """The limits of a robot's set-points, in its own units: see the attributes of `PositionRobot`.

    by_axis : whether each axis has the limits, as joints do; else they hold for the length of a vector.
    """

    rate_hz: float
    speed: float
    step: float
    lag: float
    watchdog_s: float
    tie: float
    by_axis: bool

    @classmethod
    def of(cls, robot: Any) -> SetPointLimits:
        """The limits that `robot` declares, with defaults for the others. Raises InvalidParameter.

        The defaults are 0.25 m/s or 0.5 rad/s, steps of twice the speed's, a lag of 50 mm or 0.2 rad, and a spring of
        200 N/m or 2 Nm/rad.
        """
        metres = getattr(robot, "units", METRES) == METRES
        rate_hz = _within("rate_hz", getattr(robot, "rate_hz", 100.0), *RATES_HZ, "Hz")
        watchdog_s = _within("watchdog_s", getattr(robot, "watchdog_s", 0.1), *WATCHDOG_S, "s")
        if watchdog_s < 2.0 / rate_hz:
            raise InvalidParameter(
                "watchdog_s", watchdog_s, f"{2.0 / rate_hz:g} s or more: two periods of {rate_hz:g} Hz"
            )
        speed = _positive(robot, "speed_limit", 0.25 if metres else 0.5)
        return cls(
            rate_hz,
            speed,
            _positive(robot, "step_limit", 2.0 * speed / rate_hz),
            _positive(robot, "lag_limit", 0.05 if metres else 0.2),
            watchdog_s,
            _positive(robot, "tie_stiffness", 200.0 if metres else 2.0),
            not metres,
        )

    def size(self, vector: Vector) -> float:
        """The size of a vector, to which the limits apply."""
        return max(map(abs, vector)) if self.by_axis else sum(part * part for part in vector) ** 0.5

    def share(self, dt: float, velocity: Vector, ahead: Vector) -> float:
        """The largest share of `velocity`, 0 to 1, for which a set-point that moves with it for `dt` [s] stays within
        the limits.

        ahead : the distance of the set-point from the measured position, before the step. If it is beyond the limit
        of the lag already, it must not grow.
        """
        if (speed := self.size(velocity)) == 0.0:
            return 1.0
        share = min(1.0, self.speed / speed, self.step / (speed * dt)) * (1.0 - _ROUNDING)
        most = max(self.lag, self.size(ahead))

        def goes(part: float) -> bool:
            return self.size(tuple([a + part * dt * v for a, v in zip(ahead, velocity, strict=True)])) <= most

        if goes(share):
            return share
        low, high = 0.0, share  # the shares that go are an interval, as a size is convex
        for _ in range(_ROUNDS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if goes(middle) else (low, middle)
        return low


_ROUNDING = 1e-12
_ROUNDS = 30


def check_axes(name: str, robot: Any, dof: int, units: str) -> None:
    """Raise InvalidParameter if the robot does not have the scene's axes. name : the robot's."""
    if (found := getattr(robot, "dof", None)) != dof:
        raise InvalidParameter("follower.robot", name, "", why=f"it has {found} axes, and the scene has {dof}: --dof")
    if (own := getattr(robot, "units", METRES)) != units:
        raise InvalidParameter("follower.robot", name, "", why=f"its units are {own}; those of the scene are {units}")


def _positive(robot: Any, name: str, default: float) -> float:
    if (value := getattr(robot, name, None)) is None:
        return default
    if not isinstance(value, int | float) or not 0.0 < value < inf:
        raise InvalidParameter(name, value, f"a positive number, such as {default:g}")
    return float(value)


def _within(name: str, value: object, low: float, high: float, unit: str) -> float:
    if not isinstance(value, int | float) or not isfinite(value) or not low <= value <= high:
        raise InvalidParameter(name, value, f"{low:g} to {high:g} {unit}")
    return float(value)
