"""Figures of tools that turn: ``python -m tests.support.tools`` prints them.

The true wrench is the one of the tool that rests where coupling and solids balance, for the device's pose now: found
by scipy's least squares over rotation vectors, with none of hapnet's contact code.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hapnet.checks import Array
from hapnet.mechanics.pose import ARM_M
from hapnet.simulation.simulation import Result, simulate

LEVEL_M, WALL_N_M = 0.02, 3000.0
SIZE_M = (0.06, 0.04, 0.02)
TABLE = "tool:box?size=60mm,40mm,20mm + plane?normal=0,0,-1&at=0,0,-20mm"
CORNERS = np.array([[a, b, c] for a in (-0.03, 0.03) for b in (-0.02, 0.02) for c in (-0.01, 0.01)])
EVERY = 4
"""Of the recorded samples, one in so many is looked at."""


@dataclass(frozen=True)
class Felt:
    """What a tool on a table feels like: error (rms) in % of the true peak; the largest steps from tick to tick."""

    force_error: float
    torque_error: float
    peak_N: float
    peak_Nm: float
    modulated: float
    slack_J: float
    env_slack_J: float
    passive: bool


def arms(x: Array) -> Array:
    """The ends of the arms (3, 3) [m], a row each."""
    return ARM_M * np.eye(3) + x[3:].reshape(3, 3)


def turned(c: Array, turn: Rotation) -> Array:
    """The coordinates (12,) of a pose."""
    return np.concatenate([c, (ARM_M * (turn.as_matrix().T - np.eye(3))).ravel()])


def wrench(x: Array, f: Array) -> tuple[Array, Array]:
    """Force [N] and torque [Nm] of f (12,) at x (12,)."""
    return f[:3], np.sum(np.cross(arms(x), f[3:].reshape(3, 3)), axis=0)


def true_force(x: Array, K: float, K_world: float) -> Array:
    """Of the device at x (12,): K's spring to where the tool rests on the table, tied to x by K' (12,) [N]."""
    home = Rotation.from_matrix(arms(x).T / ARM_M)

    def away(z: Array) -> Array:
        turn = Rotation.from_rotvec(z[3:] / ARM_M) * home
        deep = -LEVEL_M - (turn.apply(CORNERS)[:, 2] + x[2] + z[2])
        pulled = np.sqrt(K_world) * (turned(x[:3] + z[:3], turn) - x)
        return np.concatenate([pulled, np.sqrt(WALL_N_M) * np.maximum(0.0, deep)])

    if not (away(np.zeros(6))[12:] > 0.0).any():
        return np.zeros(12)
    z = least_squares(away, np.zeros(6), method="lm", xtol=1e-12, ftol=1e-12).x
    rests = turned(x[:3] + z[:3], Rotation.from_rotvec(z[3:] / ARM_M) * home)
    return K * (rests - x)


def run(changes: Mapping[str, object], seed: int = 1) -> Result:
    return simulate({"scene": TABLE, "link.up": "4g", "link.down": "4g", "duration_s": 20.0, **changes}, seed=seed)


def felt(result: Result) -> Felt:
    device = result.recording.device
    assert device is not None
    K, K_world = result.summary["environment"]["springs_N_m"]
    rows = slice(0, None, EVERY)
    places, forces = device["position_m"][rows], device["force_N"][rows]
    pairs = [(wrench(x, f), wrench(x, true_force(x, K, K_world))) for x, f in zip(places, forces, strict=True)]
    got_N, true_N = (np.array([pair[k][0] for pair in pairs]) for k in (0, 1))
    got_Nm, true_Nm = (np.array([pair[k][1] for pair in pairs]) for k in (0, 1))
    peak_N, peak_Nm = (float(np.linalg.norm(true, axis=1).max()) for true in (true_N, true_Nm))
    summary = result.summary
    return Felt(
        100.0 * float(np.sqrt(np.mean(np.sum((got_N - true_N) ** 2, axis=1)))) / peak_N,
        100.0 * float(np.sqrt(np.mean(np.sum((got_Nm - true_Nm) ** 2, axis=1)))) / peak_Nm,
        peak_N,
        peak_Nm,
        100.0 * summary["world"]["modulated_share"],
        min(summary[side]["ledger"]["slack_J"] for side in ("device", "world")),
        summary["environment"]["env_slack_J"],
        summary["verdict"]["passive"],
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--links", default="4g")
    parser.add_argument("--turns", default="0,0.05,0.1,0.2", help="amplitudes of the hand's rotation [rad]")
    given = parser.parse_args()
    for link in given.links.split(","):
        for turn in map(float, given.turns.split(",")):
            made = felt(run({"link.up": link, "link.down": link, "operator_hand.turn_rad": turn}))
            print(link, turn, made, flush=True)


if __name__ == "__main__":
    main()
