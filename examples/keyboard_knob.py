"""A knob turned with the keyboard: a device's class may read the terminal of `hapnet run` and `hapnet device`.

Keys: d and a turn the hand by 2 mm at the rim, space returns it. A wall at 20 mm stops the knob, but not the hand.

python examples/keyboard_knob.py                            # flags of `hapnet run` may follow: --link 4g
hapnet run --device examples.keyboard_knob:Knob --dof 1     # the same
"""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty

from hapnet import Driver

Vector = tuple[float, ...]
TURNS = {"d": 0.002, "a": -0.002}  # at the rim [m]


class Knob(Driver):
    """A knob in a hand: a mass at the rim, pulled by a spring and a damper to the hand's position set by the keys."""

    force_limit = 3.0  # of the motor, at the rim [N]
    resolution = 0.0  # of the encoder [m]; 0: exact

    MASS, HAND, DAMPING = 0.05, 60.0, 2.0  # kg, N/m, Ns/m

    def __init__(self, dof: int) -> None:
        self.dof = dof
        self._x = self._v = self._force = self._hand = 0.0
        self._read_s = time.monotonic()
        self._before = None
        if sys.stdin.isatty():  # read each key at once, without Enter
            self._before = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)

    def read(self) -> tuple[Vector, Vector]:
        """Position [m] and velocity [m/s] at the rim; called once per servo period, so it must not wait for a key."""
        for key in self._keys():
            self._hand = 0.0 if key == " " else self._hand + TURNS.get(key, 0.0)
        now = time.monotonic()
        dt, self._read_s = min(now - self._read_s, 0.01), now
        pull = self._force + self.HAND * (self._hand - self._x) - self.DAMPING * self._v
        self._v += dt * pull / self.MASS
        self._x += dt * self._v
        return (self._x,), (self._v,)

    def apply(self, force: Vector) -> None:
        """Hold this force [N] until the next call."""
        (self._force,) = force

    def close(self) -> None:
        """Restore the settings of the terminal."""
        if self._before is not None:
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def _keys(self) -> str:
        """The keys pressed since the last call."""
        ready = select.select([sys.stdin], [], [], 0.0)[0]
        return os.read(sys.stdin.fileno(), 64).decode(errors="ignore") if ready else ""


if __name__ == "__main__":
    from hapnet.cli import main

    raise SystemExit(main(["run", "--device", "examples.keyboard_knob:Knob", "--dof", "1", *sys.argv[1:]]))
