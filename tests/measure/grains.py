"""A hand that slides over a grain, over 4G: the normal force at the device beside what was asked.

``python -m tests.measure grains`` prints the table of hapnet/plant/worlds/effects.md.
"""

from typing import Any, NamedTuple

import numpy as np

from hapnet.simulation.simulation import Simulation
from tests.measure.rubbing import K_WALL, K_WORLD, Felt, K, run

HEIGHT_M = 2e-4
SWEEP = ((10.0, 0.05), (20.0, 0.05), (50.0, 0.05), (100.0, 0.05), (200.0, 0.1), (300.0, 0.15))
"""Frequencies [Hz], and the speeds of the hand [m/s]: wavelengths of 5 to 0.5 mm."""

FELT = 1.0 / (1.0 / K + K_WORLD / (K * K_WALL))
"""Springs in series, as the hand feels them [N/m]."""

MASS, DAMPING, STIFFNESS = 0.5 + 0.045, 60.0 + 0.3 + 0.1, 3000.0
"""Of the hand of `rubbing.Rub` with the simulated device, its own damping and B."""


class Line(NamedTuple):
    """The force at the device at the grain's frequency, and what of it is at others (root mean square) [N]."""

    force_N: float
    other_N: float


def asked(hz: float) -> float:
    """What a hand feels of the grain that gives way to it: the spring's force on a mass on a spring and a damper."""
    omega = 2.0 * np.pi * hz
    gives = 1.0 / (STIFFNESS - MASS * omega**2 + 1j * omega * DAMPING)
    return float(abs(FELT * HEIGHT_M / (1.0 + FELT * gives)))


def slid(hz: float, speed_mps: float, **more: Any) -> Felt:
    """A run over a grain that gives so many waves a second."""
    scene = f"plane?grain={HEIGHT_M}m,{speed_mps / hz}m"
    return run(scene, "4g", speed_mps=speed_mps, seconds=4.0, **more)


def line(felt: Felt, hz: float, speed_mps: float) -> Line:
    """A sine over the way along the surface is fitted to the force while sliding, with the depth as it is."""
    on = felt.sliding()
    phase = 2.0 * np.pi * hz / speed_mps * felt.x[on, 1]
    parts = np.c_[np.ones(on.sum()), felt.x[on, 0], felt.x[on, 1], np.sin(phase), np.cos(phase)]
    found, *_ = np.linalg.lstsq(parts, felt.force[on, 0])
    # The depth moves with the grain too: what of it does so belongs to the line.
    moved, *_ = np.linalg.lstsq(np.delete(parts, 1, 1), felt.x[on, 0])
    waves = found[3:] + found[1] * moved[2:]
    return Line(float(np.hypot(*waves)), float(np.std(felt.force[on, 0] - parts @ found)))


def at_worlds_rate(simulation: Simulation) -> None:
    """The world makes the grain itself: the planes that it sends are as high as it is where the proxy is."""
    contacts: Any = simulation.world.scene.contacts
    report = contacts.planes

    def planes(x: tuple[float, ...], reach: float) -> Any:
        lifted = [(plane, plane.effects.grain.at(x)) for plane in report(x, reach)]
        return tuple([plane._replace(offset_m=plane.offset_m - high, effects=None) for plane, high in lifted])

    contacts.planes = planes


def main() -> None:
    print("| Hz | speed, wavelength | asked | at the device | other | at the world's rate | slack |")
    print("|---|---|---|---|---|---|---|")
    for hz, speed in SWEEP:
        felt, late = slid(hz, speed), slid(hz, speed, watch=at_worlds_rate)
        here, there = line(felt, hz, speed), line(late, hz, speed)
        slack = min(felt.summary[side]["ledger"]["slack_J"] for side in ("device", "world"))
        print(
            f"| {hz:.0f} | {1e3 * speed:.0f} mm/s, {1e3 * speed / hz:.2g} mm | {1e3 * asked(hz):.2f} mN | "
            f"{1e3 * here.force_N:.2f} mN | {1e3 * here.other_N:.2f} mN | {1e3 * there.force_N:.2f} mN | "
            f"{slack:.0e} J |"
        )
