"""A coupling of your own: a damper, and a spring to the last received position that is softer over longer delays.

hapnet run --coupling examples.own_law:Mine --set mine.stiffness=50
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hapnet import CouplingSpec, CouplingStart, Params, held_law, parameter, simulate, stepped_law

Vector = tuple[float, ...]


@dataclass(frozen=True)
class MineParams:
    """The law's parameters, in a section of `Params` with the law's name: mine.stiffness, mine.damping."""

    stiffness: float = parameter(100.0, "of the spring, if the link has no delay [N/m]")
    damping: float = parameter(1.5, "of either end [Ns/m]")


@dataclass(frozen=True)
class Tuning:
    stiffness_N_m: float
    damping_Ns_m: float


def tune(params: Params, link: Any) -> Tuning:  # the link's delays, emulated and real
    own = params.of(MineParams)
    return Tuning(own.stiffness / (1.0 + link.round_trip_bound_s / 0.1), own.damping)


class SpringAndDamper:
    """Either end: the device calls `force` and `release`, the world calls `begin`, `impedance` and `moved`."""

    def __init__(self, start: CouplingStart[Tuning]) -> None:
        self.K, self.B = start.tuning.stiffness_N_m, start.tuning.damping_Ns_m
        self.set_position = self.x = start.position

    def receive(self, sample: Any) -> None:
        self.set_position = sample

    def on_peer_changed(self) -> None: ...
    def begin(self) -> None: ...
    def force(self, dt: float, x: Vector, v: Vector, held: Vector) -> Vector:
        return tuple(-self.K * (a - y) - self.B * u for a, u, y in zip(x, v, self.set_position, strict=True))

    def release(self, dt: float, x: Vector, held: Vector) -> None:
        self.set_position = x

    def impedance(self, dt: float) -> tuple[float, Vector]:
        push = tuple(self.K * (y - x) for y, x in zip(self.set_position, self.x, strict=True))
        return self.B + 0.5 * self.K * dt, push

    def moved(self, dt: float, vhat: Vector, x: Vector, v: Vector) -> None:
        self.x = x

    def next_sample(self, x: Vector = (), v: Vector = ()) -> Any:
        return x or self.x  # the device passes x and v


ENDS = held_law(SpringAndDamper), stepped_law(SpringAndDamper)
ABOUT = "mine", "spring and damper", "this file", "passive nowhere"
Mine = CouplingSpec(*ABOUT, *ENDS, Tuning, tune, parameters=MineParams, shared=("stiffness_N_m",),
                    springs=lambda params, tuning: (tuning.stiffness_N_m,))  # fmt: skip

if __name__ == "__main__":
    print(simulate(Params(coupling=f"{__name__}:Mine"), seed=1).summary["verdict"]["reason"])
