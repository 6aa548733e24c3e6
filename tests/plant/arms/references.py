"""Arms to compare with: random tables, and the same arm in MuJoCo."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.ext.arms.table import ArmTable, Joint, omni, rotation_of


def vector(values: Array) -> Vector:
    return tuple(values.tolist())


def random_arm(rng: np.random.Generator, n: int, slides: tuple[int, ...] = (), armature: float = 0.0) -> ArmTable:
    """An arm of n joints with frames, axes and bodies that have nothing special; which slide, and rotors' inertia."""
    joints = []
    for i in range(n):
        turn = rotation_of(vector(rng.uniform(-math.pi, math.pi, 3)))
        squares = rng.uniform(0.5, 1.5, 3)  # of the body's extents, so the moments are a body's
        inertia = 1e-3 * turn @ np.diag(squares.sum() - squares) @ turn.T
        inertia = (inertia + inertia.T) / 2
        joints.append(
            Joint(
                f"j{i}",
                vector(rng.uniform(-0.2, 0.2, 3)),
                vector(rng.uniform(-math.pi, math.pi, 3)),
                vector(rng.normal(size=3)),
                float(rng.uniform(0.1, 0.5)),
                vector(rng.uniform(-0.1, 0.1, 3)),
                tuple(map(vector, inertia)),  # type: ignore[arg-type]
                lower=-9.0 if i in slides else -math.inf,
                upper=9.0 if i in slides else math.inf,
                armature=armature * (i + 1),
                slides=i in slides,
            )
        )
    name = "".join([f"random{n}", *(f"_slides{i}" for i in slides)])
    return ArmTable(name, tuple(joints), vector(rng.uniform(-0.2, 0.2, 3)), (0.0,) * n)


def cylindrical() -> ArmTable:
    """The omni with a slide in its upper bar, and with rotors behind gears."""
    waist, shoulder, elbow = omni().joints
    inertia = ((1e-5, 0.0, 0.0), (0.0, 1e-5, 0.0), (0.0, 0.0, 1e-5))
    body = Joint("slide", (0.0, 0.02, 0.0), axis=(0.0, 1.0, 0.0), mass=0.05, inertia=inertia, slides=True, lower=-0.5,
                 upper=0.5, damping=2.0, armature=0.1)  # fmt: skip
    joints = (replace(waist, armature=2e-3), shoulder, body, replace(elbow, armature=1e-3))
    return replace(omni(), name="cylindrical", joints=joints, home=(*omni().home[:2], 0.01, omni().home[2]))


def led(table: ArmTable, *mimics: tuple[int, int, float, float]) -> ArmTable:
    """The arm with mimics: number of a joint, of its leader, multiplier and offset."""
    joints = list(table.joints)
    for i, k, share, offset in mimics:
        joints[i] = replace(joints[i], leader=joints[k].name, multiplier=share, offset=offset)
    home = tuple(at for at, joint in zip(table.home, joints, strict=True) if not joint.leader)
    return replace(table, name=f"{table.name}_{len(mimics)}_mimics", joints=tuple(joints), home=home)


def in_mujoco(table: ArmTable) -> tuple[Any, Any]:
    """MuJoCo's model of the arm, with a site at its tip, and its data."""
    import mujoco

    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.gravity = table.gamma
    body = spec.worldbody
    for joint in table.joints:
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, rotation_of(joint.rpy).ravel())
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = joint.inertia
        body = body.add_body(
            name=joint.name,
            pos=joint.xyz,
            quat=quat,
            mass=joint.mass,
            ipos=joint.centre,
            fullinertia=(xx, yy, zz, xy, xz, yz),
            explicitinertial=True,
        )
        kind = mujoco.mjtJoint.mjJNT_SLIDE if joint.slides else mujoco.mjtJoint.mjJNT_HINGE
        body.add_joint(name=joint.name, type=kind, axis=joint.axis, armature=joint.armature)
    body.add_site(name="tip", pos=table.tip)
    model = spec.compile()
    return model, mujoco.MjData(model)
