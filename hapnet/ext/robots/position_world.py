"""A robot that takes positions, in the virtual world's place: its account is passive, whatever the robot does.

The set-point of the robot is the position of the proxy, a simulated mass between the coupling and the robot. The robot
gives back the force of its surroundings, if it measures that, else a spring from the set-point to the measured
position. Both come late, so they are not passive. So they act on the proxy through the observer of
`hapnet.ext.engines.observer`, which keeps the account of the force that is really applied, and damps the proxy where
the account would be in debt.

The limits act on the proxy too. With the mean velocity w of a step and the compliance G of the proxy, a limited step
has the velocity s w, with s from 0 to 1, by the additional force ``G^-1 (s - 1) w``. Its work is
``(s - 1) s w' G^-1 w T``, which is never positive. So the limits only take energy, the hand feels them, and the proxy
never runs ahead of the set-point.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from hapnet.checks import Signal, Vector
from hapnet.errors import DeviceSilent, HapnetError
from hapnet.ext.engines.observed_world import ObservedWorld, compliance_of
from hapnet.ext.robots.position_robot import SetPointLimits, check_axes
from hapnet.ext.robots.target_age import TargetAge
from hapnet.loading import failure
from hapnet.mechanics.contacts import Inverse, Mass
from hapnet.mechanics.frame import Frame
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.wire.signals import LEADS, STOP

FAR = 2.0
"""The distance of the robot from its set-point at which the run ends, in units of the limit of the lag."""


TRIES = 100
"""The number of periods within which the first position must come."""


class PositionWorld(ObservedWorld):
    """The world of a robot that takes positions (`hapnet.ext.robots.position_robot.PositionRobot`).

    make : opens the robot. name : of the robot, for messages. frame : its scales; without an offset.
    needs_force : whether a robot that measures no force is refused. others : as for `ObservedWorld`.

    Raises HapnetError, InvalidParameter from `open`: the robot cannot be opened, or does not fit.
    """

    robot: bool = True

    def __init__(
        self, make: Callable[[], Any], name: str, frame: Frame, *, needs_force: bool = False, **others: Any
    ) -> None:
        super().__init__(name=name, **others)
        self._make, self._frame, self._needs_force = make, frame, needs_force
        self._robot: Any = None
        self._limits: SetPointLimits  # set by `open`
        self._age = TargetAge()
        self._target: Vector | None = None
        self._measured: Vector = (0.0,) * self.dof
        self._why, self._said = "", False

    # -- the robot -------------------------------------------------------------------------------------------------

    def open(self) -> None:
        if self._robot is not None:
            return
        self._robot = robot = self._make()
        try:
            check_axes(self.name, robot, self.dof, self.units)
            self._limits = SetPointLimits.of(robot)
            self._wait_for_position()
            if self._needs_force and self._sensed() is None:
                raise HapnetError(f"the robot {self.name} measures no force, which follower.feedback=force needs")
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        robot, self._robot = self._robot, None
        if robot is None:
            return
        try:
            if self._target is not None:
                with suppress(DeviceSilent):
                    self._send(robot, 1.0 / self._limits.rate_hz, None)
        finally:
            if (close := getattr(robot, "close", None)) is not None:
                close()

    def towards(self, position: Vector) -> Vector:
        """The measured position, whatever `position` is: there the proxy starts, and so does the set-point."""
        self.open()
        with suppress(DeviceSilent):  # then the last one; the first step checks it
            self._read()
        return self._frame.coupled(self._measured)

    def _wait_for_position(self) -> None:
        """Read the first position. Raises HapnetError: there is none within some periods."""
        for _ in range(TRIES):
            try:
                self._read()
                return
            except DeviceSilent as error:
                why = str(error)
            time.sleep(1.0 / self._limits.rate_hz)
        raise HapnetError(f"the robot {self.name} gives no position at the start: {why}")

    def proxy(self, mass: ArrayLike, damping: ArrayLike, stiffness: ArrayLike) -> Mass:
        return _PlacedMass(mass, damping, stiffness, self.start)

    def next_step_s(self, rng: np.random.Generator) -> float:
        self.open()
        return 1.0 / self._limits.rate_hz

    # -- what stops it ---------------------------------------------------------------------------------------------

    def heard(self, now_ns: int, came_ns: int, took_ns: int) -> None:
        self._age.hear(now_ns, came_ns, took_ns)

    def signal(self, name: str, value: Signal) -> None:
        if name == LEADS and isinstance(value, bool):
            self._age.lead(value)
        elif name == STOP:
            self._age.stopped = True

    def signals(self) -> Mapping[str, Signal]:
        """Why the set-point stands, as the signal `robot`; empty: it follows again."""
        self._said = self._said or bool(self._why)
        return {"robot": self._why} if self._said else {}

    # -- a step ----------------------------------------------------------------------------------------------------

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        self.open()
        limits, frame, place = self._limits, self._frame, tuple(position)
        begun = frame.own(place)
        silent = self._came(dt, begun)
        force = np.array(self._felt(begun))
        G, free = compliance_of(inverse, self.dof), np.array(velocity)
        applied, mean = self._observer.passive(dt, force, free, G)
        self._why = silent or self._age.why(limits.watchdog_s) or self._stalled(dt)
        share = 0.0
        if not self._why:
            ahead = tuple([one - two for one, two in zip(begun, self._measured, strict=True)])
            share = limits.share(dt, _scaled(frame.motion, tuple(mean.tolist())), ahead)
        if share < 1.0:
            slower = share * mean
            applied, mean = applied + np.linalg.solve(G, slower - mean), slower
        moved = tuple(mean.tolist())
        if silent and self._target is None:
            return tuple(applied.tolist()), list(moved)  # no set-point before its first position is checked
        self._target = tuple([own + frame.motion * dt * one for own, one in zip(begun, moved, strict=True)])
        with suppress(DeviceSilent):
            self._send(self._robot, dt, None if self._why else _scaled(frame.motion, moved))
        return tuple(applied.tolist()), list(moved)

    def _came(self, dt: float, begun: Vector) -> str:
        """Read the robot, and check that it is at its set-point `begun`; returns why there is no reading."""
        try:
            self._read()
        except DeviceSilent as error:
            return f"holds: the robot is silent ({error})"
        limits = self._limits
        apart = limits.size(tuple([one - two for one, two in zip(begun, self._measured, strict=True)]))
        unit = "m" if not limits.by_axis else "rad"
        if self._target is None:
            if apart > limits.step:
                self._fail(
                    f"its first set-point is {apart:.3g} {unit} from its measured position; allowed: "
                    f"{limits.step:g} {unit}, a step. Let it stand still, and check units, axes and frame"
                )
        elif apart > FAR * limits.lag:
            self._target = self._measured  # it stays where it is
            self._fail(f"it is {apart:.3g} {unit} from its set-point; allowed: {FAR * limits.lag:g} {unit}. "
                       "Something moved it, or it did not move")  # fmt: skip
        return ""

    def _fail(self, why: str) -> NoReturn:
        raise HapnetError(f"the robot {self.name} is stopped: {why}")

    def _stalled(self, dt: float) -> str:
        return "" if dt <= self._limits.watchdog_s else f"holds: a period lasted {dt:.2g} s"

    def _felt(self, begun: Vector) -> Vector:
        """The force on the proxy, in the leader's units."""
        own = self._sensed()
        if own is None:
            k = self._limits.tie
            own = tuple([k * (one - two) for one, two in zip(self._measured, begun, strict=True)])
        return self._frame.coupled_force(own)

    def _read(self) -> None:
        found = self._called("read()", self._robot.read)
        if found is None:
            raise HapnetError(f"the robot {self.name} failed: read() gave None, not {self.dof} finite numbers")
        self._measured = found

    def _sensed(self) -> Vector | None:
        sense = getattr(self._robot, "contact_force", None)
        if sense is None:
            return None
        return self._called("contact_force()", sense)

    def _send(self, robot: Any, dt: float, velocity: Vector | None) -> None:
        """Send the set-point, with its velocity; None: it holds there."""
        assert self._target is not None, "there is a set-point"
        try:
            if velocity is not None:
                robot.move(dt, self._target, velocity)
            elif (hold := getattr(robot, "hold", None)) is not None:
                hold(dt, self._target)
            else:
                robot.move(dt, self._target, (0.0,) * self.dof)
        except (DeviceSilent, HapnetError):
            raise
        except BaseException as error:  # see `loading.failure`
            raise HapnetError(f"the robot {self.name} failed: move() raised {failure(error)}") from error

    def _called(self, what: str, call: Callable[[], Any]) -> Vector | None:
        """A vector from the robot, checked; None stays."""
        try:
            value = call()
            found = None if value is None else tuple([float(part) for part in value])
        except (DeviceSilent, HapnetError):
            raise
        except BaseException as error:  # see `loading.failure`
            raise HapnetError(f"the robot {self.name} failed: {what} raised {failure(error)}") from error
        if found is not None and (len(found) != self.dof or not all(map(math.isfinite, found))):
            raise HapnetError(f"the robot {self.name} failed: {what} gave {value!r:.80}, not {self.dof} finite numbers")
        return found


class _PlacedMass(PassiveIntegrator):
    """The proxy, which starts where the robot is."""

    @property
    def waits(self) -> bool:
        return True


def _scaled(factor: float, vector: Vector) -> Vector:
    return tuple([factor * part for part in vector])
