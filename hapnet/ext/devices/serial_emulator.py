"""An emulator of the serial axis on a pseudo-terminal, with faults on request."""

from __future__ import annotations

import random
import select
import threading
from collections.abc import Callable
from typing import ClassVar

from hapnet.ext.devices import serial_frames as wire
from hapnet.ext.devices.emulator import NANO, EmulatedHandle, Emulator
from hapnet.ext.devices.pseudo_terminal import PseudoTerminal

_PERIOD_NS = 1_000_000
_STALLED_NS = 500_000_000
_LIMIT_N, _COUNT_NM, _REACH_UM, _WATCHDOG_MS = 3.0, 1000, 80_000, 20


class SerialEmulator(Emulator):
    """An axis like that of `serial_axis.ino`: 3 N, 1 um, 80 mm in both directions, 1 kHz, and a watchdog of 20 ms.

    link : a path that points to the pseudo-terminal, whose own name changes. noise : share of the bytes that get lost,
    in each direction. stall : so many seconds after its first command it neither sends nor receives for 0.5 s.
    rubbish : share of the states that are random bytes. units : factor of its positions; 1000 is a mistake of units.
    button : whether its dead-man switch is held. seed : of the random numbers.
    """

    dof = 1
    resolution_m: float = _COUNT_NM * 1e-9
    force_limit: ClassVar[float] = _LIMIT_N
    watchdog_s: ClassVar[float] = _WATCHDOG_MS * 1e-3

    def __init__(
        self,
        handle: EmulatedHandle,
        clock: Callable[[], int],
        link: str = "",
        noise: float = 0.0,
        stall: float = 0.0,
        rubbish: float = 0.0,
        units: float = 1.0,
        button: bool = True,
        seed: int = 0,
    ) -> None:
        super().__init__(handle, clock)
        self._stall_s, self._rubbish, self._units, self._button = stall, rubbish, units, button
        self._random = random.Random(seed)
        self._terminal = PseudoTerminal(link, noise, self._random)
        self.address: str = self._terminal.address
        self._unread = b""
        self._first_ns: int | None = None  # time of the first command
        self._number = 0

    def run(self, stop: threading.Event) -> None:
        start_ns = due_ns = self._clock()
        while not stop.is_set():
            left = (due_ns - self._clock()) * NANO
            if left > 0.0:
                if select.select([self._terminal.device], [], [], left)[0]:
                    self._receive()
                continue
            if self._stall_s and self._first_ns is not None and due_ns - self._first_ns >= self._stall_s / NANO:
                self._stall_s = 0.0
                due_ns += _STALLED_NS
                stop.wait((due_ns - self._clock()) * NANO)
                continue
            self._send_state(start_ns)
            now_ns = self._clock()
            due_ns = (now_ns if now_ns - due_ns > _PERIOD_NS // 2 else due_ns) + _PERIOD_NS  # without catching up
        self._terminal.close()

    def _send_state(self, start_ns: int) -> None:
        now_ns = self._clock()
        (x,), _ = self.handle.read(now_ns)
        impulse = self.handle.impulse_at(now_ns)[0] / _LIMIT_N * wire.FULL * 1e6 / wire.IMPULSE_US
        state = wire.BoardState(
            wire.flags(int(self._button), homed=True),
            self._number,
            (now_ns - start_ns) // 1000 % wire.WRAP,
            round(x * self._units / self.resolution_m) * _COUNT_NM,
            min(self.handle.age_ns(now_ns) // 1000, wire.OLDEST_US),
            round(impulse) % wire.WRAP,
        )
        frame = wire.state(state)
        if self._rubbish and self._random.random() < self._rubbish:
            frame = self._random.randbytes(len(frame))
        self._terminal.write(frame)

    def _receive(self) -> None:
        commands, self._unread = wire.commands(self._unread + self._terminal.read())
        for command in commands:
            if command.mark == b"F":
                self._number = command.number
                self._first_ns = self._first_ns or self._clock()
                self.handle.hold(self._clock(), (command.force / wire.FULL * _LIMIT_N,))
            elif command.mark == b"Q":
                period_us = _PERIOD_NS // 1000
                limit_uN = round(_LIMIT_N * 1e6)
                self._terminal.write(wire.about(wire.About(
                    wire.VERSION, period_us, 0, _WATCHDOG_MS, limit_uN, 0, _COUNT_NM, _COUNT_NM, _REACH_UM, 1, 0
                )))  # fmt: skip
