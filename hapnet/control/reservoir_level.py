"""The level of a reservoir, and the energy that it sends to an emptier reservoir (ours).

Each side reports its level: the energy that its reservoir can spend, as a share of the largest such energy:

    L = (E + injected - reserve) / (ceiling - reserve),    0 <= L <= 1;    0 where the last set-position was modulated

`injected` is the energy in the spring that comes back by itself. At the world it is phi: ybar moves, and comes back
when the hand withdraws. At the device it is 0: x moves, and phi goes back to the hand.

If a side's level (computed without `injected`) exceeds the other's by more than `MARGIN`, it sends a part of the
difference:

    E_x += min(ceiling - reserve, `MOST_J`) (L - L_peer - MARGIN) dt / `SHARING_S`

So the levels approach each other, whichever side harvests. This energy is shuffled like any surplus, and credited
exactly once. The time constant is longer than most round trips, so that little energy goes back and forth. A full
reservoir discards the energy. A silent peer receives none. A level that is wrong, late or forged costs this side at
most the energy above its reserve: performance, never passivity.
"""

from __future__ import annotations

from hapnet.records.record import equation

SHARING_S = 0.5
"""Time constant of the exchange [s]."""

MOST_J = 0.05
"""The largest room that counts in the exchange [J]: the other side's reservoir may be smaller than this side's."""

MARGIN = 0.1
"""The difference of levels below which no energy is sent."""


@equation
def level(energy: float, injected: float, reserve: float, ceiling: float, modulated: bool) -> float:
    """The level L; 1 if the reservoir has no room above its reserve, so that it needs no energy.

    energy, injected, reserve, ceiling : [J]. modulated : whether the energy did not suffice for the last set-position.
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

    dt : time since the last update [s]. own, peer : levels; a peer's level below 0 means unknown.
    room : ceiling less reserve [J]. spare : the most energy that may be sent [J].
    """
    ahead = own - peer - MARGIN
    if peer < 0.0 or ahead <= 0.0 or spare <= 0.0:
        return 0.0
    return min(min(room, MOST_J) * ahead * min(1.0, dt / SHARING_S), spare)
