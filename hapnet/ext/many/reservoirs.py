"""The reservoirs of a world's seats: an idle seat is filled again, and the seats of a group may share what they have.

Each seat i is the world's half of a pair. With the work W_i of the blocks on its proxy, its account is

    slack_i = W_i + V_i(0) + E_i(0) + credited_i - sent_i - V_i - E_i >= 0                      (ledger.py)

and the blocks have one account for all hands: with U, the energy in their motion and springs, they have dissipated

    D = -sum W_i - (U - U(0)) >= 0                         drag, dampers of contacts, contacts that were let go

**Refill.** Whoever joins starts empty and gets half of what the seat holds (`on_peer_changed`); what a killed device
held is lost. So a seat that is used often runs dry. When no device has been heard for `seat_refill_s`, the seat gets
R_i out of D, up to its ceiling, and again after as long. R_i is booked as work of the blocks on this seat: E_i and W_i
both rise by R_i, so slack_i and d^2 = V_i(0) + E_i(0) stay, and D falls by R_i. With `sum R_i <= D` at any time, D
stays above 0, for what has been dissipated never comes back by itself. Add the halves of all devices and seats and D:

    sum over devices of W  >=  -sum over pairs of d_i^2 - U(0)

as without refills: all that a seat gets was put in by hands before. It is bounded twice, by D and by a ceiling in
`seat_refill_s`, so that nobody draws power from the others' work by coming and going. A seat with a device gets
nothing: its hand fills the reservoir by its own work.

**Pooled.** In a trusted group (``world.reservoir = "pooled"``) a seat whose energy did not suffice for its last
set-position takes the missing energy out of what the other seats can spare, and at most up to its ceiling. The smallest
needs are met first; those who can spare more give more. A transfer T from i to j is booked as work too: W_i and E_i
fall by T, W_j and E_j rise by T. Both slacks, both d^2, sum W_i and so D stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.couplings import registry
from hapnet.errors import InvalidParameter
from hapnet.ext.many import joint
from hapnet.ext.many.joint import seat_of
from hapnet.ext.robots.follower import Robot
from hapnet.mechanics import spring as springs
from hapnet.params import Params
from hapnet.plant.worlds.protocol import World
from hapnet.records.vectors import added
from hapnet.side.endpoint import NANO
from hapnet.side.world import WorldSide
from hapnet.wire.session import Session

SEPARATE, POOLED = "separate", "pooled"


@dataclass
class SeatAccount:
    """The energy that a seat's reservoir has taken in and given out, beside its pair [J].

    used_J : the sum of all jumps (11): the energy that its set-positions took, less what they gave back.
    got_J, given_J : from and to other seats. refilled_J : out of what the blocks have dissipated.
    heard_ns : when a device was last heard, or the seat was filled. updates : of the coupling, as counted in used_J.
    """

    used_J: float = 0.0
    got_J: float = 0.0
    given_J: float = 0.0
    refilled_J: float = 0.0
    heard_ns: int | None = None
    updates: int = 0


class Reservoirs:
    """The reservoirs of a world with several hands; without PSPM's reservoirs there is nothing to do.

    refill_s : a seat that is idle for so long is filled [s]; 0: never. pooled : whether the seats share their energy.
    accounts : of the seats, by their sides.
    """

    def __init__(self, refill_s: float, *, pooled: bool) -> None:
        self.refill_s, self.pooled = refill_s, pooled
        self.accounts: dict[WorldSide, SeatAccount] = {}

    @classmethod
    def of(cls, params: Params, scene: World) -> Reservoirs:
        """With the parameters and the scene of one of the world's pairs. Raises InvalidParameter: its energy cannot be
        shared, as the coupling has no reservoirs, or an engine keeps the account of its proxies."""
        spec = registry.known(params.coupling)
        has_own = spec is not None and spec.halves and spec.continuous is not None  # only with PSPM at both ends
        if params.world.reservoir == POOLED and not has_own:
            allowed = f"{SEPARATE} with the coupling {params.coupling}: it has no PSPM at the world"
            raise InvalidParameter("world.reservoir", POOLED, allowed)
        if params.world.reservoir == POOLED and (seat := seat_of(scene)) and seat.shared.observed is not None:
            allowed = f"{SEPARATE} in the scene {params.scene}: the engine keeps the account of its proxies"
            raise InvalidParameter("world.reservoir", POOLED, allowed)
        return cls(params.world.seat_refill_s, pooled=params.world.reservoir == POOLED)

    def begin_step(self, now_ns: int, sides: Sequence[tuple[WorldSide, Session]]) -> None:
        """Share the energy of the seats, if they have one reservoir."""
        if self.pooled:
            with_one = [(side, session) for side, session in sides if _reservoir(side) is not None]
            needs = [_need(side) if is_heard(session, now_ns) else 0.0 for side, session in with_one]
            self._share([side for side, _ in with_one], needs)

    def end_step(self, now_ns: int, sides: Sequence[tuple[WorldSide, Session]]) -> None:
        """Count a step that all sides have made, and fill the idle seats."""
        idle: list[WorldSide] = []
        for side, session in sides:
            if (coupling := _reservoir(side)) is None:
                continue
            account = self.accounts.setdefault(side, SeatAccount())
            if coupling.updates > account.updates:
                account.used_J += coupling.modulator.jump
                account.updates = coupling.updates
            if account.heard_ns is None or is_heard(session, now_ns):
                account.heard_ns = now_ns
            elif self.refill_s and now_ns - account.heard_ns >= self.refill_s / NANO:
                account.heard_ns = now_ns
                idle.append(side)
        for number, side in enumerate(idle):  # those who come later get their share too
            self._refill(side, 1.0 / (len(idle) - number))

    def _refill(self, side: WorldSide, share: float) -> None:
        coupling = _reservoir(side)
        assert coupling is not None, "an idle seat has one"
        modulator = coupling.modulator
        energy = min(modulator.ceiling - modulator.energy, share * dissipated_J(side))
        if energy > 0.0:
            coupling.rest()  # else the spring would take it, to come nearer to the last set-position of who has left
            _put_in(side, coupling, energy)
            self.accounts[side].refilled_J += energy

    def _share(self, sides: Sequence[WorldSide], missing: Sequence[float]) -> None:
        """Give each seat what is missing there [J], the smallest needs first."""
        needs = sorted([(need, k) for k, need in enumerate(missing) if need > 0.0], reverse=True)
        needy = {k for _, k in needs}
        while needs:
            spare = {k: _spare(side) for k, side in enumerate(sides) if k not in needy}
            if (there := added(spare.values())) <= 0.0:
                return
            share = there / len(needs)
            need, k = needs.pop()
            for other, much in spare.items():
                self._transfer(sides[other], sides[k], min(need, share) * much / there)

    def _transfer(self, giver: WorldSide, taker: WorldSide, energy: float) -> None:
        for side, way in ((giver, -1.0), (taker, 1.0)):
            coupling = _reservoir(side)
            assert coupling is not None, "only such seats share"
            _put_in(side, coupling, way * energy)
        self.accounts.setdefault(giver, SeatAccount()).given_J += energy
        self.accounts.setdefault(taker, SeatAccount()).got_J += energy

    def as_dict(self, names: Sequence[tuple[str, WorldSide]]) -> dict[str, Any]:
        """For a summary: the kind, the time of refills, and the account of each seat [J] by its name."""
        seats = {}
        for name, side in names:
            one, coupling = self.accounts.get(side, SeatAccount()), _reservoir(side)
            seats[name] = {
                "used_J": one.used_J, "got_J": one.got_J, "given_J": one.given_J, "refilled_J": one.refilled_J,
                "left_J": None if coupling is None else coupling.reservoir,
            }  # fmt: skip
        return {"kind": POOLED if self.pooled else SEPARATE, "seat_refill_s": self.refill_s, "seats": seats}


def is_heard(session: Session, now_ns: int) -> bool:
    """Whether a device is there, and not silent."""
    return session.peer is not None and not session.monitor.is_silent(now_ns)


def dissipated_J(side: WorldSide) -> float:
    """The energy that the environment of this side has dissipated, and that no seat has got [J]; shared bodies with all
    hands."""
    seat, account = seat_of(side.scene), side.environment
    if seat is not None:
        return seat.shared.dissipated_J
    if account is None:
        return 0.0
    return joint.dissipated_J(account, side.mass.port_J(side.coupling.ledger.work))


def _reservoir(side: WorldSide) -> SetPositionCoupling | None:
    """The coupling with this side's reservoir; None: control has not started, or its law has none."""
    if side.origin_ns is None or not isinstance(coupling := side.coupling, SetPositionCoupling):
        return None
    return coupling if coupling.passive else None


def _put_in(side: WorldSide, coupling: SetPositionCoupling, energy: float) -> None:
    """Add `energy` [J] to the reservoir, as work at the seat's port."""
    coupling.modulator.energy += energy
    coupling.account = coupling.modulator.account
    coupling.ledger.put_in(energy)
    if isinstance(side.mass, Robot):
        side.mass.done_J += energy
    if (seat := seat_of(side.scene)) is not None:
        seat.work = side.mass.port_J(coupling.ledger.work)


def _need(side: WorldSide) -> float:
    """The energy that the last set-position lacked, as far as the reservoir has room for it [J]."""
    coupling = _reservoir(side)
    assert coupling is not None, "only such seats share"
    modulator = coupling.modulator
    if not modulator.modulated:
        return 0.0
    lacked = springs.between(modulator.spring, coupling.y, coupling.place) - modulator.stored
    return min(lacked, modulator.ceiling - modulator.energy)


def _spare(side: WorldSide) -> float:
    """The energy above the reserve [J]."""
    coupling = _reservoir(side)
    assert coupling is not None, "only such seats share"
    return max(0.0, coupling.modulator.energy - coupling.modulator.reserve)
