"""A user's own device, given as ``module:Class``: checked when it is made, and guarded while it runs.

It may declare its operating range: `workspace` [m], `greatest_speed` [m/s] and `stiffness_range` [N/m], as in
`hapnet.plant.operating_range`. The parameters replace values that it does not declare. For the speed the limit is ten
times device.greatest_speed: above that parameter only the account is not known; above ten times it, the unit is wrong.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from math import isfinite
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.assembly.device_class import allowed, declared_range, load_class, may_have_jaw
from hapnet.assembly.own_parts import closed_if_refused
from hapnet.checks import Vector
from hapnet.couplings import held_torque
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from hapnet.loading import extension, failure
from hapnet.params import DeviceParams, FollowerParams, Params
from hapnet.plant.actuator_check import ActuatorCheck
from hapnet.plant.device import Device
from hapnet.plant.operating_range import OperatingRange
from hapnet.side.force_limiter import ForceLimiter
from hapnet.units import METRES, POSE, one_text

Section = TypeVar("Section", DeviceParams, FollowerParams)


_DECLARED = {
    "workspace": "device.workspace_m", "greatest_speed": "device.greatest_speed", "resolution": "device.resolution_m",
    "stiffness_range": "device.stiffness_range",
}  # fmt: skip
"""Attributes that a device may declare, and the parameter used if it does not."""

_FIRST_READINGS = 5
_UNIT = 1e-3
_MOST_REPORTED = 2.0
"""A driver may report a force up to this many times its limit, as currents overshoot. Beyond, the unit is wrong."""

_MOST_REPORTED_N = 1e4
"""Largest plausible force of a device that a hand holds [N], whatever its limit."""

SELF_TEST_ROUNDS = 3
"""Rounds of pushes to and fro, shared by the axes: 0.43 s."""

THERMAL_S = 10.0
"""Time constant of a device that declares a continuous force, but not how fast its actuators heat up [s]."""


_WITH_JAW = "a device with a jaw, the scene's last axis (option jaw= of dhd, dynamixel, feetech, gamepad)"
_WITHOUT_JAW = "a device without a jaw, as the scene has none; for a jaw add it to the scene, as in 'wall + grip'"


_OPTIONAL = ("acted", "orientation", "interval", "contact_force", "buttons", "braked")
"""The methods that a driver may lack."""


class UserDevice:
    """The device `name`, made with ``dof`` and read once. `params` replace values that it does not declare.

    units : of the scene's axes; empty: the device's own. jaw : whether the scene's last axis is the opening of a jaw;
    None: as the device's.

    Its driver may fail at any time, and a NaN would become a force. So any error that it raises, and any reading that
    is not two times `dof` finite numbers, becomes one HapnetError that names the device.

    Raises InvalidParameter: the device lacks a part, or its first reading does not fit. HapnetError: it cannot be made.
    """

    def __init__(
        self, name: str, dof: int, params: DeviceParams | None = None, units: str = "", jaw: bool | None = None
    ) -> None:
        self.name: str = name
        self.dof: int = dof
        make = load_class(name)
        if jaw and not may_have_jaw(make):
            raise InvalidParameter("hardware", name, _WITH_JAW)
        try:
            self.device: Device = (
                extension("tools' drivers").Posed(make(dof=3), name) if units == POSE else make(dof=dof)
            )
        except HapnetError as error:  # the driver's own message
            if isinstance(error, InvalidParameter) and error.name == "hardware":
                raise
            raise HapnetError(f"the device {name} cannot be made: {error}") from error
        except BaseException as error:  # see `loading.failure`
            raise InvalidParameter("hardware", name, f"{allowed()}, made with dof ({failure(error)})") from error
        self._is_posed = units == POSE
        self._optional: frozenset[str] = frozenset(part for part in _OPTIONAL if self._can(part))
        with closed_if_refused(self):
            if jaw is not None and self.jaw is not jaw:
                raise InvalidParameter("hardware", name, _WITH_JAW if jaw else _WITHOUT_JAW)
            self._examine(params or DeviceParams(), params is not None, units)

    def _examine(self, params: DeviceParams, is_run: bool, units: str) -> None:
        """Check the device's declarations, calibrate it and read it once; `is_run` : at the rate of `params`."""
        name, dof = self.name, self.dof
        missing = [
            part for part in ("dof", "force_limit", "resolution", "read", "apply") if not hasattr(self.device, part)
        ]
        if missing:
            raise InvalidParameter("hardware", name, f"{allowed()}; it lacks {', '.join(missing)}")
        if self.device.dof != dof:
            raise InvalidParameter("hardware", name, f"a device with {dof} degrees of freedom, as the scene has")
        try:
            own = one_text(getattr(self.device, "units", METRES), dof)
            self.force_limit: float | None = self._positive("force_limit")
            self.resolution: float = checks.non_negative("resolution", self.device.resolution)
            self.greatest_speed: float | None = self._positive("greatest_speed")
            self.smallest_mass: float | None = self._positive("smallest_mass")
            self.continuous_force: float | None = self._positive("continuous_force")
            self.thermal_s: float = self._positive("thermal_s") or THERMAL_S
            self.watchdog_s: float | None = self._positive("watchdog_s")
            self.damping_range: tuple[float, float] | None = self._damping_range()
            self.dead_man: int | None = self._dead_man()
            self.knows_force: bool = bool(getattr(self.device, "knows_force", True))
            self.declared: OperatingRange = declared_range(params, dof, self.device)
            self.rate_hz: float | None = self._positive("rate_hz")
        except InvalidParameter as error:
            raise InvalidParameter("hardware", name, f"a device whose limits are numbers ({error})") from error
        if units not in ("", own):
            raise InvalidParameter("hardware", name, f"a device with axes in {units}; this one's are in {own}")
        if is_run and self.rate_hz is not None and self.rate_hz < params.servo_hz * (1.0 - 1e-9):
            most = f"at most {self.rate_hz:g}, as this device: --servo-hz {math.floor(self.rate_hz)}"
            raise InvalidParameter("device.servo_hz", params.servo_hz, most)
        if self._can("home"):
            self._make_ready()
        try:
            position, _ = self._first_reading()
        except HapnetError as error:
            raise InvalidParameter("hardware", name, f"a device that can be read ({error})") from error
        if (where := self.declared.outside(position)) is not None:
            within = f"a device within its workspace (declared by itself or by device.workspace_m); {where}"
            raise InvalidParameter("hardware", name, within)
        if self.dead_man is not None and self.dead_man >= (count := len(self.buttons())) > 0:
            raise InvalidParameter("dead_man", self.dead_man, f"the number of one of its {count} buttons, from 0")

    def _make_ready(self) -> None:
        driver: Any = self.device  # optional methods are not part of `Device`
        try:
            driver.home()
        except HapnetError as error:  # the driver's message has the first remedy
            raise HapnetError(f"the device {self.name} is not ready: {error}") from error
        except BaseException as error:  # see `loading.failure`
            raise HapnetError(f"the device {self.name} failed: home() raised {failure(error)}") from error

    def read(self) -> tuple[Vector, Vector]:
        """Position [m] and velocity [m/s]. DeviceSilent if there is none now, HapnetError if the device fails."""
        returned = self._call("read")
        wanted = f"position and velocity of {self.dof} finite numbers each"
        try:
            position, velocity = returned
        except (TypeError, ValueError):
            raise self._wrong("read", returned, wanted) from None
        x, v = self._numbers("read", position, wanted), self._numbers("read", velocity, wanted)
        if len(x) != self.dof or len(v) != self.dof or not isfinite(sum(x) + sum(v)):
            raise self._wrong("read", (x, v), wanted)
        return x, v

    def apply(self, force: Vector) -> Vector | None:
        """Hold a force [N]; returns the force really applied, if the device reports it. HapnetError if it fails."""
        return self._force("apply", self._call("apply", force), "the applied force")

    def begin(self) -> None:
        """Call `begin` of the driver, if it has one; HapnetError if the device fails."""
        if self._can("begin"):
            self._call("begin")

    def acted(self) -> Vector | None:
        """The force that acted between the last two readings, if the device reports it; HapnetError if it fails."""
        return self._force("acted", self._call("acted"), "the force that acted") if "acted" in self._optional else None

    def contact_force(self) -> Vector | None:
        """The measured force of its surroundings, perhaps NaN; None: not measured. HapnetError if it fails."""
        if "contact_force" not in self._optional:
            return None
        try:
            returned = self._call("contact_force")
        except DeviceSilent:
            return None
        wanted = f"the force of its surroundings, {self.dof} numbers, or None"
        force = None if returned is None else self._numbers("contact_force", returned, wanted)
        if force is not None and len(force) != self.dof:
            raise self._wrong("contact_force", force, wanted)
        return force

    def interval(self) -> float | None:
        """The time between the last two readings by the device's clock [s], if it reports that, or HapnetError."""
        if "interval" not in self._optional or (returned := self._call("interval")) is None:
            return None
        try:
            return checks.positive("interval", returned)
        except InvalidParameter:
            raise self._wrong("interval", returned, "a positive number of seconds, or None") from None

    def orientation(self) -> Vector | None:
        """The handle's orientation, if the device reports it: a unit quaternion w, x, y, z. HapnetError if it fails."""
        if "orientation" not in self._optional or (returned := self._call("orientation")) is None:
            return None
        turned = self._numbers("orientation", returned, "a quaternion, or None")
        if len(turned) != 4 or not abs(sum(part * part for part in turned) - 1.0) < _UNIT:
            raise self._wrong("orientation", turned, "a unit quaternion w, x, y, z, or None")
        return turned

    def signal(self, name: str, value: object) -> None:
        """Pass a value from the world to the device, if it has `signal`; HapnetError if it fails."""
        if self._can("signal"):
            self._call("signal", name, value)

    def vibrate(self, force: Vector) -> None:
        """Pass the grains' part of the force [N] to the device, if it vibrates; HapnetError if it fails."""
        if self._can("vibrate"):
            self._call("vibrate", force)

    def braked(self) -> str:
        """The reason why the device renders no force now; empty: it does. Raises HapnetError: it fails."""
        return str(self._call("braked")) if "braked" in self._optional else ""

    @property
    def jaw(self) -> bool:
        """Whether its last axis is the opening of a jaw."""
        return bool(getattr(self.device, "jaw", False))

    @property
    def missed(self) -> int:
        """Number of readings that the device made and the servo did not read, if the device counts them."""
        return int(getattr(self.device, "missed", 0) or 0)

    @property
    def blocks(self) -> bool:
        """Whether `read` waits for its next reading."""
        return bool(getattr(self.device, "blocking", False))

    def buttons(self) -> tuple[bool, ...]:
        """The states of the buttons at the last reading. Raises HapnetError: the device fails."""
        if "buttons" not in self._optional:
            return ()
        returned = self._call("buttons")
        wanted = "a True or False for each button"
        try:
            pressed = tuple(returned)
        except TypeError:
            raise self._wrong("buttons", returned, wanted) from None
        if not all(isinstance(one, bool | np.bool_) for one in pressed):  # the numbers of buttons would look released
            raise self._wrong("buttons", returned, wanted)
        return tuple(map(bool, pressed))

    def close(self) -> None:
        """Close the device; HapnetError if that fails."""
        if self._can("close"):
            self._call("close")

    def _can(self, part: str) -> bool:
        """Whether the driver has this optional method, not only another attribute of that name."""
        return callable(getattr(self.device, part, None))

    def _call(self, part: str, *given: object) -> Any:
        try:
            return getattr(self.device, part)(*given)
        except DeviceSilent:
            raise
        except BaseException as error:  # see `loading.failure`
            raise HapnetError(f"the device {self.name} failed: {part}() raised {failure(error)}") from error

    def _wrong(self, part: str, returned: object, wanted: str) -> HapnetError:
        shown = " ".join(f"{returned!r:.120}".split())
        return HapnetError(f"the device {self.name} failed: {part}() gave {shown} instead of {wanted}")

    def _numbers(self, part: str, returned: Any, wanted: str) -> Vector:
        try:
            return tuple(map(float, returned))
        except (TypeError, ValueError, OverflowError):
            raise self._wrong(part, returned, wanted) from None

    def _force(self, part: str, returned: Any, what: str) -> Vector | None:
        if returned is None:
            return None
        wanted = f"{what}, {self.dof} finite numbers, or None"
        force = self._numbers(part, returned, wanted)
        if len(force) != self.dof or not isfinite(sum(force)):
            raise self._wrong(part, force, wanted)
        if self.force_limit is not None and math.hypot(*force) > _MOST_REPORTED * self.force_limit:
            raise self._wrong(part, force, f"a force within its force_limit, {self.force_limit:g} N (is the unit N?)")
        if math.hypot(*force) > _MOST_REPORTED_N:
            raise self._wrong(part, force, f"a force of {_MOST_REPORTED_N:g} N at most (is the unit N?)")
        return force

    def _first_reading(self) -> tuple[Vector, Vector]:
        """The first reading; a device that has just been opened may be silent at first."""
        for _ in range(_FIRST_READINGS - 1):
            with suppress(DeviceSilent):
                return self.read()
        return self.read()

    def check_damping(self, name: str, damping: object) -> None:
        """Raise InvalidParameter if B [Ns/m] is outside the device's damping range on any axis."""
        if self.damping_range is not None:
            minimum, most = self.damping_range
            values = checks.diagonal(name, cast(ArrayLike, damping), self.dof)
            if min(values) < minimum * (1.0 - 1e-9) or max(values) > most * (1.0 + 1e-9):
                raise InvalidParameter(name, damping, f"{minimum:g} to {most:g} Ns/m, as the device renders")

    def check_set(self, params: Params) -> None:
        """Raise InvalidParameter if a value that the user set differs from the device's own declaration.

        The smaller force limit applies, so only a larger one is refused.
        """
        for part, name in _DECLARED.items():
            if (own := getattr(self.device, part, None)) is not None:
                allowed = f"left out: the device {self.name} declares its {part}, {own}"
                params.require(name, tuple(own) if isinstance(own, list) else own, allowed)
        if self.force_limit is not None and params.device.force_limit_N > self.force_limit:
            allowed = f"at most {self.force_limit:g}, the force_limit of the device {self.name}"
            params.require("device.force_limit_N", self.force_limit, allowed)

    def declares(self, section: Section) -> Section:
        """The parameters of a servo, replaced by this device's own declarations."""
        limits = [limit for limit in (section.force_limit_N, self.force_limit) if limit]
        return replace(
            section,
            force_limit_N=min(limits, default=0.0),
            resolution_m=self.resolution,
            greatest_speed=self.greatest_speed or section.greatest_speed,
            mass=self.smallest_mass or held_torque.UNKNOWN_MASS,
        )

    def limiter(self, params: DeviceParams) -> ForceLimiter:
        """The force limiter for this device, with the run's force ramp and dead-man switch.

        Raises InvalidParameter: device.dead_man is no button's number.
        """
        dead_man: int | None = self.dead_man
        if params.dead_man == "none":
            dead_man = None
        elif params.dead_man != "auto":
            if not params.dead_man.isdecimal():
                raise InvalidParameter("device.dead_man", params.dead_man, "auto, none or a button's number from 0")
            dead_man = int(params.dead_man)
            if dead_man >= (count := len(self.buttons())):
                raise InvalidParameter("device.dead_man", params.dead_man, f"a button of the device, which has {count}")
        if params.enable == "hold" and dead_man is None and self.buttons():
            dead_man = 0
        return ForceLimiter(
            ramp_s=params.force_ramp_s,
            dead_man=dead_man,
            peak=math.inf if self.force_limit is None else self.force_limit,
            continuous=self.continuous_force,
            thermal_s=self.thermal_s,
            rendered=3 if self.lacks_torque else None,
        )

    @property
    def lacks_torque(self) -> bool:
        """Whether it moves a tool, and renders the tool's force, not its torque."""
        return self._is_posed and not getattr(self.device, "gives_torque", True)

    def check(self, params: DeviceParams) -> ActuatorCheck | None:
        """The check with pushes at the start, within the allowed forces; None: no check.

        Raises InvalidParameter: device.known_mass_kg is not one number, or one for each axis.
        """
        limits = [limit for limit in (params.self_test_N, params.force_limit_N, self.force_limit) if limit]
        # along a pose's coordinates a handle's mass is not known
        if not params.self_test_N or self._is_posed:
            return None
        mass = checks.vector("device.known_mass_kg", cast(ArrayLike, params.known_mass_kg))
        if len(mass) not in (1, self.dof):
            raise InvalidParameter("device.known_mass_kg", params.known_mass_kg, f"one number, or {self.dof}")
        return ActuatorCheck(
            self.dof, min(limits), 1.0 / params.servo_hz, rounds=max(1, SELF_TEST_ROUNDS // self.dof),
            known_mass=mass if all(mass) else (), least_mass=self.smallest_mass,
        )  # fmt: skip

    def _positive(self, part: str) -> float | None:
        value = getattr(self.device, part, None)
        return None if value is None else checks.positive(part, value)

    def _damping_range(self) -> tuple[float, float] | None:
        if (value := getattr(self.device, "damping_range", None)) is None:
            return None
        minimum, most = checks.vector("damping_range", value, 2)
        if not 0.0 <= minimum < most:
            raise InvalidParameter("damping_range", value, "smallest and largest damping")
        return minimum, most

    def _dead_man(self) -> int | None:
        value = getattr(self.device, "dead_man", None)
        return None if value is None else checks.whole("dead_man", value, at_least=0)
