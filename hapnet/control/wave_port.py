"""The two terminations of a wave line: they convert waves to force and motion, and back.

The wave variables of a port with velocity v, reaction f and wave impedance b (G. Niemeyer, J.-J. E. Slotine,
"Telemanipulation with Time Delays", Int. J. of Robotics Research 23(9), 2004):

    u = (b v + f)/sqrt(2b)    into the line at the device, out of it at the world
    w = (b v - f)/sqrt(2b)    in the other direction                              f v = u^2/2 - w^2/2

So a line that never outputs more energy than has come in is passive between two ports that obey this exactly. The
discretisation of both ports is derived here. Each axis has its own line.
"""

from __future__ import annotations

from math import sqrt
from typing import Protocol

from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample, Wave


class Line(Protocol):
    """The receiving end of one direction of a wave line. It may delay and lose waves, but it adds no energy."""

    def push(self, wave: Wave) -> None:
        """A wave arrived."""

    def take(self, dt: float) -> Vector:
        """Advance by `dt` seconds; the mean wave over that time [sqrt(W)]."""

    def clear(self) -> None:
        """Forget all waves that have arrived."""


class WaveDevice:
    """The device's end: ``f = b v - sqrt(2b) w`` against the device, ``u = sqrt(2b) v - w`` to the world.

    The force is held over a tick while v changes, and the actuator's limit or a release may cut it. So the wave to send
    is computed from what really happened. It carries the displacement ``sum(sqrt(2b) dx - w dt)``, which keeps the two
    ends together, but only as much of it as the energy at this port allows: ``w^2/2 dt - F dx`` with the force F really
    held. The rest of the displacement is sent when there is energy for it.

    Parameters
    ----------
    impedance : b [Ns/m]. position : of the device [m]. line : waves from the world.
    """

    def __init__(self, impedance: float, position: Vector, line: Line) -> None:
        self._b, self._root = impedance, sqrt(2.0 * impedance)
        self._line = line
        self._x = position
        self.on_peer_changed()

    def on_peer_changed(self) -> None:
        zeros = [0.0] * len(self._x)
        self._line.clear()
        self._rendered: Vector = tuple(zeros)  # int w dt of the wave that the force held now was made with
        self._rendered_s = 1.0  # over this time
        self._unsent = zeros  # int u dt
        self._energy = zeros.copy()
        self._span = 0.0

    @property
    def energy(self) -> float:
        """Energy that came in and was not sent, on the axis with the least [J]: it covers what the hold leaks."""
        return min(self._energy)

    @property
    def set_position(self) -> Vector:
        """The device's own position: a wave carries none."""
        return self._x

    def receive(self, sample: CouplingSample) -> None:
        assert isinstance(sample, Wave)
        self._line.push(sample)

    def force(self, dt: float, x: Vector, v: Vector, held: Vector) -> Vector:
        self._account(dt, x, held)
        root, b = self._root, self._b
        wave = self._line.take(dt)
        self._rendered, self._rendered_s = tuple([w * dt for w in wave]), dt
        return tuple([root * w - b * speed for w, speed in zip(wave, v, strict=True)])

    def release(self, dt: float, x: Vector, held: Vector) -> None:
        self._account(dt, x, held)
        self._line.take(dt)
        self._rendered = (0.0,) * len(x)

    def _account(self, dt: float, x: Vector, held: Vector) -> None:
        root, span = self._root, self._rendered_s
        for i, (now, before, force, wave) in enumerate(zip(x, self._x, held, self._rendered, strict=True)):
            moved = now - before
            self._energy[i] += wave * wave / (2.0 * span) - force * moved
            self._unsent[i] += root * moved - wave
        self._x = x
        self._span += dt

    def next_sample(self, x: Vector, v: Vector) -> Wave:
        span, unsent = self._span, self._unsent
        if span <= 0.0:
            return Wave((0.0,) * len(x), 0.0)
        sent = []
        for i, energy in enumerate(self._energy):
            most = sqrt(2.0 * energy * span) if energy > 0.0 else 0.0
            share = max(-most, min(most, unsent[i]))
            unsent[i] -= share
            self._energy[i] = energy - share * share / (2.0 * span)
            sent.append(share / span)
        self._span = 0.0
        return Wave(tuple(sent), span)


class WaveWorld:
    """The world's end: a massless set-position y between the line and the virtual coupling to the mass.

    Over a step of any length T, with vy the velocity of y, vhat the mass's, and ``a = B + K T/2``,

        sqrt(2b) u - b vy = f_c = a (vy - vhat) + K (y - x)        the line's force is the coupling's

    is solved for vy and f_c together with the mass: ``f_c = p - g vhat`` with ``g = a b/(a + b)`` and
    ``p = (a sqrt(2b) u + b K (y - x))/(a + b)``. It holds exactly that (u^2 - w^2)/2 T = f_c vy T, which is the change
    of the coupling's potential plus B (vy - vhat)^2 T plus f_c vhat T.

    Parameters
    ----------
    impedance : b [Ns/m]. stiffness, damping : K [N/m], B [Ns/m] of the virtual coupling. position : of the mass [m].
    line : waves from the device.
    """

    def __init__(self, impedance: float, stiffness: float, damping: float, position: Vector, line: Line) -> None:
        self._b, self._root = impedance, sqrt(2.0 * impedance)
        self._K, self._B = stiffness, damping
        self._line = line
        self._x = self._y = position
        self.on_peer_changed()

    def on_peer_changed(self) -> None:
        self._line.clear()
        self._u = self._silence = (0.0,) * len(self._x)
        self._out = Wave(self._silence, 0.0)

    @property
    def set_position(self) -> Vector:
        return self._y

    def receive(self, sample: CouplingSample) -> None:
        assert isinstance(sample, Wave)
        self._line.push(sample)

    def begin(self) -> None:
        """Do nothing: waves wait in the line until the step's length is known."""

    def impedance(self, dt: float) -> tuple[float, Vector]:
        b, a = self._b, self._B + 0.5 * self._K * dt
        self._u = self._line.take(dt)
        push = [
            (a * self._root * u + b * self._K * (y - x)) / (a + b)
            for u, y, x in zip(self._u, self._y, self._x, strict=True)
        ]
        return a * b / (a + b), tuple(push)

    def moved(self, dt: float, vhat: Vector, x: Vector, v: Vector) -> None:
        b, a, root = self._b, self._B + 0.5 * self._K * dt, self._root
        vy = [
            (root * u + a * speed - self._K * (y - before)) / (a + b)
            for u, speed, y, before in zip(self._u, vhat, self._y, self._x, strict=True)
        ]
        self._y = tuple([y + speed * dt for y, speed in zip(self._y, vy, strict=True)])
        self._x = x
        self._out = Wave(tuple([root * speed - u for speed, u in zip(vy, self._u, strict=True)]), dt)

    def next_sample(self) -> Wave:
        out, self._out = self._out, Wave(self._silence, 0.0)  # each wave once: a paused world has nothing to send
        return out
