"""A world of your own: a slow corridor with a soft wall and a hard wall. A hand moves back and forth between them.

python examples/own_world.py
hapnet run --scene examples.own_world:corridor --operator sine          # the same world in real time
"""

from __future__ import annotations

from hapnet import Params, Scene, Wall, simulate


def corridor(*, dof: int = 1, half_width: float = 0.02, stiffness: float = 1000.0) -> Scene:
    """Free within `half_width` [m] of the origin along the first axis; the left wall is ten times softer.

    A scene may have any parameters; `--dof` and `world.wall.stiffness` set `dof` and `stiffness`.
    """
    right = (1.0,) + (0.0,) * (dof - 1)  # a wall's normal points into it
    left = (-1.0,) + (0.0,) * (dof - 1)
    walls = (Wall(right, half_width, stiffness, damping=5.0), Wall(left, half_width, stiffness / 10.0, damping=1.0))
    return Scene("corridor", dof, walls, min_s=0.02, max_s=0.08)  # a step takes 20 to 80 ms


def main() -> None:
    changes = {
        "scene": f"{__name__}:corridor",
        "operator": "sine",
        "operator_model.frequency_hz": 0.2,
        "link.up": "wifi",
        "link.down": "wifi",
    }
    result = simulate(Params().set(changes), seed=1)
    device, world = result.recording.device, result.recording.world
    assert device is not None
    assert world is not None
    for name, side, stiffness in (("left", -1.0, 100.0), ("right", 1.0, 1000.0)):
        handle, proxy = side * device["position_m"][:, 0], side * world["position_m"][:, 0]
        felt = abs(device["force_N"][handle.argmax(), 0])
        print(f"{name:>5} wall, {stiffness:4.0f} N/m: {1e3 * (proxy.max() - 0.02):.2f} mm deep, {felt:.2f} N felt")
    verdict = result.summary["verdict"]
    print(f"passive: {verdict['passive']}; {verdict['reason']}")


if __name__ == "__main__":
    main()
