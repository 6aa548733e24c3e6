"""A ball that circles around the hand: dodge it, lean on it, or let it push you. A moving world of your own.

hapnet play --scene examples.planet:planet                             # the mouse is the hand
hapnet run --scene examples.planet:planet --operator hand-6            # a simulated hand
python examples/planet.py                                              # where the energy came from
"""

from __future__ import annotations

from math import cos, hypot, pi, sin

from hapnet import ForceWorld, Obstacle, Params, Sphere, simulate

Vector = tuple[float, ...]

RADIUS = 0.012


def ball(position: Vector, velocity: Vector, time: float) -> Vector:
    """The force of a springy ball, in the frame of its centre."""
    away = hypot(*position)
    push = max(0.0, 1000.0 * (RADIUS - away)) / (away or 1.0)
    return tuple(push * x for x in position)


def planet(*, dof: int = 3, orbit: float = 0.025, period: float = 3.0) -> ForceWorld:
    def circle(time: float) -> Vector:
        turn = 2.0 * pi * time / period
        return (orbit * cos(turn), orbit * sin(turn), 0.0)[:dof]

    seen = Sphere((0.0, 0.0, 0.0), RADIUS)  # for pictures only
    return ForceWorld([Obstacle(ball, motion=circle, shape=seen)], dof=dof, name="planet")


def main() -> None:
    params = Params().set({"scene": f"{__name__}:planet", "operator": "hand-6", "link.up": "4g", "link.down": "4g"})
    result = simulate(params, seed=1)
    world = result.recording.world
    assert world is not None
    own = result.summary["environment"]
    felt = max(hypot(*force) for force in world["contact_force_N"])
    print(f"the ball pushed with {felt:.2f} N at most; its drive gave {1e3 * (own['env_supplied_J'] or 0.0):.2f} mJ")
    print(result.summary["verdict"]["reason"])


if __name__ == "__main__":
    main()
