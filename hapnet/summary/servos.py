"""Lines about a run's servos: how often they stalled, the energy that this cost, and the rate that they kept."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from hapnet.side.punctuality import KEPT, seconds
from hapnet.summary.structure import SIDES, SidePart, Summary
from hapnet.wire.messages import Role

DEFICIT_J = 1e-12
"""A deficit up to this is rounding [J]."""

WHOSE: Mapping[Role, str] = {"device": "", "world": "follower's "}


def leak(summary: Summary, *sides: Role) -> float:
    """Return the energy that held forces put out beyond the account while the servo stalled, at these sides or at both
    [J].
    """
    return sum(max(0.0, part["overrun_leak_J"] or 0.0) for side, part in parts(summary) if side in (sides or SIDES))


def stalls(summary: Summary) -> Iterator[str]:
    """Yield lines on stalls of the servos: how often, for how long, the energy that it cost, and time without force."""
    for side, part in parts(summary):
        servo, leaked = part["servo"], leak(summary, side)
        times, longest_ms, without_s = servo["overruns"], servo["longest_ms"], servo["without_force_s"]
        if times or leaked:
            often = "" if not times else f" {times} time{'s' if times > 1 else ''}"
            long = f", for up to {longest_ms:.0f} ms" if times and longest_ms is not None else ""
            cost = f": {milli(leaked)} mJ came out beyond the account" if leaked else ""
            yield f"the {WHOSE[side]}servo stalled for longer than watchdog_s{often}{long}{cost}"
        if without_s:
            yield f"{seconds(without_s)} s without force in all"
        if withheld_s := servo["withheld_s"]:
            yield f"no force for {withheld_s:.2g} s: the device's network process was stopped"


def rates(summary: Summary) -> Iterator[str]:
    """Yield a line for each servo that did not keep its rate, with the rate that it kept."""
    for side, part in parts(summary):
        servo, lasted_s = part["servo"], summary["duration_s"]
        ticks, skipped = servo["ticks"], servo["skipped"]
        if ticks and skipped and lasted_s and ticks < KEPT * (ticks + skipped):
            kept, wanted = ticks / lasted_s, (ticks + skipped) / lasted_s
            yield f"the {WHOSE[side]}servo did not keep its rate: {kept:.0f} of {wanted:.0f} ticks a second"


def parts(summary: Summary) -> Iterator[tuple[Role, SidePart]]:
    """The sides that have a part in the summary."""
    for side in SIDES:
        if (part := summary[side]) is not None:
            yield side, part


_MOST_J = 1e9
"""Only a false claim of a peer has more energy; tenths of a millijoule of it are no number of use."""


def milli(energy_J: float | None) -> str:
    """An energy in mJ with four digits; pure rounding shows as 0."""
    if energy_J is None or abs(energy_J) < DEFICIT_J:
        return "0"
    value = energy_J * 1e3
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e12 else f"{value:.4g}"


def milli_up(energy_J: float, of_J: float) -> str:
    """An energy in mJ, rounded upwards: to 0.1 mJ, or to less where the whole, `of_J`, is below 10 mJ."""
    if not (DEFICIT_J <= energy_J < _MOST_J and 0.0 < of_J < _MOST_J):
        return milli(energy_J)
    digits = max(1, 2 - math.floor(math.log10(of_J * 1e3)))
    value = energy_J * 1e3
    steps = math.ceil(value * 10.0**digits * (1.0 - 1e-12))  # 12.4 mJ is not 12.400000000000002
    text = f"{steps / 10**digits:.{digits}f}".rstrip("0").rstrip(".")
    return min(text, milli(of_J), key=float) if energy_J <= of_J else text


def milli_above(energy_J: float, limit_J: float) -> str:
    """An energy in mJ, with as many digits as show that it is above the limit."""
    if not limit_J < energy_J < math.inf:
        return milli(energy_J)
    texts = [milli(energy_J), *(f"{energy_J * 1e3:.{digits}g}" for digits in range(5, 18))]
    return next((text for text in texts if float(text) > float(milli(limit_J))), texts[-1])
