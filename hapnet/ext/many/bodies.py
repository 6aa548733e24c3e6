"""One body with several pairs: a simulated device, or a follower's robot that leads others.

Each edge keeps a complete device's side. It has an `EdgeDevice` in place of its simulated device: it reads the body's
motion, and holds its own edge's force. The body moves once a tick, under the sum of all held forces. So each edge
measures the work of just the force that it holds, and the damping of the body's couplings is harvested once.
"""

from __future__ import annotations

from typing import ClassVar, Protocol

from hapnet.checks import Vector
from hapnet.control.coupling import DeviceCoupling, Ends, Made
from hapnet.ext.robots.follower import Outside, Robot
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Operator
from hapnet.records.vectors import copy, inner
from hapnet.side.endpoint import NANO
from hapnet.side.punctuality import periods_until


class SharedBody(Protocol):
    """A body that moves under the forces of several edges; `devices` are those of its edges."""

    devices: list[EdgeDevice]

    @property
    def work_J(self) -> float:
        """Put in at the port of all edges' forces together so far, with the true positions [J]."""

    @property
    def motion(self) -> tuple[Vector, Vector]:
        """Its true position [m] and velocity [m/s]."""

    def reach(self, device: EdgeDevice, now_ns: int) -> int:
        """Move to the present time, unless that was done, and let the device of this edge know it. Returns the number
        of its periods in this tick."""


class EdgeDevice(SimulatedDevice):
    """A body as one of its edges has it: for an edge, all that moves the body but its own force is its hand.

    body : moves under the forces of all its edges. own : the device with this edge's share of mass, damping and limit.

    Its ticks do not wait: the other edges' forces need the body's next position.

    Attributes: begun, whether control of its edge has started; others_J, the work of all others since the
    last tick [J].
    """

    may_wait: ClassVar[bool] = False

    def __init__(self, body: SharedBody, own: SimulatedDevice) -> None:
        super().__init__(
            own.operator, mass=own.mass, damping=own.damping, period=own.period,
            resolution=own.resolution, force_limit=own.force_limit,
        )  # fmt: skip
        self.body = body
        self.begun = False
        self.others_J = 0.0
        self.place(body.motion[0])
        body.devices.append(self)

    def read(self) -> tuple[Vector, Vector]:
        if not self.begun:
            self.begun, self.others_J = True, 0.0
            self.show()
        return super().read()

    def shared_periods(self, now_ns: int) -> int:
        return self.body.reach(self, now_ns)

    def advance(self) -> float:
        """Take over what the body has reached. Returns the work of all that has moved it but this edge's force [J]."""
        self.ticks += 1
        self.time = self.ticks * self.period
        self.show()
        work, self.others_J = self.others_J, 0.0
        return work

    def show(self) -> None:
        """Take over the body's motion."""
        self.position, velocity = self.body.motion
        copy(self.dof, self.position, self.state.position)
        copy(self.dof, velocity, self.state.velocity)
        copy(self.dof, self.state.torque, self.state.actuator_force)


class HeldBody(SharedBody):
    """A simulated device in its hand.

    plant : without a force limit; each edge has its share of the limit. waits : whether it begins to move when control
    of all its edges has started; else with the first.
    """

    def __init__(self, plant: SimulatedDevice, *, waits: bool) -> None:
        self.devices = []
        self._plant, self._waits = plant, waits
        self._work_J = 0.0
        self._period_ns = round(plant.period / NANO)
        self._advanced_ns: int | None = None  # the time to which it was advanced; None: it does not move yet
        self._now_ns, self._periods = -1, 1  # of the last move

    @property
    def work_J(self) -> float:
        return self._work_J

    @property
    def motion(self) -> tuple[Vector, Vector]:
        return self._plant.position, self._plant.velocity

    def reach(self, device: EdgeDevice, now_ns: int) -> int:
        if now_ns == self._now_ns or (self._waits and not all(one.begun for one in self.devices)):
            return self._periods
        if self._advanced_ns is None:
            self._advanced_ns = now_ns - self._period_ns
        self._now_ns, self._periods = now_ns, periods_until(now_ns, self._advanced_ns, self._period_ns)
        self._advanced_ns += self._periods * self._period_ns
        self._move()
        return self._periods

    def _move(self) -> None:
        plant = self._plant
        force, *others = [one.state.torque for one in self.devices]
        for other in others:
            force = [one + more for one, more in zip(force, other, strict=True)]
        plant.apply(tuple(force))
        before = plant.position
        by_hand_J = 0.0
        for _ in range(self._periods):
            by_hand_J += plant.advance()
        moved = [end - begin for begin, end in zip(before, plant.position, strict=True)]
        self._work_J -= inner(force, moved)
        for one in self.devices:
            rest = [whole - own for whole, own in zip(force, one.state.torque, strict=True)]
            one.others_J += by_hand_J + inner(rest, moved)
            one.state.hand_force[:] = [hand + more for hand, more in zip(plant.hand_force, rest, strict=True)]
            one.references = plant.references


class RobotBody(SharedBody, Outside):
    """A follower's robot that leads others, or is held by a hand: what acts on it besides its leader and the contacts.

    start : its position at the start [m]. hand : that holds it where it starts, and moves; None: no hand holds it.
    """

    def __init__(self, start: Vector, hand: Operator | None) -> None:
        self.devices = []
        self.put_in_J = 0.0
        self.robot: Robot | None = None
        self._start, self._hand = start, hand
        self._offset = start
        if hand is not None:
            self._offset = tuple([x - at for x, at in zip(start, hand.reference(0.0), strict=True)])
        self._time_s = self._work_J = 0.0
        self._force, self._at = (0.0,) * len(start), start

    @property
    def work_J(self) -> float:
        return self._work_J - inner(self._force, self._since(self.motion[0]))

    @property
    def motion(self) -> tuple[Vector, Vector]:
        if self.robot is None:
            return self._start, (0.0,) * len(self._start)
        return self.robot.body.position, self.robot.body.velocity

    def reach(self, device: EdgeDevice, now_ns: int) -> int:
        """The robot has been moved by its leader's steps."""
        force = device.state.torque
        moved = [end - begin for begin, end in zip(device.position, self.motion[0], strict=True)]
        device.others_J -= inner(force, moved)
        device.state.hand_force[:] = [-one for one in force]
        return 1

    def acts(self, dt: float, position: Vector) -> tuple[Vector, float]:
        self._work_J -= inner(self._force, self._since(position))
        n = len(position)
        self._at = position
        self._force = push = tuple([sum(one.state.torque[i] for one in self.devices) for i in range(n)])
        hand = self._hand
        if hand is None:
            return push, 0.0
        begin, end = hand.reference(self._time_s), hand.reference(self._time_s + dt)
        self._time_s += dt
        K, B = hand.impedance.stiffness, hand.impedance.damping
        held = [
            K * (at + 0.5 * (a + b) - x) + B * (b - a) / dt
            for at, a, b, x in zip(self._offset, begin, end, position, strict=True)
        ]
        return tuple([one + more for one, more in zip(push, held, strict=True)]), B + 0.5 * K * dt

    def _since(self, position: Vector) -> list[float]:
        """The way since the force last changed [m]."""
        return [end - begin for begin, end in zip(self._at, position, strict=True)]


class EdgeEnds(Ends):
    """Puts an `EdgeDevice` of this body in place of an edge's simulated device. faster : makes the servo faster."""

    def __init__(self, body: SharedBody, faster: Ends | None = None) -> None:
        self._body, self._faster = body, faster or Ends()

    def servo(self, servo: DeviceCoupling) -> DeviceCoupling:
        return self._faster.servo(servo)

    def simulated(self, device: Made) -> Made:
        assert isinstance(device, SimulatedDevice), "graphs simulate their devices"
        return EdgeDevice(self._body, device)  # type: ignore[return-value]
