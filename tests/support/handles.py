"""A handle in a simulated hand, as a driver with one fault or none, in virtual time: for what looks for the fault."""

import math

from hapnet.checks import Vector


class Handle:
    """0.1 kg, 0.2 Ns/m, in a hand of 40 N/m and 4 Ns/m that rests, then goes 30 mm; counts of 10 um.

    Each class below has one fault. `now_ns` is the time of all of them.
    """

    force_limit, resolution = 3.0, 1e-5
    now_ns = 0
    gain, unit, velocity, late, dead = 1.0, 1.0, 1.0, 0, False
    smallest_mass: float | None = 0.1

    def __init__(self, dof: int) -> None:
        self.dof = dof
        self.x = self.v = 0.0
        self.lowest = self.highest = 0.0
        self.pushed: list[Vector] = []
        self.began_after: int | None = None
        self._at_ns = self._born_ns = Handle.now_ns

    def begin(self) -> None:
        self.began_after = sum(any(force) for force in self.pushed)

    def read(self) -> tuple[Vector, Vector]:
        steps = round((Handle.now_ns - self._at_ns) / 1e5)
        force = self.gain * self.pushed[-1 - self.late][0] if len(self.pushed) > self.late else 0.0
        for step in range(steps):
            age_s = (self._at_ns - self._born_ns) * 1e-9 + 1e-4 * step
            goal = 0.03 * min(1.0, max(0.0, age_s - 1.0))
            self.v += 1e-4 * (force + 40.0 * (goal - self.x) - 4.2 * self.v) / 0.1
            self.x += 1e-4 * self.v
        self._at_ns = Handle.now_ns
        self.lowest, self.highest = min(self.lowest, self.x), max(self.highest, self.x)
        read = 0.0 if self.dead else self.unit * 1e-5 * round(self.x / 1e-5)
        reported = 0.0 if self.dead else self.unit * self.velocity * self.v
        return (read, *(0.0,) * (self.dof - 1)), (reported, *(0.0,) * (self.dof - 1))

    def apply(self, force: Vector) -> None:
        self.pushed.append(force)

    @property
    def moved_m(self) -> float:
        return self.highest - self.lowest

    @property
    def hardest_N(self) -> float:
        return max((math.hypot(*force) for force in self.pushed), default=0.0)


class ReversedMotor(Handle):
    gain = -1.0


class ReversedEncoder(Handle):
    unit = -1.0


class Millimetres(Handle):
    unit = 1e3


class DeadEncoder(Handle):
    dead = True


class Doubled(Handle):
    gain = 2.0


class Late(Handle):
    late = 3


class Backwards(Handle):
    """Only its velocity has the wrong sign."""

    velocity = -1.0


FAULTS: tuple[tuple[type[Handle], str], ...] = (
    (ReversedMotor, "moves against its force: motor or encoder is reversed"),
    (ReversedEncoder, "moves against its force: motor or encoder is reversed"),
    (Millimetres, "are these millimetres"),
    (DeadEncoder, "reads the same while 0.3 N push it to and fro: is its encoder connected?"),
    (Doubled, "moves like 0.05 kg, but 0.1 kg are declared: is its force larger?"),
    (Late, "moves 3 readings after its force"),
    (Backwards, "reports -1 times the velocity of its positions"),
)
