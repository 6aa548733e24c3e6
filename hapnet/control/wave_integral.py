"""Wave integrals: what keeps the two ends of a wave line together over a link that loses messages.

A wave carries displacement, sqrt(2b) dx, beside its energy. So a lost wave is lost displacement, and the ends drift
apart. G. Niemeyer, J.-J. E. Slotine ("Towards Force-Reflecting Teleoperation over the Internet", ICRA 1998, and their
paper of 2004) transmit the integral of the wave. So the receiver knows what it has missed, and lets that out as fast as
the energy that came with it allows.

Here each message tells the integral U(t) of all waves up to t. The receiver takes the difference to the last message
that arrived as one wave over the whole time between:

    u = (U_n - U_m)/(t_n - t_m),      u^2/2 (t_n - t_m) <= what the waves between carried     (Cauchy, Schwarz)

So nothing but their ripple is lost, and no energy is gained, whatever the link loses, repeats or reorders: a message
that comes after a later one adds nothing. The integral is believed, as the wave is.
"""

from __future__ import annotations

from collections.abc import Sequence

from hapnet.checks import Vector
from hapnet.control.coupling import Wave
from hapnet.control.wave_port import Line

LEAST = 1e-9
"""Displacement this small counts as recovered [sqrt(W) s]."""


class IntegralLine:
    """A line that makes up for lost waves, where their sender tells integrals; otherwise just that line.

    line : takes the waves, each over the time since the last.
    """

    def __init__(self, line: Line) -> None:
        self._line = line
        self._newest: tuple[Vector, float] | None = None

    def clear(self) -> None:
        self._line.clear()
        self._newest = None

    def push(self, wave: Wave) -> None:
        if wave.total:
            newest, self._newest = self._newest, (wave.total, wave.total_s)
            if newest is not None:
                before, before_s = newest
                span = wave.total_s - before_s
                if span <= 0.0:
                    self._newest = newest
                    return
                wave = Wave(tuple([(now - then) / span for now, then in zip(wave.total, before, strict=True)]), span)
        self._line.push(wave)

    def take(self, dt: float) -> Vector:
        return self._line.take(dt)


class Recovery:
    """Lets out the displacement that a queue has lost, as far as the energy that it has lost as well pays for it.

    A queue that drops waves, or plays them faster, leaves a displacement U and an energy E behind. An output of 2 E/U
    would use up both at the same time (Niemeyer, Slotine 1998). Here c is added to the queue's own output z. That costs
    z + c/2 for each unit of displacement, so no more than E/U if c <= 2 (E/U - z).

    Parameters
    ----------
    dof : components of a wave. time : time constant of the recovery, if there is energy enough [s]; 0: none.
    """

    def __init__(self, dof: int, time: float) -> None:
        self._dof, self._time = dof, time
        self.clear()

    def clear(self) -> None:
        self.owed: list[float] = [0.0] * self._dof
        """U [sqrt(W) s]."""
        self.spare: list[float] = [0.0] * self._dof
        """E [J]."""

    def lose(self, wave: Wave) -> None:
        """The queue has dropped this wave."""
        for i, value in enumerate(wave.value):
            self.owed[i] += value * wave.span
            self.spare[i] += 0.5 * value * value * wave.span

    def output(self, dt: float, wave: Vector, total: Sequence[float], squares: Sequence[float]) -> Vector:
        """What to output over the next `dt` seconds for the queue's `wave`, made of waves with these integrals."""
        if not self._time:
            return wave
        whole = []
        for i, z in enumerate(wave):
            self.owed[i] += total[i] - z * dt
            self.spare[i] += 0.5 * (squares[i] - z * z * dt)
            whole.append(z + self._more(i, dt, z))
        return tuple(whole)

    def _more(self, i: int, dt: float, z: float) -> float:
        owed, spare = self.owed[i], self.spare[i]
        if abs(owed) < LEAST or spare <= 0.0:
            return 0.0
        sign = 1.0 if owed > 0.0 else -1.0
        c = sign * min(abs(owed) / (self._time + dt), max(0.0, 2.0 * (spare / abs(owed) - sign * z)))
        self.owed[i] = owed - c * dt
        self.spare[i] = spare - c * (z + 0.5 * c) * dt
        return c
