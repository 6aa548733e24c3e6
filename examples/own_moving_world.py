"""A moving world of your own: a piston that a motor drives back and forth, and a magnet that acts at a distance.

python examples/own_moving_world.py
hapnet run --scene examples.own_moving_world:workshop --operator rest     # the same world in real time
hapnet run --scene examples.own_moving_world:magnet                       # only the force law, as a function
"""

from __future__ import annotations

from math import pi, sin

from hapnet import Cuboid, ForceWorld, Obstacle, Params, Plane, Sphere, simulate

Vector = tuple[float, ...]


def piston(position: Vector, velocity: Vector, time: float) -> Vector:
    """The force on the proxy, in the piston's frame: a spring and a damper behind its face, at -10 mm."""
    depth = position[0] + 0.01
    return (-2000.0 * depth - 5.0 * velocity[0] if depth > 0.0 else 0.0, *(0.0 for _ in position[1:]))


def magnet(position: Vector, velocity: Vector, time: float) -> Vector:
    """A pull towards a point 40 mm to the left, with a maximum of 0.4 N."""
    away = tuple(x + 0.04 * (axis == 0) for axis, x in enumerate(position))
    squared = sum(x * x for x in away) / 0.03**2
    return tuple(-40.0 * x / (1.0 + squared) ** 2 for x in away)


def workshop(*, dof: int = 1, stroke: float = 0.03, magnetic: bool = True) -> ForceWorld:
    """Without a magnet the piston's face is sent as a plane: the device renders its current position without delay."""

    def stroked(time: float) -> Vector:
        return (0.035 - stroke * sin(2.0 * pi * 0.5 * time), *(0.0,) * (dof - 1))

    face = Plane((1.0,) + (0.0,) * (dof - 1), -0.01, stiffness=2000.0, damping=5.0)  # in the piston's frame
    head, pole = Cuboid((0.0, 0.0, 0.0), (0.02, 0.05, 0.05)), Sphere((-0.04, 0.0, 0.0), 0.006)  # for pictures only
    obstacles = [Obstacle(piston, motion=stroked, planes=face, shape=head), *[Obstacle(magnet, shape=pole)] * magnetic]
    return ForceWorld(obstacles, dof=dof, name="workshop", energy_J=0.02 * magnetic)


def main() -> None:
    scene = f"{__name__}:workshop"
    result = simulate(
        Params().set({"scene": scene, "operator": "rest", "link.up": "wifi", "link.down": "wifi"}), seed=1
    )
    world = result.recording.world
    assert world is not None
    own = result.summary["environment"]
    print(f"the piston pushed with {-world['contact_force_N'].min():.2f} N at most")
    supplied, slack, paid = (own["env_supplied_J"] or 0.0, own["env_slack_J"] or 0.0, own["env_paid_J"] or 0.0)
    print(f"its motor put in {1e3 * supplied:.2f} mJ, the world's slack is {1e3 * slack:.2f} mJ")
    print(f"damping took back {1e3 * paid:.2f} mJ; {result.summary['verdict']['reason']}")


if __name__ == "__main__":
    main()
