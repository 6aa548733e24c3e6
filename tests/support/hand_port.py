"""A run in virtual time in a hand that damps little, and the energy at its port."""

from collections.abc import Mapping
from unittest.mock import patch

from hapnet.params import Params
from hapnet.simulation.simulation import Simulation

LIGHT_HAND: Mapping[str, object] = {
    "operator": "sine",
    "operator_model.mass": 0.05,
    "operator_model.damping": 0.5,
    "operator_model.stiffness": 60.0,
    "device.servo": "sampled",
    "duration_s": 6.0,
}
"""A hand that does not damp what a coupling gives out; the defaults' does, and hides it."""


def lowest_energies(params: Params, seed: int) -> tuple[float, float, float]:
    """Least energy put in so far at the hand's port, at the actuator's, and at the actuator's and the world's [J]."""
    simulation = Simulation(params, seed, kernel=False)  # which calls no method that could be watched
    device = simulation.device.device
    energy = lowest = 0.0
    advance = device.advance

    def counted() -> float:
        nonlocal energy, lowest
        work = advance()
        energy += work
        lowest = min(lowest, energy)
        return work

    with patch.object(device, "advance", counted):
        simulation.run()
    ledger = simulation.device.ledger
    return lowest, ledger.margin_min - ledger.bound, simulation.two_port.lowest
