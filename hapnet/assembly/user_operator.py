"""A user's own hand, given as ``module:Class``: checked when it is made, and guarded while it runs."""

from __future__ import annotations

import math
from math import isfinite

from hapnet.checks import Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.loading import failure, load
from hapnet.plant.operating_range import in_millimetres
from hapnet.plant.operator import Impedance, Operator

ALLOWED = (
    "rest, sine, press, hand-N (N from 1), a recording's path (.csv, .mcap), or module:Class taking dof and impedance"
)


class UserOperator:
    """The operator `name`, made with ``dof`` and ``impedance``, and asked once for its reference.

    Later errors become one HapnetError that names the operator: whatever it raises, and a reference that is not as many
    finite numbers as the first, or is farther than `reach` [m] from the origin.

    Raises InvalidParameter: the operator cannot be made, has no impedance, or its first reference is not valid.
    """

    def __init__(self, name: str, dof: int, impedance: Impedance, reach: float = math.inf) -> None:
        self.name: str = name
        self._reach = reach
        make = load("operator", name, ALLOWED, ("rest", "sine", "press"))
        try:
            self._operator: Operator = make(dof=dof, impedance=impedance)
            self._axes = len(self._operator.reference(0.0))
        except BaseException as error:  # see `loading.failure`
            raise InvalidParameter("operator", name, f"{ALLOWED} ({failure(error)})") from error
        if not isinstance(getattr(self._operator, "impedance", None), Impedance):
            raise InvalidParameter("operator", name, f"{ALLOWED}; what it makes has no impedance")
        self.impedance: Impedance = self._operator.impedance
        try:
            self.reference(0.0)
        except HapnetError as error:
            raise InvalidParameter("operator", name, f"{ALLOWED} ({error})") from error

    def reference(self, t: float) -> Vector:
        """x_d [m] at `t` [s]; HapnetError if the operator fails."""
        try:
            x = tuple(map(float, self._operator.reference(t)))
        except BaseException as error:  # see `loading.failure`
            raise HapnetError(f"the operator {self.name} failed: reference({t:g}) raised {failure(error)}") from error
        if len(x) != self._axes or not isfinite(sum(x)):
            wanted = f"{self._axes} finite numbers"
            raise HapnetError(f"the operator {self.name} failed: reference({t:g}) gave {x} instead of {wanted}")
        if (far := math.hypot(*x)) > self._reach:
            wanted = f"a place within the {self._reach:g} m that the device reaches (device.workspace_m)"
            hint = in_millimetres(far, self._reach)
            raise HapnetError(f"the operator {self.name} failed: reference({t:g}) gave {x} instead of {wanted}{hint}")
        return x
