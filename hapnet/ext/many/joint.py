"""A world whose bodies several hands move: one step for all of them, a seat for each, and one environment account.

One hand may get what another has put in. So no single hand has an account of the bodies: the account has the work of
all hands together.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hapnet.checks import Vector
from hapnet.ext.robots.robot_scene import RobotScene
from hapnet.mechanics.contacts import Inverse, Observed, Surroundings
from hapnet.plant.worlds.account import EnvironmentAccount, settle
from hapnet.plant.worlds.picture import FREE, HERE, LEFT, SeenHand
from hapnet.plant.worlds.protocol import World, WorldDefaults
from hapnet.records.vectors import added


class Push(NamedTuple):
    """The causes of a robot's motion in a step besides the bodies: its drag [Ns/m], and the push on it (n,) [N]."""

    drag: float
    push: Vector


class JointWorld(ABC):
    """The bodies of a world, and the seats of its hands.

    Attributes: seats, in the order of their numbers; account, of the whole world since its start.
    """

    def __init__(self, dof: int) -> None:
        self.seats: list[JointSeat] = []
        self.account = EnvironmentAccount(_All(self, dof), ())

    @property
    @abstractmethod
    def stored_J(self) -> float:
        """The energy in all motion and all springs."""

    @property
    def supplied_J(self) -> float:
        """The work of the world's motors [J]."""
        return 0.0

    @property
    def dissipated_J(self) -> float:
        """The energy that its bodies have dissipated for certain, beside what the seats have got; 0: it is unknown."""
        return 0.0

    @property
    def observed(self) -> Observed | None:
        """The account of its observer; None: its bodies are passive by design."""
        return None

    @abstractmethod
    def bodies(self, seen_by: JointSeat) -> Sequence[int]:
        """The index of each seat's proxy among the poses of the picture for this seat; its own is not used."""

    @abstractmethod
    def begin_step(self, dt: float, moved_by: Mapping[JointSeat, Vector | Push]) -> None:
        """Solve a step of `dt` seconds for all hands together; each seat's proxy then moves in its own side's step.

        moved_by : what moves the proxies of the seats that take part, their set-positions ybar (n,) [m]; of a robot
        `Push`. A hand that is not here (`JointSeat.is_here`) acts on nothing.
        """

    def end_step(self) -> None:
        """Count a step that was begun for all hands together in all accounts."""
        stored, work, supplied = self.stored_J, added([seat.work for seat in self.seats]), self.supplied_J
        settle(self.account, work, stored, supplied)
        for seat in self.seats:
            if seat.joint is not None:
                settle(seat.joint, work - seat.joint.before_J, stored, supplied)

    def as_dict(self) -> dict[str, float]:
        """Its account for a summary [J]."""
        account, work = self.account, added([seat.work for seat in self.seats])
        found = {"env_slack_J": account.slack_min, "env_stored_J": account.stored_J, "work_J": work}
        if (observed := self.observed) is not None:
            found |= {"env_given_J": observed.given_J, "env_paid_J": observed.paid_J}
        return found


def dissipated_J(account: EnvironmentAccount, work: float) -> float:
    """The energy that has been dissipated where this work was put in at the hands [J]."""
    return account.supplied_J - work - (account.stored_J - account.start_J)


class JointSeat(WorldDefaults):
    """The world as one hand has it.

    shared : the world of all hands. number : of the hand. contacts : its surroundings, with this hand's work.

    Attributes: may_touch, whether its hand may act on the bodies, and is_here, whether it does; has_robot, whether its
    proxy is a robot, whose motion the world's account then has; work, what the world has put in at its port so far [J];
    joint, its account of the whole world (None: it is alone); hand, the name and the state of its hand.
    """

    shared: JointWorld
    moves_proxy = True
    """Only with a spring at the world is the proxy's step known before all hands' contacts act."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.may_touch = self.is_here = True
        self.has_robot = False
        self.work = 0.0
        self.joint: _JointAccount | None = None
        self.hand = SeenHand("", FREE, -1)

    @property
    def hands(self) -> tuple[SeenHand, ...]:
        seats = self.shared.seats
        bodies = {one: -1 if one is self else body for one, body in zip(seats, self.shared.bodies(self), strict=True)}
        return tuple([one.hand._replace(body=bodies[one]) for one in seats]) if len(seats) > 1 else ()

    def see(self, heard: bool) -> None:
        """Note whether its device is heard now."""
        state = HERE if heard else FREE if self.hand.state == FREE else LEFT
        if state != self.hand.state:
            self.hand = self.hand._replace(state=state)

    def environment_account(self, contacts: Surroundings, position: Vector) -> EnvironmentAccount:
        if len(self.shared.seats) == 1:
            return EnvironmentAccount(contacts, position)
        self.joint = _JointAccount(self, contacts, position)
        return self.joint


def seat_of(world: World) -> JointSeat | None:
    """The seat that this world is, or in which its robot is; None: its hand is alone there."""
    inside = world.scene if isinstance(world, RobotScene) else world
    return inside if isinstance(inside, JointSeat) else None


class _All(Surroundings):
    """The whole world, for its account."""

    def __init__(self, shared: JointWorld, dof: int) -> None:
        self._shared, self._dof = shared, dof

    @property
    def dof(self) -> int:
        return self._dof

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Vector, list[float]]:
        raise NotImplementedError("each seat has surroundings of its own")

    def stored_J(self, position: Sequence[float]) -> float:
        return self._shared.stored_J

    @property
    def supplied_J(self) -> float:
        return self._shared.supplied_J


class _JointAccount(EnvironmentAccount):
    """The account of the whole world since this seat began: no single hand has one of its own.

    before_J : the work of all hands before that.
    """

    def __init__(self, seat: JointSeat, contacts: Surroundings, position: Sequence[float]) -> None:
        super().__init__(contacts, position)
        self.start_J = self.stored_J = seat.shared.stored_J
        self._seat = seat
        self.before_J = added(one.work for one in seat.shared.seats)

    def observe(self, work: float, position: Sequence[float]) -> None:
        """Note this hand's work; the step is counted when all hands have made it (`JointWorld.end_step`)."""
        self._seat.work = work
