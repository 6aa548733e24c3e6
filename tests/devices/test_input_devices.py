"""Gamepad and 3D mouse, from events as the kernel gives them: written by hand after its documentation."""

import errno
import math
import os
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from hapnet.devices.registry import options, resolve
from hapnet.errors import DeviceSilent, InvalidParameter
from hapnet.ext.devices.gamepad import Gamepad
from hapnet.ext.devices.input_device import InputDevice
from hapnet.ext.devices.space_mouse import SpaceMouse, _is_ours
from hapnet.ext.tools.posed import Posed
from hapnet.mechanics.pose import coordinates

MILLI = 0.001


def js(value: int, kind: int, number: int) -> bytes:
    return struct.pack("=IhBB", 123456, value, kind, number)


class Pipe:
    """A named pipe in place of the kernel's file."""

    def __init__(self, path: Path) -> None:
        self.path = str(path)
        os.mkfifo(path)
        self.end = os.open(path, os.O_RDWR)

    def write(self, *events: bytes) -> None:
        for event in events:
            os.write(self.end, event)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [0.0]
    monkeypatch.setattr("hapnet.ext.devices.input_device.time.monotonic", lambda: now[0])
    return now


@pytest.fixture
def pipe(tmp_path: Path) -> Iterator[Pipe]:
    pipe = Pipe(tmp_path / "events")
    yield pipe
    os.close(pipe.end)


def settled(device: InputDevice, clock: list[float]) -> tuple[float, ...]:
    for _ in range(1000):
        clock[0] += MILLI
        device.read()
    return device.read()[0]


def test_the_left_stick_is_the_position(pipe: Pipe, clock: list[float]) -> None:
    pad = Gamepad(3, path=pipe.path)
    pipe.write(js(0, 0x82, 0), js(0, 0x82, 1), js(0, 0x81, 0))  # what it is at first
    assert settled(pad, clock) == (0.0, 0.0, 0.0)
    pipe.write(js(32767, 0x02, 0), js(-32767, 0x02, 1), js(16384, 0x02, 4), js(32767, 0x02, 2))
    # down is minus z; half is (0.5 - 0.05) / 0.95; axis 2 is a trigger
    assert settled(pad, clock) == pytest.approx((0.04, 0.04, -0.04 * 0.45 / 0.95), rel=1e-3)
    pipe.write(js(1000, 0x02, 0), js(0, 0x02, 1), js(0, 0x02, 4))
    assert settled(pad, clock) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)  # 3 % is within the dead zone
    pad.close()


def test_a_trigger_closes_a_jaw(pipe: Pipe, clock: list[float]) -> None:
    """The kernel's axis is -32767 where the trigger is released; of half the way 5 % are the dead zone."""
    pad = Gamepad(3, path=pipe.path, jaw=5, axes="xy")
    assert pad.jaw
    assert pad.read()[0] == (0.0, 0.0, 0.04)
    pipe.write(js(-32767, 0x82, 5), js(32767, 0x02, 0))
    assert settled(pad, clock) == pytest.approx((0.04, 0.0, 0.04))
    pipe.write(js(0, 0x02, 5))
    assert settled(pad, clock) == pytest.approx((0.04, 0.0, 0.04 * (1.0 - 0.45 / 0.95)), rel=1e-3)
    pipe.write(js(32767, 0x02, 5))
    assert settled(pad, clock) == pytest.approx((0.04, 0.0, 0.0), abs=1e-9)
    assert pad.apply((1.0, 1.0, 1.0)) == (0.0, 0.0, 0.0)
    pad.close()


def test_a_jaw_is_a_position_also_with_a_rate(pipe: Pipe, clock: list[float]) -> None:
    pad = Gamepad(1, path=pipe.path, jaw=2, rate=1.0)
    pipe.write(js(32767, 0x02, 2))
    assert settled(pad, clock) == pytest.approx((0.0,), abs=1e-9)
    pipe.write(js(-32767, 0x02, 2))
    assert settled(pad, clock) == pytest.approx((0.04,))
    pad.close()


@pytest.mark.parametrize("jaw", [-1, 4])
def test_a_stick_is_no_trigger(jaw: int, pipe: Pipe) -> None:
    with pytest.raises(InvalidParameter, match=f"jaw is {jaw}; allowed: a trigger's axis"):
        Gamepad(4, path=pipe.path, jaw=jaw)


def test_a_pad_whose_right_stick_has_another_number(pipe: Pipe, clock: list[float]) -> None:
    pad = Gamepad(3, path=pipe.path, sticks="3/4/0")
    pipe.write(js(32767, 0x02, 3), js(-32767, 0x02, 4), js(32767, 0x02, 0), js(32767, 0x02, 1))
    assert settled(pad, clock) == pytest.approx((0.04, 0.04, -0.04), rel=1e-3)
    pad.close()


@pytest.mark.parametrize("sticks", ["0/1", "0/1/1", "x/1/2", ""])
def test_sticks_that_are_no_three_numbers_are_refused(sticks: str) -> None:
    with pytest.raises(InvalidParameter, match="three different numbers of axes"):
        Gamepad(3, sticks=sticks)


def test_buttons_are_told_by_their_numbers(pipe: Pipe, clock: list[float]) -> None:
    pad = Gamepad(1, path=pipe.path)
    pipe.write(js(0, 0x81, 0), js(0, 0x81, 1), js(0, 0x81, 2))
    pad.read()
    assert pad.buttons() == (False, False, False)
    pipe.write(js(1, 0x01, 2))
    pad.read()
    assert pad.buttons() == (False, False, True)
    pad.close()


def test_a_stick_that_jumps_makes_a_motion_that_the_range_allows(pipe: Pipe, clock: list[float]) -> None:
    """Read at 1 kHz: each velocity is the difference of positions over the time, and below the declared speed."""
    pad = Gamepad(1, path=pipe.path)
    pad.read()
    pipe.write(js(32767, 0x02, 0))
    before = 0.0
    for _ in range(100):
        clock[0] += MILLI
        (x,), (v,) = pad.read()
        assert v == pytest.approx((x - before) / MILLI, rel=1e-9, abs=1e-12)
        assert abs(v) < pad.greatest_speed
        before = x
    assert before > 0.039
    assert pad.apply((3.0,)) == (0.0,)
    pad.close()


@given(st.lists(st.binary(max_size=20), max_size=10))
@pytest.mark.long
def test_any_bytes_leave_positions_within_reach(chunks: list[bytes]) -> None:
    for kind in (Gamepad, SpaceMouse):
        device = kind(3, path=os.devnull)
        unread = b""
        for chunk in chunks:
            unread += chunk
            unread = unread[device.take(unread) :]
        assert all(-1.0 <= d <= 1.0 for d in device.deflections)
        assert len(device.buttons()) <= 256


@pytest.mark.parametrize("newer", [False, True])
def test_a_3d_mouse(newer: bool, pipe: Pipe, clock: list[float]) -> None:
    """To the right, towards the user and down in its reports; x right, y away and z up here."""
    mouse = SpaceMouse(3, path=pipe.path, dead=0.0)
    rotation = struct.pack("<3h", 0, 0, -350)  # about the axis that points down
    pipe.write(b"\x01" + struct.pack("<3h", 350, 175, -350) + (rotation if newer else b""))
    assert mouse.orientation() == (1.0, 0.0, 0.0, 0.0)
    if not newer:
        mouse.read()  # the kernel returns one report at a time
        pipe.write(b"\x02" + rotation)
    assert settled(mouse, clock) == pytest.approx((0.04, -0.02, 0.04), rel=1e-3)
    assert mouse.orientation() == pytest.approx((math.cos(0.25), 0.0, 0.0, math.sin(0.25)), abs=1e-9)
    pipe.write(b"\x02" + struct.pack("<3h", 0, 175, 0))
    settled(mouse, clock)
    assert mouse.orientation() == pytest.approx((math.cos(0.125), 0.0, -math.sin(0.125), 0.0), abs=1e-9)
    mouse.close()


def test_with_a_rate_a_deflection_is_a_velocity(pipe: Pipe, clock: list[float]) -> None:
    """A second at full deflection makes rate times reach, late by the filter's 20 ms; then it stays there."""
    mouse = SpaceMouse(3, path=pipe.path, dead=0.0, rate=0.5, turn=0.8)
    mouse.read()
    pipe.write(b"\x01" + struct.pack("<6h", 350, 0, 175, 0, 350, 0))
    settled(mouse, clock)
    pipe.write(b"\x01" + struct.pack("<6h", 0, 0, 0, 0, 0, 0))
    x = settled(mouse, clock)  # it goes on for as long as it was late
    assert x == pytest.approx((0.02, 0.0, -0.01), rel=1e-3)
    turned = 0.4
    assert mouse.orientation() == pytest.approx((math.cos(turned / 2), 0.0, -math.sin(turned / 2), 0.0), abs=1e-3)
    assert settled(mouse, clock) == pytest.approx(x, abs=1e-12)
    pipe.write(b"\x01" + struct.pack("<6h", 350, 0, 0, 350, 0, 0))
    for _ in range(3):
        assert settled(mouse, clock)[0] <= 0.04
    assert settled(mouse, clock)[0] == 0.04  # it stays within reach
    assert mouse.read()[1][0] == 0.0
    w, i, j, k = mouse.orientation()
    assert w * w + i * i + j * j + k * k == pytest.approx(1.0, abs=1e-12)
    # -0.4 rad about y, then four seconds of 0.4 rad/s about the axis x, which does not turn with it
    both = (math.cos(0.8) * math.cos(0.2), math.sin(0.8) * math.cos(0.2))
    assert (w, i, j) == pytest.approx((both[0], both[1], -math.cos(0.8) * math.sin(0.2)), abs=0.01)
    mouse.close()


def test_a_stick_with_a_rate_stays_where_it_is_let_go(pipe: Pipe, clock: list[float]) -> None:
    pad = Gamepad(1, path=pipe.path, rate=1.0)
    pad.read()
    pipe.write(js(32767, 0x02, 0))
    for _ in range(500):
        clock[0] += MILLI
        pad.read()
    pipe.write(js(0, 0x02, 0))
    assert settled(pad, clock) == pytest.approx((0.02,), rel=1e-2)
    pad.close()


def test_a_3d_mouse_moves_a_tool(pipe: Pipe, clock: list[float]) -> None:
    device = Posed(SpaceMouse(3, path=pipe.path, dead=0.0), "3dmouse", clock=lambda: clock[0])
    pipe.write(b"\x01" + struct.pack("<6h", 350, 0, 0, 0, 0, -350))
    for _ in range(1000):
        clock[0] += MILLI
        x, _ = device.read()
    assert x == pytest.approx(coordinates((0.04, 0.0, 0.0), (math.cos(0.25), 0.0, 0.0, math.sin(0.25))), abs=1e-6)
    device.close()


def test_a_3d_mouses_buttons(pipe: Pipe, clock: list[float]) -> None:
    mouse = SpaceMouse(1, path=pipe.path)
    pipe.write(b"\x03\x02\x00")
    mouse.read()
    assert mouse.buttons() == (False, True)
    mouse.close()


@pytest.mark.parametrize(
    ("reported", "ours"),
    [
        ("HID_ID=0003:0000256F:0000C62E\nHID_NAME=SpaceMouse", True),
        ("HID_ID=0003:0000046D:0000C626", True),
        ("HID_ID=0003:0000046D:0000C077", False),  # a plain mouse
        ("DRIVER=usb", False),
    ],
)
def test_which_files_are_3d_mice(reported: str, ours: bool, tmp_path: Path) -> None:
    (tmp_path / "device").mkdir()
    (tmp_path / "device" / "uevent").write_text(reported)
    assert _is_ours(tmp_path) is ours


def test_one_that_goes_away_is_silent_until_it_is_back(pipe: Pipe, clock: list[float]) -> None:
    """What it said before, half an event too, counts no longer."""
    pad = Gamepad(1, path=pipe.path)
    pipe.write(js(1, 0x01, 0) + js(32767, 0x02, 0) + js(32767, 0x02, 0)[:3])
    pad.read()
    assert (pad.buttons(), pad.deflections[0]) == ((True,), 1.0)
    pad.close()
    os.rename(pipe.path, pipe.path + ".gone")
    with pytest.raises(DeviceSilent, match="was disconnected"):
        pad.read()
    os.rename(pipe.path + ".gone", pipe.path)
    with pytest.raises(DeviceSilent):
        pad.read()  # it looks again twice a second
    clock[0] += 1.0
    assert pad.read()[0] == (0.0,)
    assert (pad.buttons(), pad.deflections[0]) == ((), 0.0)
    pipe.write(js(-32767, 0x02, 0))
    pad.read()
    assert pad.deflections[0] == -1.0
    pad.close()


def test_one_that_was_pulled_out_is_opened_anew(
    pipe: Pipe, clock: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the kernel says of a device that is gone, it says of that file for ever."""
    pad, read, pulled_out = Gamepad(1, path=pipe.path), os.read, [True]
    opened = os.open

    def gone(file: int, size: int) -> bytes:
        if pulled_out[0]:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        return read(file, size)

    def back(path: str, flags: int) -> int:
        pulled_out[0] = False
        return opened(path, flags)

    monkeypatch.setattr("hapnet.ext.devices.input_device.os.read", gone)
    monkeypatch.setattr("hapnet.ext.devices.input_device.os.open", back)
    with pytest.raises(DeviceSilent, match="No such device"):
        pad.read()
    clock[0] += 1.0
    assert pad.read()[0] == (0.0,)
    pad.close()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("path=/dev/nil", "No such file"), ("path=/dev/null,reach=1.001", "reach is 1.001"), ("reach=0.0009", "reach"),
        ("dead=1", "dead"), ("dead=-0.001", "dead"), ("rate=-1", "rate is -1.0; allowed: 0 to 100 1/s"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(words: str, says: str) -> None:
    for name, kind in (("gamepad", Gamepad), ("3dmouse", SpaceMouse)):
        assert resolve(f"{name}:{words}")[1] == words
        with pytest.raises(InvalidParameter, match=says):
            kind(1, **options(name, kind, words))


@pytest.mark.parametrize("words", ["reach=0.001", "reach=1", "dead=0"])
def test_the_ends_of_what_can_be(words: str) -> None:
    for name, kind in (("gamepad", Gamepad), ("3dmouse", SpaceMouse)):
        kind(1, path=os.devnull, **options(name, kind, words)).close()


def test_which_device_is_taken_without_a_path(pipe: Pipe, clock: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    """The first that there is; of the HID devices those that are 3D mice and can be read."""
    monkeypatch.setattr(Gamepad, "found", staticmethod(lambda: (pipe.path, "/dev/nil")))
    pad = Gamepad(1)
    pipe.write(js(32767, 0x02, 0))
    assert settled(pad, clock) == pytest.approx((0.04,))
    pad.close()
    monkeypatch.setattr(Gamepad, "found", staticmethod(lambda: ()))
    with pytest.raises(InvalidParameter, match="none was found"):
        Gamepad(1)
    monkeypatch.setattr("hapnet.ext.devices.space_mouse.Path.glob", lambda folder, names: [folder / "b", folder / "a"])
    monkeypatch.setattr("hapnet.ext.devices.space_mouse._is_ours", lambda path: str(path) == "/sys/class/hidraw/a")
    monkeypatch.setattr("hapnet.ext.devices.space_mouse.existing", tuple)
    assert SpaceMouse.found() == ("/dev/a",)
