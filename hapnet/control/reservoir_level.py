"""How full a reservoir is, and how much energy it sends to an emptier one (ours).

Each side reports its level, the energy that its reservoir can spend as a share of the most that it can hold for that:

    L = (E + injected - reserve) / (ceiling - reserve),    0 <= L <= 1;    0 where the last set-position was modulated

`injected` is the energy in the spring that comes back by itself. At the world ybar moves, and comes back when the hand
withdraws, so it is phi. At the device x moves, and phi goes back to the hand, so it is 0.

A side whose level, without what is injected, is higher than the other's by more than `MARGIN` sends a part of the
difference:

    E_x += min(ceiling - reserve, `MOST_J`) (L - L_peer - MARGIN) dt / `SHARING_S`

So the levels approach each other, whichever side harvests. This energy is shuffled like any surplus, and credited
exactly once. The time constant is longer than most round trips, so that little goes back and forth. Energy that finds a
full reservoir is discarded. A silent peer is sent nothing. A level that is wrong, late or forged costs this side at
most what it can spend above its reserve: performance, never passivity.

Both functions are compiled for the kernel as they stand.
"""

from __future__ import annotations

from hapnet.records.record import equation

SHARING_S = 0.5
"""Time constant of the exchange [s]."""

MOST_J = 0.05
"""A reservoir of this room [J] is filled in that time: the other one may be smaller than this side's."""

MARGIN = 0.1
"""Levels that differ by less stay as they are."""


@equation
def level(energy: float, injected: float, reserve: float, ceiling: float, modulated: bool) -> float:
    """L. A reservoir that can hold nothing above its reserve needs nothing: 1.

    energy, injected, reserve, ceiling : [J]. modulated : did the energy not suffice for the last set-position?
    """
    room = ceiling - reserve
    if room <= 0.0:
        return 1.0
    if modulated:
        return 0.0
    return min(1.0, max(0.0, (energy + injected - reserve) / room))


@equation
def gift(dt: float, own: float, peer: float, room: float, spare: float) -> float:
    """The energy to send now [J].

    dt : time since the last update [s]. own, peer : levels; the peer's below 0: not known.
    room : ceiling less reserve [J]. spare : what must not stay here [J].
    """
    ahead = own - peer - MARGIN
    if peer < 0.0 or ahead <= 0.0 or spare <= 0.0:
        return 0.0
    return min(min(room, MOST_J) * ahead * min(1.0, dt / SHARING_S), spare)
