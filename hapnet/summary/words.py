"""Values of a summary as text: numbers in convenient units, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from hapnet.mechanics.pose import ARM_M
from hapnet.summary.structure import Summary, known
from hapnet.summary.verdict import DEFICIT_J, in_parts, judge
from hapnet.units import POSE, within

_WORDS = {True: "PASSIVE", False: "NOT PASSIVE", None: "PASSIVITY NOT KNOWN"}
_TEXT_LIMIT = 2000


def get(tree: Any, *keys: str) -> Any:
    """`tree[key][key]...`, or None where the branch ends early: for data of a recording, which may have any form."""
    for key in keys:
        tree = tree.get(key) if isinstance(tree, Mapping) else None
    return tree


def verdict(summary: object) -> str:
    """The verdict in one line: whether the two ports stayed passive, with the reason."""
    found = judge(summary)
    return f"{_WORDS[found['passive']]}: {found['reason']}"


def headline(summary: object) -> tuple[str, tuple[str, ...]]:
    """The verdict in one line, for a passive run only with the energy that it gave out; and the warnings left out."""
    found = in_parts(summary)
    if found.passive:
        return f"{_WORDS[True]}: {found.because[0]}", found.warnings
    return verdict(summary), ()


def outcome(summary: object) -> str:
    """The verdict as one word: good, bad or unknown."""
    return {True: "good", False: "bad", None: "unknown"}[judge(summary)["passive"]]


def legible(value: Any) -> Any:
    """`value` with printable texts of limited length: for data from elsewhere."""
    if isinstance(value, str):
        short = value if len(value) <= _TEXT_LIMIT else value[: _TEXT_LIMIT - 1] + "…"
        return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in short)
    if isinstance(value, Mapping):
        return {legible(key): legible(item) for key, item in value.items()}
    return [legible(item) for item in value] if isinstance(value, list) else value


def felt(environment: object, *, springs: bool = True, units: str | None = None) -> str | None:
    """The felt stiffness of the wall, and the springs, as text; None: there is no wall, or they are not known.

    environment : of a summary, or a side's reported `Felt`. units : of the axes.
    """
    wall, hand = (known(get(environment, name)) for name in ("stiffness_N_m", "felt_stiffness_N_m"))
    if wall is None or hand is None:
        return None
    listed = get(environment, "springs_N_m") if springs else None
    stiff = [value for one in listed if (value := known(one)) is not None] if isinstance(listed, list | tuple) else []
    unit, through = within(units, "N/m"), ""
    if stiff:
        through = f" through {'springs' if len(stiff) > 1 else 'a spring'} of {' and '.join(map(number, stiff))} {unit}"
        if units == POSE:
            through += f", {' and '.join(number(2.0 * ARM_M**2 * one) for one in stiff)} Nm/rad"
    return f"{number(wall)} {unit}, felt as {number(hand)} {unit}{through}"


def tuning(summary: Summary) -> str | None:
    """Describe the choice of the coupling's own rule, if the rule chose anything."""
    chosen = [name if value is True else f"{name} {number(value)}" for name, value in summary["tuning"].items()]
    return ", ".join(chosen) or None


def text(value: Any) -> str:
    return "-" if value is None else {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)


def number(value: Any) -> str:
    """The value with four digits; a whole number without a point."""
    if known(value) is None or isinstance(value, int):
        return text(value)
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e15 else f"{value:.4g}"


def rounded(value: float) -> str:
    """The value for people, with three digits."""
    return number(float(f"{value:.3g}"))


def milli(value: Any) -> str:
    """A value in joules, metres or seconds, shown in thousandths."""
    return text(value) if known(value) is None else number(value * 1e3 if value else 0)


def degrees(value: Any) -> str:
    """An angle in radians, shown in degrees."""
    return number(None if value is None else math.degrees(value))


def percent(value: Any) -> str:
    """A share in %."""
    return number(None if value is None else 100.0 * value)


def millijoule(value: Any) -> str:
    """As `milli`; a rounding error is shown as 0."""
    return milli(0 if known(value) is not None and abs(value) < DEFICIT_J else value)


def shuffled(energy_nJ: Any) -> str:
    """An energy in nanojoules, as the wire counts it, shown in millijoules."""
    return text(energy_nJ) if known(energy_nJ) is None else number(energy_nJ * 1e-6 if energy_nJ else 0)
