"""Figures of tools that turn.

The true wrench is the one of the tool that rests where coupling and solids balance, for the device's pose now: found
by scipy's least squares over rotation vectors, with none of hapnet's contact code.
"""

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
    over = {"link.up": "4g", "link.down": "4g", "device.stiffness": 200.0}  # below the largest force of the motors
    return simulate({"scene": TABLE, **over, "duration_s": 20.0, **changes}, seed=seed)


def felt(result: Result) -> Felt:
    device = result.recording.device
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


@dataclass(frozen=True)
class Window:
    """A part of a long run. place_mm, turn_deg : from device to proxy, rms, where no corner of the device's pose is in
    the table. force_error, torque_error : as in `Felt`, in % of the true peak in this part."""

    place_mm: float
    turn_deg: float
    force_error: float
    torque_error: float


def window(result: Result, begin_s: float, end_s: float) -> Window:
    device, world = result.recording.device, result.recording.world
    K, K_world = result.summary["environment"]["springs_N_m"]
    rows = np.flatnonzero((device["time_s"] >= begin_s) & (device["time_s"] < end_s))[::EVERY]
    times, x, f = (device[name][rows] for name in ("time_s", "position_m", "force_N"))
    proxy = np.stack([np.interp(times, world["time_s"], one) for one in world["position_m"].T], axis=1)
    true = np.array([true_force(place, K, K_world) for place in x])
    free = ~true.any(axis=1)
    # of two arms' ends that are turned by an angle a against one another: |x - y|^2 = 8 l^2 sin(a/2)^2 in all
    apart = np.linalg.norm((x - proxy)[free, 3:], axis=1) / np.sqrt(8.0) / ARM_M
    angles = 2.0 * np.arcsin(np.minimum(apart, 1.0))
    wrenches = [(wrench(at, got), wrench(at, right)) for at, got, right in zip(x, f, true, strict=True)]
    errors = []
    for k in (0, 1):
        got, right = (np.array([pair[which][k] for pair in wrenches]) for which in (0, 1))
        peak = float(np.linalg.norm(right, axis=1).max())
        errors.append(100.0 * _rms(got - right) / peak if peak else 0.0)
    return Window(1e3 * _rms((x - proxy)[free, :3]), float(np.degrees(_rms(angles[:, None]))), *errors)


def _rms(rows: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(rows * rows, axis=1))))


def endurance(link: str, coupling: str, seconds: float) -> str:
    """Hand-21 with a box on a table: the first 10 s and the last minute, a line."""
    over = {"link.up": link, "link.down": link, "operator": "hand-21", "coupling": coupling, "duration_s": seconds}
    result = run(over, seed=21)
    summary = result.summary
    shares = [100.0 * (summary[side]["modulated_share"] or 0.0) for side in ("world", "device")]
    slack = min(summary[side]["ledger"]["slack_J"] or 0.0 for side in ("device", "world"))
    parts = window(result, 0.0, 10.0), window(result, max(0.0, seconds - 60.0), seconds)
    shown = "; ".join(
        f"{one.place_mm:.2f} mm, {one.turn_deg:.2f} deg, force {one.force_error:.1f} %, torque {one.torque_error:.1f} %"
        for one in parts
    )
    return (
        f"{link} {coupling}: {shown}; modulated {shares[0]:.2f} and {shares[1]:.2f} %, "
        f"passive {summary['verdict']['passive']}, slack {slack:.0e} J"
    )


def main(links: str = "4g", turns_rad: str = "0,0.05,0.1,0.2", long_s: float = 0.0) -> None:
    """turns_rad : amplitudes of the hand's rotation. long_s : so long runs with PSPM and `zoh`, and nothing else."""
    if long_s:
        for link in links.split(","):
            for coupling in ("pspm", "zoh"):
                print(endurance(link, coupling, long_s), flush=True)
        return
    for link in links.split(","):
        for turn in map(float, turns_rad.split(",")):
            made = felt(run({"link.up": link, "link.down": link, "operator_model.turn_rad": turn}))
            print(link, turn, made, flush=True)
