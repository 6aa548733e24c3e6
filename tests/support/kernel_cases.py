"""Random cases that the compiled kernel covers, and what it does otherwise than the reference."""

import dataclasses
from typing import Any

import numpy as np

from hapnet.assembly.scenes import for_its_scene
from hapnet.couplings import pspm
from hapnet.params import Params
from hapnet.simulation.simulation import Result, Simulation
from tests.support.theorem_cases import with_any_scene

MINE = dataclasses.replace(pspm.LAW, name="mine")
"""A user's own law, which happens to be PSPM."""

_LOSING = "delay 20ms loss 40%"
LOSSY = Params().set(
    {
        "device.servo": "sampled", "duration_s": 1.0, "operator": "sine", "operator_model.frequency_hz": 1.5,
        "device.damping": 2.0, "link.up": _LOSING, "link.down": _LOSING,
    }
)  # fmt: skip
"""Much energy is harvested and shuffled, and much of it lost and sent again."""

_OF_ONE_AXIS = ("device.stiffness", "device.damping", "world.mass", "world.damping", "world.stiffness")


def kernel_case(seed: int, dof: int, servo: str = "sampled", duration_s: float = 2.5) -> Params:
    """Case `seed`: couplings, feels, links and parameters of all kinds, with one axis or (0) as many as it draws."""
    rng = np.random.default_rng([seed, 1016])
    params = with_any_scene(seed, duration_s)
    changes: dict[str, Any] = {
        "device.servo": servo,
        "coupling": "zoh" if rng.random() < 0.3 else "pspm",
        "rendering": str(rng.choice(["paper", "hapnet"])),
        "record_hz": float(rng.choice([1000.0, 130.0])),
        "device.watchdog_s": float(rng.choice([0.0, 0.02])),
    }
    if servo == "sampled":
        changes["device.resolution_m"] = float(rng.choice([0.0, 0.0, 5e-5]))
        changes["device.trusted_damping"] = float(rng.choice([0.0, 0.0, 0.1]))
    if rng.random() < 0.3:
        words = rng.choice(["wifi", "4g", "ideal", "delay 5ms 4ms loss 20% resend 2 3ms unordered limit 4"])
        changes |= {"link.up": str(words), "link.down": str(words)}
    if dof == 1:
        changes |= {"scene": str(rng.choice(["free", "wall", "box"])), "dof": 1}
        changes |= {name: _first(params.get(name)) for name in _OF_ONE_AXIS}
    return for_its_scene(params.set(changes))


def _first(matrix: Any) -> float:
    while isinstance(matrix, tuple):
        matrix = matrix[0]
    return float(matrix)


def both(params: Params, seed: int, why: str | None = None) -> tuple[Result, Result]:
    """The results of the reference and of the kernel. `why` : it falls back to the reference; None: it must not."""
    compiled = Simulation(params, seed, kernel=True)
    assert compiled.not_compiled is None
    found = compiled.run()
    assert compiled.not_compiled == why
    return Simulation(params, seed, kernel=False).run(), found


def differences(params: Params, seed: int, why: str | None = None) -> list[str]:
    """In what bits the kernel's result differs."""
    return differing(*both(params, seed, why))


def differing(expected: Result, found: Result) -> list[str]:
    """In what bits a result differs: recorded columns, the scene, the summary, and the state at the end."""
    different = []
    for side in ("device", "world"):
        columns, others = getattr(expected.recording, side), getattr(found.recording, side)
        assert list(columns) == list(others)
        different += [
            f"{side}.{name}"
            for name in columns
            if columns[name].shape != others[name].shape or columns[name].tobytes() != others[name].tobytes()
        ]  # fmt: skip
    different += ["scene"] * (expected.recording.scene != found.recording.scene)
    pairs = (expected.summary, found.summary), (_end(expected), _end(found))
    return different + [word for pair in pairs for word in _different(*pair, "")]


def _end(result: Result) -> dict[str, Any]:
    """The state of both sides at the end."""
    device, world = result.device, result.world
    return {
        "ticks": device.ticks, "max_ns": device.max_ns, "read": device.device.read(), "hand": device.hand_work,
        "sampled": device.held_forces(), "quantisation": device.quantisation, "true_slack": device.true_slack,
        "world": vars(world.stepped), "mass": (world.mass.position, world.mass.velocity),
        "next_step": world.next_step_ns(),
        **{
            side: [one.set_position, one.target, one.account, vars(one.ledger)]
            for side, one in (("at_device", device.coupling), ("at_world", world.coupling))
        },
    }  # fmt: skip


def _different(expected: Any, found: Any, path: str) -> list[str]:
    if isinstance(expected, dict):
        if expected.keys() != found.keys():
            return [f"{path}: {expected.keys() ^ found.keys()}"]
        return [word for key in expected for word in _different(expected[key], found[key], f"{path}.{key}")]
    if isinstance(expected, list | tuple) and len(expected) == len(found):
        pairs = enumerate(zip(expected, found, strict=True))
        return [word for k, (one, other) in pairs for word in _different(one, other, f"{path}.{k}")]
    same = expected == found or (expected != expected and found != found)
    return [] if same else [f"{path}: {expected} by the reference, {found} by the kernel"]
