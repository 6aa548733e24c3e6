"""The bare references: the same computations in their simplest form, without energy accounts and checks."""

from __future__ import annotations

import numpy as np

from hapnet.checks import Array, Vector


class PlainPD:
    """Three axes of f = -K (x - y) - B v in plain floats."""

    def __init__(self, stiffness: float, damping: float) -> None:
        self.stiffness: float = stiffness
        self.damping: float = damping

    def force(self, x: Vector, y: Vector, v: Vector) -> Vector:
        """f [N] at position x, set-position y [m], velocity v [m/s]."""
        K, B = self.stiffness, self.damping
        return (-K * (x[0] - y[0]) - B * v[0], -K * (x[1] - y[1]) - B * v[1], -K * (x[2] - y[2]) - B * v[2])


class NumpyPspm:
    """Algorithm 1 in numpy: (8) by Newton on the secular equation |p(mu)|_K^2 = 2 R, p_i = u_i/(1 + mu lambda_i)."""

    def __init__(self, K: Array, position: Array, ceiling: float) -> None:
        self.K = K
        self.eigenvalues: Array
        self.basis: Array
        self.eigenvalues, self.basis = np.linalg.eigh(K)
        self.set_position: Array = position
        self.energy: float = ceiling
        self.ceiling = ceiling

    def modulate(self, y: Array, x: Array, dissipated: float, received: float) -> Array:
        """ybar(k) [m]."""
        before = x - self.set_position
        at_hand = self.energy + received + dissipated + 0.5 * before @ self.K @ before
        offset = x - y
        if 0.5 * offset @ self.K @ offset > at_hand:
            u = self.basis.T @ offset
            mu: float = 0.0
            for _ in range(50):
                shrink = 1.0 / (1.0 + mu * self.eigenvalues)
                value = np.sum(self.eigenvalues * (u * shrink) ** 2) - 2.0 * at_hand
                slope = -2.0 * np.sum(self.eigenvalues**2 * u**2 * shrink**3)
                step = float(-value / slope)
                mu += step
                if abs(step) <= 1e-12 * mu:
                    break
            offset = self.basis @ (u / (1.0 + mu * self.eigenvalues))
        self.set_position = x - offset
        self.energy = min(self.ceiling, max(0.0, float(at_hand - 0.5 * offset @ self.K @ offset)))
        return self.set_position


class NumpyMidpoint:
    """The midpoint step A vhat = c with `numpy.linalg.solve`."""

    def __init__(self, M: Array, B: Array, K: Array) -> None:
        self.M, self.B, self.K = M, B, K
        self.x: Array = np.zeros(len(M))
        self.v: Array = np.zeros(len(M))

    def step(self, dt: float, set_position: Array) -> Array:
        """x_{k+1} [m]."""
        A = 2.0 / dt * self.M + self.B + 0.5 * dt * self.K
        c = 2.0 / dt * self.M @ self.v - self.K @ (self.x - set_position)
        vhat = np.linalg.solve(A, c)
        self.x = self.x + dt * vhat
        self.v = 2.0 * vhat - self.v
        return self.x


class PenaltyWorld:
    """Axes of a mass on a spring and damper, and a penalty wall on the first: Euler in plain floats."""

    def __init__(
        self, mass: float, damping: float, stiffness: float, wall: tuple[float, float, float], axes: int = 3
    ) -> None:
        self.mass: float = mass
        self.damping: float = damping
        self.stiffness: float = stiffness
        self.wall_stiffness: float
        self.wall_damping: float
        self.wall_position: float
        self.wall_stiffness, self.wall_damping, self.wall_position = wall
        self.x: list[float] = [0.0] * axes
        self.v: list[float] = [0.0] * axes

    def step(self, dt: float, set_position: Vector) -> None:
        """One semi-implicit step of dt [s]; unlike the passive integrator it is stable only for short dt."""
        x, v = self.x, self.v
        for i in range(len(x)):
            force = -self.stiffness * (x[i] - set_position[i]) - self.damping * v[i]
            if i == 0 and (depth := x[0] - self.wall_position) > 0.0:
                force -= max(0.0, self.wall_stiffness * depth + self.wall_damping * v[0])
            v[i] += dt * force / self.mass
            x[i] += dt * v[i]


def plain_substeps(axes: int, seconds: float) -> float:
    """4 substeps per millisecond of `axes` masses on a spring, nothing else; returns the first one's position [m]."""
    x, v = [0.01] * axes, [0.0] * axes
    if axes == 1:
        x0, v0 = 0.01, 0.0
        for _ in range(round(4000 * seconds)):
            middle = (4000.0 * v0 - 235.0 * x0) * 2e-4
            v0 = middle + middle - v0
            x0 += 2.5e-4 * middle
        return x0
    for _ in range(round(4000 * seconds)):
        for i in range(axes):
            middle = (4000.0 * v[i] - 235.0 * x[i]) * 2e-4
            v[i] = middle + middle - v[i]
            x[i] += 2.5e-4 * middle
    return x[0]
