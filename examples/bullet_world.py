"""PyBullet as the world: a table, a block, and boxes that the hand pushes with a ball. Another engine in 100 lines.

pip install pybullet
hapnet play --scene examples.bullet_world:Boxes                        # the mouse is the hand
hapnet run --scene examples.bullet_world:Boxes --operator hand-6       # a simulated hand
python examples/bullet_world.py                                        # where energy came from, and the undone substeps
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from hapnet import Cuboid, HapnetError, Params, Plane, Sphere, simulate

Vector = tuple[float, ...]

STIFFNESS, DAMPING, FRICTION, GRAVITY = 3000.0, 10.0, 0.3, 9.81
RADIUS = 0.01
"""Radius of the ball [m]. The ball begins at the origin, 2 cm above the table, and has no weight."""
FIXED = {(0.2, 0.2, 0.02): (0.0, 0.0, -0.03), (0.02, 0.2, 0.06): (0.04, 0.0, 0.01)}
"""Sizes and centres of table and block [m]."""
CUBE = (0.03, 0.03, 0.03)


class Boxes:
    """A `hapnet.Engine`. Each moving body has the same moment of inertia about all axes."""

    substep_s = 0.001

    def __init__(self) -> None:
        try:
            direct = import_module("pybullet").DIRECT
        except ModuleNotFoundError:
            raise HapnetError("this world needs PyBullet: pip install pybullet") from None
        self._engine: Any = import_module("pybullet_utils.bullet_client").BulletClient(direct)
        engine = self._engine
        engine.setGravity(0.0, 0.0, -GRAVITY)
        engine.setPhysicsEngineParameter(deterministicOverlappingPairs=1)
        self._fixed = [self._box(size, at, 0.0) for size, at in FIXED.items()]
        self._boxes = [self._box(CUBE, (-0.05, y, -0.005), 0.05) for y in (-0.04, 0.0, 0.04)]
        self._ball = self._body(engine.createMultiBody(0.02, engine.createCollisionShape(engine.GEOM_SPHERE, RADIUS)))
        self._masses = {body: engine.getDynamicsInfo(body, -1) for body in (*self._boxes, self._ball)}
        self._saved: int | None = None

    def _box(self, size: Vector, at: Vector, mass: float) -> int:
        shape = self._engine.createCollisionShape(self._engine.GEOM_BOX, halfExtents=[0.5 * side for side in size])
        return self._body(self._engine.createMultiBody(mass, shape, basePosition=at))

    def _body(self, body: int) -> int:
        """Set the contact parameters of a body. The springs of two bodies in contact act in series; no body sleeps."""
        soft = {"contactStiffness": 2.0 * STIFFNESS, "contactDamping": 2.0 * DAMPING, "activationState": 2}
        self._engine.changeDynamics(body, -1, lateralFriction=FRICTION**0.5, linearDamping=0, angularDamping=0, **soft)
        return body

    def position(self) -> Vector:
        return tuple(self._engine.getBasePositionAndOrientation(self._ball)[0])

    def velocity(self) -> Vector:
        return tuple(self._engine.getBaseVelocity(self._ball)[0])

    def substep(self, dt: float, force: Vector) -> None:
        self._engine.setTimeStep(dt)
        lifted = (force[0], force[1], force[2] + GRAVITY / self.inverse_mass())
        self._engine.applyExternalForce(self._ball, -1, lifted, self.position(), self._engine.WORLD_FRAME)
        self._engine.stepSimulation()

    def save(self) -> int:
        if self._saved is not None:
            self._engine.removeState(self._saved)
        self._saved = saved = int(self._engine.saveState())
        return saved

    def restore(self, state: int) -> None:
        self._engine.restoreState(state)

    # The methods below are optional: without them energy made by the engine is not damped, and the hand feels less.

    def energy_J(self) -> tuple[float, float]:
        kinetic = potential = 0.0
        for body, (mass, _, (inertia, *_), *_) in self._masses.items():
            speed, spin = self._engine.getBaseVelocity(body)
            kinetic += 0.5 * mass * sum(v * v for v in speed) + 0.5 * inertia * sum(w * w for w in spin)
            if body != self._ball:
                potential += mass * GRAVITY * self._engine.getBasePositionAndOrientation(body)[0][2]
        return kinetic, potential

    def slow(self, factor: float) -> None:
        for body in self._masses:
            speed, spin = self._engine.getBaseVelocity(body)
            self._engine.resetBaseVelocity(body, [factor * v for v in speed], [factor * w for w in spin])

    def inverse_mass(self) -> float:
        return 1.0 / float(self._masses[self._ball][0])

    def depth(self) -> float:
        return max([0.0, *(-touch[8] for touch in self._engine.getContactPoints(self._ball))])

    def contact_force(self) -> Vector:
        total: Vector = (0.0, 0.0, 0.0)
        for touch in self._engine.getContactPoints(self._ball):
            for unit, push in ((touch[7], touch[9]), (touch[11], touch[10]), (touch[13], touch[12])):
                total = tuple(before + push * along for before, along in zip(total, unit, strict=True))
        return total

    def planes(self, position: Vector, reach_m: float) -> list[Plane] | None:
        """The planes of table and block; None while the ball touches a box, because boxes yield and planes do not."""
        if any(self._engine.getContactPoints(self._ball, box) for box in self._boxes):
            return None
        found = [near for body in self._fixed for near in self._engine.getClosestPoints(self._ball, body, reach_m)]
        planes: list[Plane] = []
        for near in found:
            into: Vector = tuple(-along for along in near[7])
            offset = sum(n * x for n, x in zip(into, position, strict=True)) + near[8]
            planes.append(Plane(into, offset, STIFFNESS, DAMPING, friction=FRICTION))
        return planes

    def shapes(self) -> list[Cuboid | Sphere]:
        centre = (0.0, 0.0, 0.0)
        return [*(Cuboid(centre, size) for size in (*FIXED, *[CUBE] * len(self._boxes))), Sphere(centre, RADIUS)]

    def poses(self) -> list[Vector]:
        bodies = (*self._fixed, *self._boxes, self._ball)
        lying = [self._engine.getBasePositionAndOrientation(body) for body in bodies]
        return [(*at, turn[3], *turn[:3]) for at, turn in lying]


def main() -> None:
    params = Params().set({"scene": f"{__name__}:Boxes", "operator": "hand-6", "link.up": "4g", "link.down": "4g"})
    result = simulate(params, seed=1)
    own = result.summary["environment"]
    print(f"slack {1e3 * (own['env_slack_J'] or 0.0):.3f} mJ, {own['env_undone']} substeps undone")
    print(f"energy that PyBullet would have added: {1e3 * (own['env_given_J'] or 0.0):.3f} mJ")
    print(result.summary["verdict"]["reason"])


if __name__ == "__main__":
    main()
