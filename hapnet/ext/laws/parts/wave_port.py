"""The two terminations of a wave line: they convert waves to force and motion, and back.

The wave variables of a port with velocity v, reaction f and wave impedance b (G. Niemeyer, J.-J. E. Slotine,
"Telemanipulation with Time Delays", Int. J. of Robotics Research 23(9), 2004):

    u = (b v + f)/sqrt(2b)    into the line at the device, out of it at the world
    w = (b v - f)/sqrt(2b)    in the other direction                              f v = u^2/2 - w^2/2

So a line that never outputs more energy than its input is passive between two ports that obey this exactly. The
discretisation of both ports is derived here. Each axis has its own line.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import Any, cast

from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample, WaveSample
from hapnet.control.law import DeviceEnd, End, WorldEnd
from hapnet.ext.laws.parts import wave_filter, wave_integral
from hapnet.ext.laws.parts.wave_filter import WaveFilter
from hapnet.ext.laws.parts.wave_integral import IntegralLine, WaveReceiver, push_on, take_from
from hapnet.records.record import Floats, OfAxes, Reals, Record, compiled_as, equation, fields
from hapnet.records.vectors import copy


class _Port(End):
    """The common part of both ends. line : of incoming waves. b : the wave impedance [Ns/m]. root : sqrt(2b)."""

    line: Record
    b: float
    root: float

    sends = WaveSample

    def __init__(self, impedance: float, position: Vector, line: WaveReceiver) -> None:
        super().__init__(position)
        self.line = cast(Record, line)  # plain Python takes any line
        self.b, self.root = impedance, sqrt(2.0 * impedance)

    def receive(self, sample: CouplingSample) -> None:
        assert isinstance(sample, WaveSample)
        cast(WaveReceiver, self.line).push(sample)

    @classmethod
    def lines(cls) -> dict[Callable[..., Any], Callable[..., Any]]:
        line = cls
        while "line" in fields(line):
            line = fields(line)["line"]
        known: Any = line
        return {push_on: known.put, take_from: known.draw}


class WaveDevice(_Port, DeviceEnd):
    """The device's end: ``f = b v - sqrt(2b) w`` against the device, ``u = sqrt(2b) v - w`` to the world.

    The force is held over a tick while v changes, and the actuator's limit or a release may reduce it. So the wave to
    send is computed from the real motion and force. It carries the displacement ``sum(sqrt(2b) dx - w dt)``, which
    keeps the two ends together, but only as much of it as the energy at this port allows: ``w^2/2 dt - F dx`` with the
    force F really held. The rest of the displacement is sent when there is energy for it. The set-position is the
    device's own position: a wave carries no position.

    impedance : b [Ns/m]. position : of the device [m]. line : waves from the world.

    Attributes
    ----------
    rendered, rendered_s : integral of the wave in the present force, and its time [s]. unsent : integral of u that was
    not sent. energies : input on each axis that was not sent [J]; they cover the leak of the hold. span : time since
    the last sample [s].
    """

    rendered: OfAxes
    rendered_s: float
    unsent: OfAxes
    energies: OfAxes
    span: float

    def __init__(self, impedance: float, position: Vector, line: WaveReceiver) -> None:
        super().__init__(impedance, position, line)
        self.on_peer_changed()

    def on_peer_changed(self) -> None:
        cast(WaveReceiver, self.line).clear()
        self.rendered, self.unsent, self.energies = ([0.0] * self.n for _ in range(3))
        self.rendered_s, self.span = 1.0, 0.0

    @equation
    def take(self, value: Reals, more: Reals, amount: float, total_s: float) -> None:
        """Take in a wave."""
        wave_integral.put(self.line.line, value, more, amount, total_s)  # type: ignore[attr-defined]  # as compiled

    @equation
    def render(self, dt: float, x: Reals, v: Reals, held: Reals, out: Floats) -> None:
        """The force to hold [N]."""
        _account(self, dt, x, held)
        _take_filtered(self.line, dt, out)
        self.rendered_s = dt
        for i in range(self.n):
            wave = out[i]
            self.rendered[i] = wave * dt
            out[i] = self.root * wave - self.b * v[i]

    def release(self, dt: float, x: Vector, held: Vector) -> None:
        _account(self, dt, x, held)
        cast(WaveReceiver, self.line).take(dt)
        self.rendered[:] = [0.0] * self.n

    @equation
    def set_outgoing(self, x: Reals, v: Reals) -> None:
        """Write the wave since the last sample into `outgoing`."""
        outgoing, span, unsent = self.outgoing, self.span, self.unsent
        outgoing.amount = span
        if span <= 0.0:
            outgoing.amount = 0.0
            for i in range(self.n):
                outgoing.value[i] = 0.0
            return
        for i in range(self.n):
            energy = self.energies[i]
            most = sqrt(2.0 * energy * span) if energy > 0.0 else 0.0
            share = max(-most, min(most, unsent[i]))
            unsent[i] -= share
            self.energies[i] = energy - share * share / (2.0 * span)
            outgoing.value[i] = share / span
        self.span = 0.0


@equation
def _account(port: WaveDevice, dt: float, x: Reals, held: Reals) -> None:
    """Count energy and displacement since the last tick."""
    for i in range(port.n):
        moved, wave = x[i] - port.y[i], port.rendered[i]
        port.energies[i] += wave * wave / (2.0 * port.rendered_s) - held[i] * moved
        port.unsent[i] += port.root * moved - wave
        port.y[i] = x[i]
    port.span += dt


class WaveWorld(_Port, WorldEnd):
    """The world's end: a massless set-position y between the line and the virtual coupling to the mass.

    Over a step of any length T, with vy the velocity of y, vhat the mass's, and ``a = B + K T/2``,

        sqrt(2b) u - b vy = f_c = a (vy - vhat) + K (y - x)        the line's force is the coupling's

    is solved for vy and f_c together with the mass: ``f_c = p - g vhat`` with ``g = a b/(a + b)`` and
    ``p = (a sqrt(2b) u + b K (y - x))/(a + b)``. Then (u^2 - w^2)/2 T = f_c vy T exactly, which is the change of the
    coupling's potential plus B (vy - vhat)^2 T plus f_c vhat T.

    impedance : b [Ns/m]. stiffness, damping : K [N/m], B [Ns/m] of the virtual coupling. position : of the mass [m].
    line : waves from the device.

    Attributes
    ----------
    x : the mass's position [m]. u : the wave of the running step. out, out_s : the wave to send, and its span [s].
    """

    K: float
    B: float
    x: OfAxes
    u: OfAxes
    out: OfAxes
    out_s: float

    def __init__(
        self, impedance: float, stiffness: float, damping: float, position: Vector, line: WaveReceiver
    ) -> None:
        super().__init__(impedance, position, line)
        self.K, self.B = stiffness, damping
        self.x = list(position)
        self.on_peer_changed()

    def on_peer_changed(self) -> None:
        cast(WaveReceiver, self.line).clear()
        self.u, self.out = [0.0] * self.n, [0.0] * self.n
        self.out_s = 0.0

    @equation
    def take(self, value: Reals, more: Reals, amount: float, total_s: float) -> None:
        """Take in a wave; it waits in the line until the step's length is known."""
        wave_integral.put(self.line, value, more, amount, total_s)  # type: ignore[arg-type]  # as compiled

    @equation
    def drag(self, dt: float) -> float:
        """Compute g and p."""
        b, a = self.b, self.B + 0.5 * self.K * dt
        _take_whole(self.line, dt, self.u)
        for i in range(self.n):
            self.push[i] = (a * self.root * self.u[i] + b * self.K * (self.y[i] - self.x[i])) / (a + b)
        return a * b / (a + b)

    @equation
    def moved(self, dt: float, vhat: Reals, x: Reals, v: Reals) -> None:
        """Complete the step."""
        b, a, root = self.b, self.B + 0.5 * self.K * dt, self.root
        for i in range(self.n):
            u = self.u[i]
            vy = (root * u + a * vhat[i] - self.K * (self.y[i] - self.x[i])) / (a + b)
            self.y[i] = self.y[i] + vy * dt
            self.out[i] = root * vy - u
        copy(self.n, x, self.x)
        self.out_s = dt

    @equation
    def set_outgoing(self) -> None:
        """Write the wave into `outgoing`, each wave once: a paused world sends zero."""
        copy(self.n, self.out, self.outgoing.value)
        self.outgoing.amount = self.out_s
        for i in range(self.n):
            self.out[i] = 0.0
        self.out_s = 0.0


def _filtered(line: WaveFilter, dt: float, out: Floats) -> None:
    wave_filter.draw(line, dt)
    copy(line.n, line.wave, out)


@compiled_as(_filtered)
def _take_filtered(line: Record, dt: float, out: Floats) -> None:
    out[:] = cast(WaveReceiver, line).take(dt)


def _whole(line: IntegralLine, dt: float, out: Floats) -> None:
    take_from(line.line, dt, out)


@compiled_as(_whole)
def _take_whole(line: Record, dt: float, out: Floats) -> None:
    out[:] = cast(WaveReceiver, line).take(dt)
