"""A gamepad's motors: what the kernel is told, by the structures of its header, and what a device is told in a run."""

import ctypes
import math
import os
from pathlib import Path
from typing import ClassVar

import pytest

from hapnet.assembly.build import device_session, device_side, prepare
from hapnet.checks import Vector
from hapnet.control.contact_model import ContactModel
from hapnet.ext.devices.rumble import EVERY_S, FULL_N, Rumble
from hapnet.mechanics.effects import Effects, Grain
from hapnet.mechanics.plane import Plane
from hapnet.mechanics.spring import Spring
from hapnet.params import Params
from hapnet.side.endpoint import DeviceEndpoint
from tests.control.test_contact_effects import DEEP, SOFT, in_touch
from tests.control.test_contact_model import K_WALL, TICK, K, reported
from tests.side.test_real_device import Arm

u16, s16 = ctypes.c_uint16, ctypes.c_int16


class Periodic(ctypes.Structure):
    """struct ff_periodic_effect, the largest of the union."""

    _fields_: ClassVar = [
        ("waveform", u16), ("period", u16), ("magnitude", s16), ("offset", s16), ("phase", u16), ("envelope", u16 * 4),
        ("custom_len", ctypes.c_uint32), ("custom_data", ctypes.POINTER(s16)),
    ]  # fmt: skip


class Motors(ctypes.Structure):
    """struct ff_rumble_effect."""

    _fields_: ClassVar = [("strong", u16), ("weak", u16)]


class Union(ctypes.Union):
    _fields_: ClassVar = [("periodic", Periodic), ("rumble", Motors)]


class Effect(ctypes.Structure):
    """struct ff_effect."""

    _fields_: ClassVar = [
        ("type", u16), ("id", s16), ("direction", u16), ("trigger", u16 * 2), ("length", u16), ("delay", u16),
        ("u", Union),
    ]  # fmt: skip


class Event(ctypes.Structure):
    """struct input_event."""

    _fields_: ClassVar = [
        ("s", ctypes.c_long), ("us", ctypes.c_long), ("type", u16), ("code", u16), ("value", ctypes.c_int32),
    ]  # fmt: skip


class Kernel:
    """Takes what is uploaded, and numbers the effect 5."""

    def __init__(self, path: Path, fails: bool = False) -> None:
        self.path, self.fails = path, fails
        self.effects: list[Effect] = []
        self.now_s = 0.0
        path.touch()
        self.rumble = Rumble(os.open(path, os.O_RDWR), self.control, lambda: self.now_s)

    def control(self, file: int, request: int, effect: bytearray) -> None:
        if self.fails:
            raise OSError("no motors")
        assert request == 1 << 30 | ctypes.sizeof(Effect) << 16 | 0x45 << 8 | 0x80
        told = Effect.from_buffer(effect)
        assert told.type == 0x50
        assert told.id == (5 if self.effects else -1)
        told.id = 5
        self.effects.append(Effect.from_buffer_copy(effect))

    def played(self) -> list[tuple[int, int, int]]:
        data = self.path.read_bytes()
        size = ctypes.sizeof(Event)
        each = [Event.from_buffer_copy(data[i : i + size]) for i in range(0, len(data), size)]
        return [(one.type, one.code, one.value) for one in each]

    def tremble(self, amplitude_N: float, seconds: float, hz: float = 100.0) -> None:
        for _ in range(round(seconds / TICK)):
            self.now_s += TICK
            self.rumble.vibrate((amplitude_N * math.sin(2 * math.pi * hz * self.now_s), 0.0))


def test_the_motors_turn_as_fast_as_the_vibration_is_large(tmp_path: Path) -> None:
    kernel = Kernel(tmp_path / "event")
    kernel.tremble(0.5 * FULL_N, 0.5)
    assert len(kernel.effects) == pytest.approx(0.5 / EVERY_S, abs=2)
    for told in kernel.effects[1:]:
        assert told.u.rumble.weak == pytest.approx(0.5 * 65535, rel=0.05)
        assert told.u.rumble.strong == pytest.approx(told.u.rumble.weak / 2, abs=1)
        assert told.length > 1e3 * EVERY_S
    assert set(kernel.played()) == {(0x15, 5, 1)}
    kernel.tremble(10.0 * FULL_N, 0.1)
    assert kernel.effects[-1].u.rumble.weak == 65535


def test_they_stand_still_without_one_and_are_not_told_so_all_the_time(tmp_path: Path) -> None:
    kernel = Kernel(tmp_path / "event")
    kernel.tremble(0.0, 0.5)
    assert not kernel.effects
    kernel.tremble(FULL_N, 0.1)
    kernel.tremble(0.0, 0.5)
    assert kernel.effects[-1].u.rumble.weak == 0
    assert sum(told.u.rumble.weak == 0 for told in kernel.effects) == 1
    kernel.tremble(FULL_N, 0.1)
    kernel.rumble.close()
    assert kernel.effects[-1].u.rumble.weak == 0


def test_a_pad_without_motors_is_left_alone(tmp_path: Path) -> None:
    kernel = Kernel(tmp_path / "event", fails=True)
    kernel.tremble(FULL_N, 0.1)
    assert kernel.played() == []
    kernel.rumble.close()
    Rumble(None).vibrate((1.0,))
    Rumble.of("/dev/input/js-gone").close()


def test_a_device_is_told_what_of_the_force_the_grain_makes() -> None:
    """The height on the springs in series, while touched; nothing before."""
    m: ContactModel = in_touch(Effects(grain=Grain.sine(2e-4, 2e-3, (0.0, 1.0, 0.0))))
    spring = Spring(K, 3)
    m.step(TICK, (-0.001, 0.0005, 0.0))
    assert m.grain_force(spring) == (0.0, 0.0, 0.0)
    m.step(TICK, (DEEP, 0.0005, 0.0))
    assert m.grain_force(spring) == pytest.approx((-K * SOFT * 2e-4, 0.0, 0.0), rel=1e-3)


class Shaker(Arm):
    """A device with an actuator that only vibrates."""

    def __init__(self, dof: int) -> None:
        super().__init__(dof)
        self.felt: list[Vector] = []

    def vibrate(self, force: Vector) -> None:
        self.felt.append(force)


def test_a_driver_that_vibrates_is_told_at_each_tick() -> None:
    """A grain of one axis is as high everywhere: what the push is larger by, with K as the run has it."""
    params = Params().set({"hardware": f"{__name__}:Shaker", "scene": "plane", "dof": 1, "device.stiffness": K,
                           "device.self_test_N": 0.0})  # fmt: skip
    now_ns = 0
    setup = prepare(params)
    side = device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: now_ns, lambda sample: None)
    arm: Shaker = side.device.device  # type: ignore[attr-defined]  # the user's, inside
    side.endpoint.paired, arm.x = True, -0.005
    side.tick(now_ns)
    grain = Grain((0.0,), 2e-4, bytes([127, 127]))
    plane = Plane((1.0,), 0.0, K_WALL, 10.0, effects=Effects(grain=grain))
    side.coupling.receive(reported((plane,), (0.0,)), 0.0, 0.0)  # type: ignore[arg-type]
    for _ in range(50):
        now_ns += 2_000_000
        arm.x = min(DEEP, arm.x + 4e-4)
        side.tick(now_ns)
    assert len(arm.felt) == 50
    assert arm.felt[:10] == [(0.0,)] * 10
    assert arm.felt[-1] == pytest.approx((-K * SOFT * 2e-4,), rel=1e-9)
    side.stop_force(now_ns, "enough")
    side.tick(now_ns + 2_000_000)
    assert arm.felt[-1] == (0.0,)
