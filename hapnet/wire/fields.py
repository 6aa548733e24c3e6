"""What each element of a frame may be: types for the messages' fields, each with the check that a receiver makes.

A check returns, or raises BadMessage. msgpack itself bounds integers to -2^63 .. 2^64 - 1.
"""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite, sqrt
from typing import Annotated, Any, Literal, get_type_hints

from hapnet.checks import (
    MAX_DOF as MAX_DOF,
    MOST_FRICTION,
    MOST_PLANES,
    UNIT_TOLERANCE,
    Scalar as Scalar,
    Signal as Signal,
    wrong_curvatures,
    wrong_effects,
)
from hapnet.errors import BadMessage
from hapnet.records.vectors import added

MAX_TEXT = 256
MAX_ABOUT = 32
MAX_MORE = 32
MAX_SIGNALS = 32
MAX_ACCOUNT = 64
MAX_COORDINATE = 1e6  # m or rad; keeps every square and product of the control layer finite
MAX_TOTAL_NJ = 2**63  # exclusive: totals fit a signed 64-bit integer
KEY_BYTES = 32
MAX_SPAN_NS = 10**10  # of a wave: every side sends far more often
MAX_INTEGRAL = 1e12  # sqrt(W) s: differences, and their squares over a nanosecond, stay finite
INTEGRAL = "integral"
"""The further entry of a wave: the integral of all waves of its sender's stream, and the sum of their spans in ns."""

CURVATURES = "curvatures"
"""The further entry of a proxy: how the surfaces bend that its planes touch."""

EFFECTS = "effects"
"""The further entry of a proxy: what the surface of each of its planes does at the device's rate; nil: nothing."""

FRICTION = "friction"
"""The further entry of a proxy: Coulomb's mu of each of its planes."""

LEVEL = "level"
"""The further entry of a position or a proxy: how full its sender's reservoir is, 0 to 1."""

REACH = "reach"
"""The further entry of a proxy: within this distance [m] there are no other planes than those that it has."""

ENCRYPTION_BYTES = 16
"""What encryption adds to a frame, besides the message that carries it."""

ENCRYPTS = "encrypts"
"""The further entry of a hello or a welcome of who can encrypt: must this pair?"""

KEY = "key"
"""The further entry of a hello or a welcome: its sender's public key, of X25519."""

ANSWERS = "answers"
"""The further entry of a hello that is addressed: incarnation and hello number of the side that it answers."""

TAG = "tag"
"""The last further entry of a frame that is sealed, which ends with these 8 bytes."""

SUMS = "sums"
"""The further entry of an energy message: its number, all that its sender sent [nJ], and the highest number it saw."""


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
        _scalar("about", entry)


def _scalar(owner: str, value: object) -> None:
    """A text, an integer, a finite float, a boolean or nil."""
    if type(value) is float:
        if not isfinite(value):
            raise BadMessage("range", f"{owner} has {value}; allowed: finite numbers")
    elif type(value) not in (int, bool, type(None)):
        text(value)


def flag(value: object) -> None:
    if type(value) is not bool:
        raise BadMessage("type", f"{_kind(value)}; allowed: a boolean")


def account(value: object) -> None:
    """As signals, but more of them."""
    signals(value, MAX_ACCOUNT)


def signals(value: object, most: int = MAX_SIGNALS) -> None:
    """A map of names to numbers, texts, booleans, nil, or arrays of numbers."""
    if type(value) is not dict:
        raise BadMessage("type", f"{_kind(value)}; allowed: a map")
    if len(value) > most:
        raise BadMessage("range", f"{len(value)} signals; allowed: up to {most}")
    for name, reported in value.items():
        text(name)
        if type(reported) is tuple and len(reported) > MAX_DOF:
            raise BadMessage("range", f"the signal {name} has {len(reported)} numbers; allowed: up to {MAX_DOF}")
        for part in reported if type(reported) is tuple else (reported,):
            if type(reported) is tuple and type(part) not in (float, int, bool):
                raise BadMessage("type", f"the signal {name} has {_kind(part)} in an array; allowed: numbers")
            _scalar(f"the signal {name}", part)


def more(value: object) -> None:
    """The map at a frame's end. An entry may be anything: a receiver ignores those that it does not know."""
    if type(value) is not dict:
        raise BadMessage("type", f"{_kind(value)}; allowed: the map of further entries")
    if len(value) > MAX_MORE:
        raise BadMessage("range", f"{len(value)} further entries; allowed: up to {MAX_MORE}")
    for key in value:
        text(key)


def public_key(value: object) -> None:
    if type(value) is not bytes or len(value) != KEY_BYTES:
        raise BadMessage("type", f"{_kind(value)}; allowed: a key of {KEY_BYTES} bytes")


def answers(value: object) -> None:
    """An incarnation and the number of one of its hellos."""
    if type(value) is not tuple or len(value) != 2:
        raise BadMessage("type", f"{_kind(value)}; allowed: an array of an incarnation and a number")
    if min(map(natural, value)) == 0:
        raise BadMessage("range", f"an answer to hello {value[1]} of {value[0]:#x}; allowed: from 1")


def ciphertext(value: object) -> None:
    if type(value) is not bytes or len(value) <= ENCRYPTION_BYTES:
        raise BadMessage("type", f"{_kind(value)}; allowed: more than {ENCRYPTION_BYTES} bytes")


def sums(value: object) -> None:
    """A message's number, a total in nJ, and another's number or 0."""
    if type(value) is not tuple or len(value) != 3:
        raise BadMessage("type", f"{_kind(value)}; allowed: an array of a number, a total and a number")
    number, sent_nJ, seen = value
    total(sent_nJ)
    if natural(number) == 0 or max(number, natural(seen)) > MAX_TOTAL_NJ:
        raise BadMessage("range", f"message {number}, which has seen {seen}; allowed: from 1, and from 0, below 2^63")


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
        square = added([n * n for n in normal])
        if abs(square - 1.0) > UNIT_TOLERANCE:
            raise BadMessage("range", f"a plane's normal of length {sqrt(square):g}; allowed: 1")
        if plane[2] <= 0.0 or plane[3] < 0.0:
            raise BadMessage("range", f"a plane's stiffness {plane[2]} and damping {plane[3]}; allowed: above 0, 0")


def curvatures(value: object, planes: Planes) -> None:
    """Of planes: for each an array of up to two, a direction and a number."""
    if type(value) is not tuple or planes is None or len(value) != len(planes):
        raise BadMessage("type", f"{_kind(value)}; allowed: an array with the curvatures of each plane")
    for (normal, *_), bends in zip(planes, value, strict=True):
        if type(bends) is not tuple or not all(map(_is_bend, bends)):
            raise BadMessage("type", "a plane's curvatures are not an array of a direction and a float each")
        if wrong := wrong_curvatures(bends, normal):
            raise BadMessage("range", wrong)


def friction(value: object, planes: Planes) -> None:
    """Of planes: for each a float."""
    if type(value) is not tuple or planes is None or len(value) != len(planes):
        raise BadMessage("type", f"{_kind(value)}; allowed: an array with the friction of each plane")
    if not all(type(mu) is float for mu in value):
        raise BadMessage("type", "a friction that is no float")
    if not all(0.0 <= mu <= MOST_FRICTION for mu in value):  # false for NaN as well
        raise BadMessage("range", f"a friction that is not within 0 to {MOST_FRICTION:g}")


def effects(value: object, planes: Planes) -> None:
    """Of planes: for each nil, or four floats and a grain: nil, or floats, a float and a byte string."""
    if type(value) is not tuple or planes is None or len(value) != len(planes):
        raise BadMessage("type", f"{_kind(value)}; allowed: an array with the effects of each plane's surface")
    for (normal, *_), one in zip(planes, value, strict=True):
        if one is None:
            continue
        if not _are_effects(one):
            raise BadMessage("type", "a surface's effects are not four floats and a grain, or nil")
        if wrong := wrong_effects(one, len(normal)):
            raise BadMessage("range", wrong)


def _are_effects(one: object) -> bool:
    if type(one) is not tuple or len(one) != 5 or not all(type(number) is float for number in one[:4]):
        return False
    match one[4]:
        case None:
            return True
        case (tuple(wave), float(), bytes()):
            return all(type(part) is float for part in wave)
    return False


def level(value: object) -> None:
    """A float from 0 to 1."""
    if type(value) is not float:
        raise BadMessage("type", f"a level {_kind(value)}; allowed: a float")
    if not 0.0 <= value <= 1.0:  # false for NaN as well
        raise BadMessage("range", f"a level of {value}; allowed: 0 to 1")


def level_in(message: Any) -> float | None:
    """The level in a position's or a proxy's further entries; None: it is not there."""
    return None if message.more is None else message.more.get(LEVEL)


def is_only_level(value: object) -> bool:
    """Is it a map of further entries with a level and nothing else? Nearly every position has such a map."""
    return type(value) is dict and len(value) == 1 and type(full := value.get(LEVEL)) is float and 0.0 <= full <= 1.0


def reach(value: object) -> None:
    """A float within the range of coordinates, not below 0."""
    if type(value) is not float:
        raise BadMessage("type", f"a reach {_kind(value)}; allowed: a float")
    if not 0.0 <= value <= MAX_COORDINATE:
        raise BadMessage("range", f"a reach of {value} m; allowed: 0 to {MAX_COORDINATE:g}")


def unfolded(curvatures: Any, planes: Planes, position: tuple[float, ...]) -> None:
    """Of checked curvatures: no centre is nearer to `position` than the surface, or that would not be the nearest."""
    for (normal, offset, *_), bends in zip(planes or (), curvatures, strict=True):
        depth = added([n * x for n, x in zip(normal, position, strict=True)]) - offset
        if not all(per_m * depth < 1.0 for _, per_m in bends):
            raise BadMessage("range", f"a curvature whose centre is before the surface, {depth} m in")


def _is_bend(bend: object) -> bool:
    if type(bend) is not tuple or len(bend) != 2 or type(bend[0]) is not tuple or type(bend[1]) is not float:
        return False
    return all(type(part) is float for part in bend[0])


def _kind(value: object) -> str:
    return f"of type {type(value).__name__}"


Role = Literal["device", "world"]

U64 = Annotated[int, natural]
Nanojoules = Annotated[int, total]
Span = Annotated[int, span]
Coordinates = Annotated[tuple[float, ...], coordinates]
Text = Annotated[str, text]
RoleName = Annotated[Role, role]
Dof = Annotated[int, dof]
Planes = Annotated[tuple[tuple[tuple[float, ...], float, float, float, float], ...] | None, planes]
About = Annotated[dict[str, Scalar], about]
SignalMap = Annotated[dict[str, Signal], signals]
AccountMap = Annotated[dict[str, Signal], account]
Flag = Annotated[bool, flag]
Ciphertext = Annotated[bytes, ciphertext]
More = Annotated[dict[str, Any], more]
"""What a frame's map of further entries says."""


def printable(text: str) -> str:
    """What a receiver takes as a text."""
    return "".join(c if c.isprintable() else " " for c in text)[:MAX_TEXT]


def checks_of(message: type, names: tuple[str, ...]) -> tuple[Callable[[object], object], ...]:
    """The checks of these fields of a message's class, as their types name them."""
    types = get_type_hints(message, include_extras=True)
    return tuple(types[name].__metadata__[0] for name in names)


def surroundings(position: Any, force: Any, planes: Any, more: dict[str, Any]) -> None:
    """Of a proxy: its force, its planes and the entries about their surfaces have to fit together."""
    if any(len(vector) != len(position) for vector in (force, *(plane[0] for plane in planes or ()))):
        raise BadMessage("dimension", f"{len(position)} coordinates with a force or a normal of others")
    if CURVATURES in more:
        curvatures(more[CURVATURES], planes)
        unfolded(more[CURVATURES], planes, position)
    if FRICTION in more:
        friction(more[FRICTION], planes)
    if EFFECTS in more:
        effects(more[EFFECTS], planes)
