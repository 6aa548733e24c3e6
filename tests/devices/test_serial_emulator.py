"""The serial axis's emulator without a port: what it does with a command, and what its states say."""

from types import SimpleNamespace
from typing import Any

import pytest

from hapnet.ext.devices import serial_frames as wire
from hapnet.ext.devices.serial_emulator import SerialEmulator


def test_commands_and_states_are_in_the_pages_units() -> None:
    """Force in 1/FULL of the limit; 1.5 ms on its clock, 2 mm, 0.7 ms old, and an impulse of 1 Ns."""
    held: list[tuple[int, float]] = []
    handle: Any = SimpleNamespace(
        hold=lambda at_ns, force: held.append((at_ns, force[0])), read=lambda at_ns: ((2e-3,), (0.0,)),
        impulse_at=lambda at_ns: (1.0,), age_ns=lambda at_ns: 700_000,
    )  # fmt: skip
    axis: Any = SerialEmulator(handle, lambda: 2_000_000)
    axis._terminal.close()
    came, sent = (
        [wire.command(wire.BoardCommand(b"F", 9, wire.FULL // 2)), wire.command(wire.BoardCommand(b"Q"))],
        wire.FrameParser(),
    )
    found: list[Any] = []
    axis._terminal = SimpleNamespace(read=lambda: came.pop(0), write=lambda data: found.extend(sent.feed(data)))
    axis._receive()
    axis._send_state(500_000)
    axis._receive()
    assert held == [(2_000_000, pytest.approx(SerialEmulator.force_limit / 2, rel=1e-4))]
    state, about = found
    assert (state.command, state.time_us, state.position_nm, state.age_us) == (9, 1500, 2_000_000, 700)
    full_Ns = SerialEmulator.force_limit * wire.IMPULSE_US * 1e-6
    assert state.impulse * full_Ns / wire.FULL == pytest.approx(1.0, rel=1e-4)
    assert (about.limit_uN * 1e-6, about.watchdog_ms * 1e-3) == (SerialEmulator.force_limit, SerialEmulator.watchdog_s)
