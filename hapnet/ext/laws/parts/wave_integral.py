"""Wave integrals: they keep the two ends of a wave line together over a link that loses messages.

A wave carries displacement, sqrt(2b) dx, beside its energy. So a lost wave is lost displacement, and the ends drift
apart. G. Niemeyer, J.-J. E. Slotine ("Towards Force-Reflecting Teleoperation over the Internet", ICRA 1998, and their
paper of 2004) transmit the integral of the wave. From it the receiver computes the displacement that it has missed, and
outputs it as fast as the energy that came with it allows.

Here each message has the integral U(t) of all waves up to t. The receiver treats the difference to the last message
that arrived as a single wave over the whole time between:

    u = (U_n - U_m)/(t_n - t_m),      u^2/2 (t_n - t_m) <= energy of the waves between     (Cauchy, Schwarz)

So only the ripple of the lost waves is lost, and no energy is gained, whatever the link loses, repeats or reorders: a
message that comes after a later message adds nothing. The integral is trusted, as the wave is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, cast

from hapnet.checks import Vector
from hapnet.control.law import NOT_SENT
from hapnet.control.samples import WaveSample
from hapnet.records.record import Floats, OfAxes, Reals, Record, equation
from hapnet.records.vectors import copy

MINIMUM = 1e-9
"""A displacement below this counts as recovered [sqrt(W) s]."""


class WaveReceiver(Protocol):
    """The receiving end of one direction of a wave line. It may delay and lose waves, but it adds no energy."""

    def push(self, wave: WaveSample) -> None:
        """Take in a wave that arrived."""

    def take(self, dt: float) -> Vector:
        """Advance by `dt` seconds; return the mean wave over that time [sqrt(W)]."""

    def clear(self) -> None:
        """Forget all waves that have arrived."""


def push_on(line: Record, value: Reals, span: float) -> None:
    """Take in a wave that arrived; compiled code calls the line's `put`."""
    cast(WaveReceiver, line).push(WaveSample(tuple(value), span))


def take_from(line: Record, dt: float, out: Floats) -> None:
    """Compute the mean wave over the next `dt` seconds; compiled code calls the line's `draw`."""
    out[:] = cast(WaveReceiver, line).take(dt)


class IntegralLine(Record):
    """A line that makes up for lost waves, if their sender sends integrals; otherwise equivalent to `line`.

    line : receives the waves, each over the time since the last. uses_integrals : whether integrals are used.

    Attributes
    ----------
    newest, newest_s : the last integral [sqrt(W) s] and its time [s], if there is one (`is_newest`). mean : temporary
        memory for a wave.
    """

    line: Record
    uses_integrals: int
    is_newest: int
    newest: OfAxes
    newest_s: float
    mean: OfAxes

    def __init__(self, line: WaveReceiver, *, uses_integrals: bool = True) -> None:
        super().__init__()
        self.line = cast(Record, line)  # plain Python takes any line
        self.uses_integrals = int(uses_integrals)

    def clear(self) -> None:
        cast(WaveReceiver, self.line).clear()
        self.is_newest = 0

    def push(self, wave: WaveSample) -> None:
        if len(self.mean) != (n := len(wave.value)):
            self.mean, self.newest = [0.0] * n, [0.0] * n
        put(self, wave.value, wave.total, wave.span, wave.total_s if wave.total else NOT_SENT)

    def take(self, dt: float) -> Vector:
        return cast(WaveReceiver, self.line).take(dt)


@equation
def put(line: IntegralLine, value: Reals, more: Reals, span: float, total_s: float) -> None:
    """Push a wave, or the mean wave since the newest integral, into the line: `IntegralLine.push`."""
    if line.uses_integrals and total_s >= 0.0:
        since = total_s - line.newest_s
        was_known = line.is_newest != 0
        if was_known and since <= 0.0:
            return
        if was_known:
            for i in range(len(line.mean)):
                line.mean[i] = (more[i] - line.newest[i]) / since
        copy(len(line.mean), more, line.newest)
        line.newest_s, line.is_newest = total_s, 1
        if was_known:
            push_on(line.line, line.mean, since)
            return
    push_on(line.line, value, span)


class Recovery(Record):
    """Outputs the displacement that a queue has lost, if the energy that was lost with it suffices.

    A queue that drops waves, or plays them faster, loses a displacement U and an energy E. An output of 2 E/U would use
    up both at the same time (Niemeyer, Slotine 1998). Here c is added to the queue's own output z. This costs z + c/2
    per unit of displacement, so no more than E/U if c <= 2 (E/U - z).

    dof : components of a wave. time : time constant of the recovery, if the energy suffices [s]; 0: no recovery.

    Attributes
    ----------
    owed : U [sqrt(W) s]. spare : E [J].
    """

    owed: OfAxes
    spare: OfAxes
    n: int
    time: float

    def __init__(self, dof: int, time: float) -> None:
        self.n, self.time = dof, time
        self.clear()

    def clear(self) -> None:
        self.owed, self.spare = [0.0] * self.n, [0.0] * self.n

    def lose(self, wave: WaveSample) -> None:
        """Count a wave that the queue has dropped."""
        lose(self, wave.value, wave.span)

    def output(self, dt: float, wave: Vector, total: Sequence[float], squares: Sequence[float]) -> Vector:
        """Return the output over the next `dt` seconds; `wave` is the queue's, made of waves with these integrals."""
        out = list(wave)
        recover(self, dt, out, total, squares)
        return tuple(out)


@equation
def lose(recovery: Recovery, value: Reals, span: float) -> None:
    """Count a wave that the queue has dropped: `Recovery.lose`."""
    for i in range(recovery.n):
        recovery.owed[i] += value[i] * span
        recovery.spare[i] += 0.5 * value[i] * value[i] * span


@equation
def recover(recovery: Recovery, dt: float, wave: Floats, total: Reals, squares: Reals) -> None:
    """Replace the queue's wave by the output over the next `dt` seconds: `Recovery.output`."""
    if recovery.time == 0.0:
        return
    for i in range(recovery.n):
        z = wave[i]
        recovery.owed[i] += total[i] - z * dt
        recovery.spare[i] += 0.5 * (squares[i] - z * z * dt)
        wave[i] = z + _more(recovery, i, dt, z)


@equation
def _more(recovery: Recovery, i: int, dt: float, z: float) -> float:
    owed, spare = recovery.owed[i], recovery.spare[i]
    if abs(owed) < MINIMUM or spare <= 0.0:
        return 0.0
    sign = 1.0 if owed > 0.0 else -1.0
    c = sign * min(abs(owed) / (recovery.time + dt), max(0.0, 2.0 * (spare / abs(owed) - sign * z)))
    recovery.owed[i] = owed - c * dt
    recovery.spare[i] = spare - c * (z + 0.5 * c) * dt
    return c
