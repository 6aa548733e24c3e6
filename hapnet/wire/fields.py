"""What each element of a frame may be: types for the messages' fields, each with the check that a receiver makes.

A check returns, or raises BadMessage. msgpack itself bounds integers to -2^63 .. 2^64 - 1.
"""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite, sqrt
from typing import Annotated, Any, Literal, get_type_hints

from hapnet.checks import MOST_PLANES, UNIT_TOLERANCE
from hapnet.errors import BadMessage

MAX_DOF = 64
MAX_TEXT = 256
MAX_ABOUT = 32
MAX_MORE = 32
MAX_COORDINATE = 1e6  # m or rad; keeps every square and product of the control layer finite
MAX_TOTAL_NJ = 2**63  # exclusive: totals fit a signed 64-bit integer
MAX_SPAN_NS = 10**10  # of a wave: every side sends far more often
MAX_INTEGRAL = 1e12  # sqrt(W) s: differences, and their squares over a nanosecond, stay finite
INTEGRAL = "integral"
"""The further entry of a wave: the integral of all waves of its sender's stream, and the sum of their spans in ns."""


def natural(value: object) -> int:
    if type(value) is not int:
        raise BadMessage("type", f"{_kind(value)}; allowed: an integer")
    if value < 0:
        raise BadMessage("range", f"{value}; allowed: 0 or above")
    return value


def total(value: object) -> None:
    if natural(value) >= MAX_TOTAL_NJ:
        raise BadMessage("range", f"{value} nJ; allowed: below 2^63")


def span(value: object) -> None:
    if not 1 <= natural(value) <= MAX_SPAN_NS:
        raise BadMessage("range", f"a span of {value} ns; allowed: 1 to {MAX_SPAN_NS}")


def coordinates(value: object) -> None:
    if type(value) is not tuple:
        raise BadMessage("type", f"{_kind(value)}; allowed: an array of floats")
    if not 1 <= len(value) <= MAX_DOF:
        raise BadMessage("dimension", f"{len(value)} coordinates; allowed: 1 to {MAX_DOF}")
    for x in value:
        if type(x) is not float:
            raise BadMessage("type", f"a coordinate is {_kind(x)}; allowed: a float")
        if not -MAX_COORDINATE <= x <= MAX_COORDINATE:  # false for NaN as well
            raise BadMessage("range", f"coordinate {x}; allowed: finite, within +-{MAX_COORDINATE:g}")


def text(value: object) -> None:
    if type(value) is not str:
        raise BadMessage("type", f"{_kind(value)}; allowed: text")
    if len(value) > MAX_TEXT or not value.isprintable():
        raise BadMessage("range", f"text of {len(value)} characters; allowed: up to {MAX_TEXT}, all printable")


def role(value: object) -> None:
    text(value)
    if value not in ("device", "world"):
        raise BadMessage("range", f"role {value!r}; allowed: device, world")


def dof(value: object) -> None:
    if not 1 <= natural(value) <= MAX_DOF:
        raise BadMessage("dimension", f"{value} degrees of freedom; allowed: 1 to {MAX_DOF}")


def about(value: object) -> None:
    if type(value) is not dict:
        raise BadMessage("type", f"{_kind(value)}; allowed: a map")
    if len(value) > MAX_ABOUT:
        raise BadMessage("range", f"about has {len(value)} entries; allowed: up to {MAX_ABOUT}")
    for key, entry in value.items():
        text(key)
        if type(entry) is float:
            if not isfinite(entry):
                raise BadMessage("range", f"about has {entry}; allowed: finite numbers")
        elif type(entry) not in (int, bool, type(None)):
            text(entry)


def more(value: object) -> None:
    """The map at a frame's end. An entry may be anything: a receiver ignores those that it does not know."""
    if type(value) is not dict:
        raise BadMessage("type", f"{_kind(value)}; allowed: the map of further entries")
    if len(value) > MAX_MORE:
        raise BadMessage("range", f"{len(value)} further entries; allowed: up to {MAX_MORE}")
    for key in value:
        text(key)


def integral(value: object, dof: int) -> None:
    """Of waves with `dof` components: that many floats, and a time in ns."""
    if type(value) is not tuple or len(value) != 2 or type(value[0]) is not tuple:
        raise BadMessage("type", f"{_kind(value)}; allowed: an array of an integral and a time")
    vector, elapsed_ns = value
    if len(vector) != dof:
        raise BadMessage("dimension", f"an integral of {len(vector)} components; allowed: {dof}")
    if not all(type(part) is float for part in vector):
        raise BadMessage("type", "an integral with a component that is no float")
    if not all(abs(part) <= MAX_INTEGRAL for part in vector):  # false for NaN as well
        raise BadMessage("range", f"an integral with a component that is not finite, or not within +-{MAX_INTEGRAL:g}")
    natural(elapsed_ns)


def planes(value: object) -> None:
    """Nothing, or up to four planes: unit normal, offset, stiffness above 0, damping and velocity."""
    if value is None:
        return
    if type(value) is not tuple:
        raise BadMessage("type", f"{_kind(value)}; allowed: an array of planes, or nil")
    if len(value) > MOST_PLANES:
        raise BadMessage("range", f"{len(value)} planes; allowed: up to {MOST_PLANES}")
    for plane in value:
        if type(plane) is not tuple or len(plane) != 5:
            raise BadMessage("type", "a plane is not an array of normal, offset, stiffness, damping, velocity")
        normal, *numbers = plane
        coordinates(normal)
        coordinates(tuple(numbers))
        square = sum([n * n for n in normal])
        if abs(square - 1.0) > UNIT_TOLERANCE:
            raise BadMessage("range", f"a plane's normal of length {sqrt(square):g}; allowed: 1")
        if plane[2] <= 0.0 or plane[3] < 0.0:
            raise BadMessage("range", f"a plane's stiffness {plane[2]} and damping {plane[3]}; allowed: above 0, 0")


def _kind(value: object) -> str:
    return f"of type {type(value).__name__}"


Role = Literal["device", "world"]
Scalar = str | int | float | bool | None

U64 = Annotated[int, natural]
Nanojoules = Annotated[int, total]
Span = Annotated[int, span]
Coordinates = Annotated[tuple[float, ...], coordinates]
Text = Annotated[str, text]
RoleName = Annotated[Role, role]
Dof = Annotated[int, dof]
Planes = Annotated[tuple[tuple[tuple[float, ...], float, float, float, float], ...] | None, planes]
About = Annotated[dict[str, Scalar], about]
More = Annotated[dict[str, Any], more]
"""What a frame's map of further entries says."""


def checks_of(message: type, names: tuple[str, ...]) -> tuple[Callable[[object], object], ...]:
    """The checks of these fields of a message's class, as their types name them."""
    types = get_type_hints(message, include_extras=True)
    return tuple(types[name].__metadata__[0] for name in names)
