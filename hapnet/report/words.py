"""Values of a summary in words: numbers in the units that people read, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from hapnet.runtime.couplings import KINDS, jointly_passive
from hapnet.runtime.summary import stopped

ROUNDING_J = 1e-9
"""A margin is called negative below minus this [J]: what minutes of double precision may add up to."""

_NOTHING_J = 1e-12  # printed as 0: rounding
_TEXT_LIMIT = 2000


def verdict(summary: Mapping[str, Any] | None) -> str:
    """One line: whether the two ports stayed passive, and by how much of the bound d^2."""
    theorem = get(summary, "theorem")
    margin, bound = known(get(theorem, "margin_J")), known(get(theorem, "bound_J"))
    who = ""
    if margin is None:  # one process knows its own half only
        told = {side: known(get(summary, side, "ledger", "margin_J")) for side in ("device", "world")}
        halves = {side: value for side, value in told.items() if value is not None}
        if not halves:
            return "passivity unknown: no ledger"
        if jointly_passive(get(summary, "coupling")):
            if len(halves) == 2:
                return "passivity unknown: of both ports together only, and both were not seen at the same time"
            return "passivity unknown: of both ports together only; hapnet report DEVICE WORLD tells"
        who = "both halves " if len(halves) == 2 else f"{next(iter(halves))}'s half "
        margin = sum(halves.values())
        bounds = [known(get(summary, side, "ledger", "bound_J")) for side in halves]
        bound = None if None in bounds else sum(value for value in bounds if value is not None)
    of = "" if bound is None else f" of d² = {milli(bound)} mJ"
    if margin < -ROUNDING_J:
        return f"{who}NOT passive: margin {millijoule(margin)} mJ{of}"
    return f"{who}passive: margin ≥ {millijoule(margin)} mJ{of}"


def force_stopped(summary: Mapping[str, Any] | None) -> str | None:
    """One line, if the device's force was stopped on the way; None if not."""
    line = stopped(summary) if isinstance(get(summary, "device", "stopped"), Mapping) else None
    return None if line is None else str(legible(line))


def outcome(line: str) -> str:
    """Of a verdict: good, bad or unknown."""
    return "bad" if "NOT" in line else "unknown" if "unknown" in line else "good"


def has_reservoirs(coupling: Any) -> bool:
    """Does it keep energy in reservoirs and shuffle it? Not those that are known to do without."""
    return str(coupling) == "pspm" or str(coupling) not in KINDS


def get(tree: Any, *keys: str) -> Any:
    """`tree[key][key]...`, or None where the branch ends early."""
    for key in keys:
        tree = tree.get(key) if isinstance(tree, Mapping) else None
    return tree


def known(value: Any) -> float | None:
    """`value` if it is a finite number."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return value if number and math.isfinite(value) else None


def legible(value: Any) -> Any:
    """`value`, in its texts a replacement for all that does not print, and none too long: for data from elsewhere."""
    if isinstance(value, str):
        short = value if len(value) <= _TEXT_LIMIT else value[: _TEXT_LIMIT - 1] + "…"
        return (
            short
            if short.isprintable()
            else "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in short)
        )
    if isinstance(value, Mapping):
        return {legible(key): legible(item) for key, item in value.items()}
    return [legible(item) for item in value] if isinstance(value, list) else value


def tuning(summary: Any) -> str | None:
    """What the coupling's own rule chose, if it had anything to choose."""
    chosen = get(summary, "tuning")
    chosen = chosen.items() if isinstance(chosen, Mapping) else ()
    return ", ".join(f"{name} {number(value)}" for name, value in chosen) or None


def text(value: Any) -> str:
    return "-" if value is None else str(value)


def number(value: Any) -> str:
    """Four digits, whole numbers whole."""
    if known(value) is None or isinstance(value, int):
        return text(value)
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"


def milli(value: Any) -> str:
    """Joules, metres or seconds in thousandths."""
    return text(value) if known(value) is None else number(value * 1e3 if value else 0)


def millijoule(value: Any) -> str:
    """As `milli`; what is pure rounding is 0."""
    return milli(0 if known(value) is not None and abs(value) < _NOTHING_J else value)


def exact_joule(value_nJ: Any) -> str:
    """Whole nanojoules in joules, to the last digit."""
    if not isinstance(value_nJ, int):
        return text(value_nJ)
    whole, rest = divmod(abs(value_nJ), 1_000_000_000)
    return f"{'-' if value_nJ < 0 else ''}{whole}.{rest:09d}"
