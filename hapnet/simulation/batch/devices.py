"""Simulated devices of many scenarios at once, coupled continuously: `hapnet.plant.tick`, operation by operation."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array, Vector
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.limited_coupling import ROUNDS
from hapnet.simulation.batch.arrays import Index, pick, vectors

_CHUNK = 4096
_ROUNDING = 1.0 + 1e-12


class Motion:
    """The hand's motion at every tick, the same in all scenarios: tables over the ticks, extended as needed.

    Parameters
    ----------
    reference : the operator's, called with increasing times. device : the device of any scenario.
    """

    def __init__(self, reference: Callable[[float], Vector], device: SimulatedDevice) -> None:
        self._follow, self._device = reference, device
        self._base = 0
        self._points = np.array(reference(0.0))[:, None]
        self._hands: list[Array] = []

    def at(self, ticks: NDArray[np.int64]) -> list[Array]:
        """The hand's drive (n, N) in each substep of the tick that ends as number `ticks` (N,)."""
        if int(ticks.max()) >= self._base + self._points.shape[1]:
            self._extend(int(ticks.min()), int(ticks.max()))
        offset = ticks - self._base
        return [table.take(offset, axis=1) for table in self._hands]

    def ends(self, ticks: NDArray[np.int64]) -> Array:
        """The reference at both ends of the same tick (2n, N) [m]."""
        offset = ticks - self._base
        return np.vstack([self._points.take(offset - 1, axis=1), self._points.take(offset, axis=1)])

    def reference(self, tick: int) -> Vector:
        """The hand's reference at the end of this tick [m]."""
        return tuple(self._points[:, tick - self._base].tolist())

    def _extend(self, least: int, most: int) -> None:
        device = self._device
        end = self._base + self._points.shape[1]
        more = [self._follow(tick * device.period) for tick in range(end, most + _CHUNK)]
        past = max(0, least - 1 - self._base)
        self._base += past
        self._points = np.hstack([self._points, np.array(more).T])[:, past:]
        model = device.model
        kh = model.hand.stiffness
        start = self._points[:, :-1]
        rate = (self._points[:, 1:] - start) / device.period
        hand = kh * start + model.rate_drive * rate
        step = model.rate_step * rate
        self._hands = []
        for _ in model.substeps:
            hand = hand + step
            self._hands.append(np.hstack([hand[:, :1], hand]))  # tick k's row is computed from points k - 1 and k


class _Axes(NamedTuple):
    """The constants of each axis, if the axes are independent: k, k + K_h, 1/A and B."""

    k: Array | float
    whole: Array | float
    inverse: Array | float
    B: Array | float


class _Coupling(NamedTuple):
    """K, its modes with their values, and B's diagonal."""

    K: Array
    values: Array
    modes: Array
    damping: Array


class Devices:
    """The devices' state, vectors (n, N)."""

    def __init__(self, devices: list[SimulatedDevice], reference: Callable[[float], Vector]) -> None:
        first = devices[0]
        self.dof = first.dof
        self.motion = Motion(reference, first)
        self.ticks = np.array([d.ticks for d in devices])
        self.position = vectors([d.position for d in devices])
        self.velocity = vectors([d.velocity for d in devices])
        self.hand_force = vectors([d.hand_force for d in devices])
        self.low = vectors([d.state.low for d in devices])
        self.high = vectors([d.state.high for d in devices])
        self.dissipated = np.array([d.state.dissipated for d in devices])
        self.limited = np.array([d.state.limited for d in devices])
        self._other = tuple(np.empty_like(self.position) for _ in range(4))
        """Room for the state after the next tick: position, velocity, low, high."""
        self._room = [np.empty_like(self.position) for _ in range(5)]
        self._at_limit = np.array([d.state.at_limit for d in devices])
        self._any_at_limit = bool(self._at_limit.any())
        self._model = model = first.model
        self._has_limits = model.knee != math.inf
        self._bench = copy.copy(first.state)
        """State in which single scenarios compute a tick again if the damper is limited."""
        self._half_mass = 0.5 * first.mass
        self._axes: _Axes | None = None
        if model.decoupled:
            # With one axis these are plain numbers, which broadcast faster.
            constants = model.decoupled[0] if self.dof == 1 else np.array(model.decoupled).T[:, :, None]
            self._axes = _Axes(*constants[:4])
        values, modes = map(np.array, model.coupling.modes)
        self._coupling = _Coupling(np.array(model.coupling.rows), values, modes, np.array(model.damping))

    def write_back(self, i: int, device: SimulatedDevice, set_position: Vector) -> None:
        """Give scenario i's state back."""
        device.ticks = int(self.ticks[i])
        device.time = device.ticks * device.period
        device.references = [self.motion.reference(device.ticks)]
        state = device.state
        for name, values in (("position", self.position), ("velocity", self.velocity),
                             ("hand_force", self.hand_force), ("low", self.low), ("high", self.high)):  # fmt: skip
            setattr(state, name, tuple(values[:, i].tolist()))
        state.at_limit, state.limited = bool(self._at_limit[i]), bool(self.limited[i])
        state.dissipated = float(self.dissipated[i])
        state.set_position = set_position

    def kinetic(self) -> Array:
        """Kinetic energy of the devices' own mass [J]."""
        v = self.velocity
        square = v[0] * v[0]
        for row in v[1:]:
            square += row * row
        kinetic: Array = self._half_mass * square
        return kinetic

    def advance(self, ybar: Array) -> Array:
        """Run one tick in every scenario. Returns the work done by each hand [J]."""
        self.ticks += 1
        hands = self.motion.at(self.ticks)
        before = self.position, self.velocity, self.low, self.high, self.dissipated
        model = self._model
        if self._axes is None:
            work, dissipated, stretch, drag = self._advance_linear(hands, ybar)
        else:
            work, dissipated, stretch, drag = self._advance_axes(self._axes, hands, ybar)
        self.dissipated = before[-1] + dissipated
        if self._has_limits:
            beyond = stretch > model.knee_square
            stretch *= model.largest
            beyond |= np.sqrt(stretch, out=stretch) + drag > model.force_limit
            if self._any_at_limit:
                beyond |= self._at_limit
            which = beyond.nonzero()[0]
            if which.size:
                self._advance_again(which, hands, ybar, before, work)
        return work

    def _advance_again(
        self, at: Index, hands: list[Array], ybar: Array, before: tuple[Array, ...], work: Array
    ) -> None:
        """Compute the tick again, from `before`, in the scenarios `at`, where a limit may act.

        If the damper is limited, or c does not converge soon, the scenario's device computes the tick alone. If that
        was so in the last tick, it does so at once.
        """
        likely = self.limited[at] & self._at_limit[at]
        alone, together = at[likely], at[~likely]
        if together.size:
            work[together], limited = self._advance_limited(together, hands, pick(ybar, together), before)
            alone = np.concatenate([alone, together[limited]])
        if alone.size:
            references = self.motion.ends(self.ticks)
            for k in alone.tolist():
                work[k] = self._advance_alone(k, references[:, k].tolist(), ybar[:, k].tolist(), before)
        self._any_at_limit = bool(self._at_limit.any())

    def _advance_axes(self, axes: _Axes, hands: list[Array], ybar: Array) -> tuple[Array, Array, Array, Array]:
        """Compute each axis alone: (work, dissipated, bound of ``|e|_K^2``, bound of the damper's force).

        Nothing is allocated: the new state goes into the other of two sets of arrays.
        """
        model = self._model
        h, kh, inertia = model.h, model.hand.stiffness, model.inertia
        hand_mass, response, whole, inverse = model.hand_mass, model.response, axes.whole, axes.inverse
        x, v, low, high = self.position, self.velocity, self.low, self.high
        self.position, self.velocity, self.low, self.high = self._other
        self._other = x, v, low, high
        new_x, new_v, new_low, new_high = self.position, self.velocity, self.low, self.high
        drive, middle, term, work, squares = self._room
        f = self.hand_force
        np.multiply(ybar, axes.k, out=drive)
        work.fill(0.0)
        squares.fill(0.0)
        for hand in hands:
            np.multiply(v, inertia, out=middle)
            middle += drive
            middle += hand
            np.multiply(x, whole, out=term)
            middle -= term
            middle *= inverse
            np.multiply(x, kh, out=term)
            np.subtract(hand, term, out=f)
            np.multiply(v, hand_mass, out=term)
            f += term
            np.multiply(middle, response, out=term)
            f -= term
            np.multiply(f, middle, out=term)
            work += term
            np.multiply(middle, middle, out=term)
            squares += term
            np.add(middle, middle, out=term)
            v = np.subtract(term, v, out=new_v)
            middle *= h
            x = np.add(x, middle, out=new_x)
            low = np.minimum(low, x, out=new_low)
            high = np.maximum(high, x, out=new_high)
        np.subtract(high, ybar, out=term)
        np.subtract(ybar, low, out=middle)
        farthest = np.maximum(term, middle, out=term)
        stretch = np.multiply(farthest, axes.k, out=middle)
        stretch *= farthest
        drag = np.sqrt(_sum(axes.B * axes.B * squares))
        return _sum(work) * h, _sum(axes.B * h * squares), _sum(stretch), drag

    def _advance_linear(self, hands: list[Array], ybar: Array) -> tuple[Array, Array, Array, Array]:
        """The same for any K, as one linear map."""
        model, n, x = self._model, self.dof, self.position
        ends = self.motion.ends(self.ticks)
        values = model.tick_map @ np.vstack([x, self.velocity, ybar, np.zeros_like(x), ends])
        steps = len(model.substeps)
        middle, force, path, drag = values[: 4 * n * steps].reshape(4, steps, n, -1)
        self.low, self.high = np.minimum(self.low, path.min(axis=0)), np.maximum(self.high, path.max(axis=0))
        farthest = np.maximum(self.high - ybar, ybar - self.low)
        self.position, self.velocity, self.hand_force = path[-1].copy(), values[-2 * n : -n].copy(), force[-1].copy()
        work: Array = (force * middle).sum(axis=(0, 1)) * model.h
        dissipated: Array = (drag * middle).sum(axis=(0, 1)) * model.h
        longest: Array = np.sqrt((drag * drag).sum(axis=(0, 1)))
        return work, dissipated, model.largest * _sum(farthest * farthest), longest

    def _advance_limited(
        self, at: Index, hands: list[Array], ybar: Array, before: tuple[Array, ...]
    ) -> tuple[Array, NDArray[np.bool_]]:
        """`TickModel.limited` with an unlimited damper: the works, and which scenarios must be computed alone."""
        model, K, B = self._model, self._coupling.K, self._coupling.damping[:, None]
        h, kh, inertia, hand_mass, response = (
            model.h,
            model.hand.stiffness,
            model.inertia,
            model.hand_mass,
            model.response,
        )
        x, v, low, high = (values[:, at] for values in before[:-1])
        e = x - ybar
        pull = _times(K, e)
        square = _sum(e * pull)
        work, dissipated = np.zeros(len(at)), np.zeros(len(at))
        alone = np.zeros(len(at), dtype=np.bool_)
        for whole_hand in hands:
            hand = whole_hand[:, at]
            push = hand + inertia * v - kh * x
            c, middle, restless = self._saturate(push, pull, square)
            alone[restless] = True
            f = hand - kh * x + hand_mass * v - response * middle
            work += _sum(f * middle)
            v = middle + middle - v
            x = x + h * middle
            e = e + h * middle
            start, pull = pull, _times(K, e)
            square = _sum(e * pull)
            drag = B * middle
            force = -0.5 * c * (start + pull) - drag
            alone |= np.sqrt(_sum(force * force)) * _ROUNDING > model.force_limit
            dissipated += _sum(drag * middle)
            low, high = np.minimum(low, x), np.maximum(high, x)
        self._at_limit[at] = square > model.knee_square
        self.position[:, at], self.velocity[:, at], self.hand_force[:, at] = x, v, f
        self.low[:, at], self.high[:, at] = low, high
        self.dissipated[at] = before[-1][at] + dissipated * h
        return work * h, alone

    def _advance_alone(self, k: int, references: list[float], ybar: list[float], before: tuple[Array, ...]) -> float:
        """Compute the tick again in scenario k, as its device does, with the reference at the tick's start and end."""
        state, n = self._bench, self.dof
        state.position, state.velocity, state.low, state.high = (tuple(v[:, k].tolist()) for v in before[:-1])
        state.dissipated, state.limited = float(before[-1][k]), bool(self.limited[k])
        state.set_position = tuple(ybar)
        work = self._model.limited(state, tuple(references[:n]), tuple(references[n:]))
        self.position[:, k], self.velocity[:, k] = state.position, state.velocity
        self.low[:, k], self.high[:, k], self.hand_force[:, k] = state.low, state.high, state.hand_force
        self.dissipated[k], self.limited[k] = state.dissipated, state.limited
        self._at_limit[k] = state.at_limit
        return work

    def _saturate(self, push: Array, pull: Array, square: Array) -> tuple[Array, Array, Index]:
        """`LimitedCoupling._saturated`: c, vhat, and the scenarios whose c has not converged.

        A scenario that has reached its fixed point is not changed any more.
        """
        model, modes = self._model, self._coupling.modes
        h, knee = model.h, model.knee
        values = self._coupling.values[:, None]
        a, b = _times(modes, push), _times(modes, pull)
        start = np.sqrt(np.maximum(0.0, square))
        c = np.ones(len(start))
        beyond = start > knee
        c[beyond] = knee / start[beyond]
        left = np.arange(len(c))
        for _ in range(ROUNDS):
            now = c[left]
            u = (a[:, left] - now * b[:, left]) / (1.0 + 0.5 * now * h * values)
            gain = _sum(u * (2.0 * b[:, left] + h * values * u))
            end = np.sqrt(np.maximum(0.0, square[left] + h * gain))
            c[left] = _discrete_gradient(start[left], end, knee)
            left = left[np.abs(c[left] - now) > 1e-15]
            if not left.size:
                break
        w = (a - c * b) / (1.0 + 0.5 * c * h * values)
        return c, _times(modes.T, w), left


def _sum(rows: Array) -> Array:
    """Sum over the axes; with one axis, its row itself."""
    total: Array = rows[0] if len(rows) == 1 else rows.sum(axis=0)
    return total


def _times(matrix: Array, vectors: Array) -> Array:
    product: Array = matrix[0, 0] * vectors if len(matrix) == 1 else matrix @ vectors
    return product


def _discrete_gradient(start: Array, end: Array, knee: float) -> Array:
    c = np.ones(len(start))
    both = (start >= knee) & (end >= knee)
    one = ~both & ((start > knee) | (end > knee))
    both &= ~((start <= knee) & (end <= knee))
    c[both] = 2.0 * knee / (start[both] + end[both])
    if one.any():
        inner, outer = np.minimum(start[one], end[one]), np.maximum(start[one], end[one])
        below, beyond = knee - inner, outer - knee
        c[one] = (below * (knee + inner) + 2.0 * beyond * knee) / ((below + beyond) * (outer + inner))
    return c
