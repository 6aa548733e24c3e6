"""Ends of the coupling tdpa, and their accounts watched."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import pytest

from hapnet.checks import Vector
from hapnet.control.coupling import PortSample
from hapnet.ext.laws import tdpa
from hapnet.ext.laws.parts import tdpa_world
from hapnet.ext.laws.parts.tdpa_world import PassivityObserver, TdpaWorld, Tuning
from hapnet.ext.laws.tdpa import TdpaDevice
from hapnet.params import Params
from hapnet.side.device import DeviceSide
from hapnet.side.world import WorldSide
from hapnet.simulation.simulation import Result, Simulation

TICK = 1e-3
NOTHING: dict[str, object] = {}
OFF: dict[str, object] = {
    "tdpa.velocity_floor": 1.0,
    "tdpa.damping_cap": 1e-9,
    "tdpa.force_floor": 1e9,
    "tdpa.debt_limit_J": 1e9,
    "tdpa.speed_limit": 100.0,
}
"""Both controllers switched off."""


def tuning(**changes: float) -> Tuning:
    plain = Tuning(
        stiffness_N_m=100.0, damping_Ns_m=3.0, velocity_floor_m_s=0.002, force_floor_N=0.05, damping_cap_Ns_m=5.0,
        speed_limit_m_s=0.25, debt_limit_J=0.02,
    )  # fmt: skip
    return dataclasses.replace(plain, **changes)


def device(x: Vector = (0.0,), **changes: float) -> TdpaDevice:
    return TdpaDevice(tuning(**changes), x)


def world(x: Vector = (0.0,), **changes: Any) -> TdpaWorld:
    predictor = changes.pop("predictor", None)
    return TdpaWorld(tuning(**changes), x, predictor)


def reported(law: TdpaDevice | TdpaWorld, x: Vector = (0.0,)) -> PortSample:
    sample = law.next_sample(x, x) if isinstance(law, TdpaDevice) else law.next_sample()
    assert isinstance(sample, PortSample)
    return sample


class Watched(PassivityObserver):
    """What was granted, the most that was owed, and the most that came out of a tick or a step."""

    def __init__(self) -> None:
        super().__init__()
        self.granted = self.most_owed = self.most_given = 0.0

    def observe(self, given: float, dissipated: float) -> None:
        super().observe(given, dissipated)
        self.most_owed = max(self.most_owed, self.debt)
        self.most_given = max(self.most_given, given)

    def receive(self, energy: float) -> None:
        before = self.debt
        super().receive(energy)
        self.granted += before - self.debt


@pytest.fixture(autouse=True, scope="module")
def watched() -> Iterator[None]:
    """Every law has its account watched."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (tdpa, tdpa_world):
            patch.setattr(module, "PassivityObserver", Watched)
        yield


def account(side: DeviceSide | WorldSide) -> Watched:
    law: Any = side.endpoint.coupling.law  # type: ignore[union-attr]
    return law.observer


def simulated(
    link: str, operator: str, duration: float, changes: dict[str, object] = NOTHING, *, seed: int = 1
) -> tuple[float, Result]:
    """The least energy put in at both ports [J], and the result."""
    params = Params().set(
        {
            "coupling": "tdpa", "operator": operator, "duration_s": duration, "link.up": link, "link.down": link,
            "record_hz": 100.0, **changes,
        }
    )  # fmt: skip
    run = Simulation(params, seed, kernel=False)  # compiled code does not call what watches
    result = run.run()
    return run.two_port.lowest, result
