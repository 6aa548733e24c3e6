"""The serial axis's frames, whatever happens to them on the way, and what the times of states say."""

import pytest
from hypothesis import given, strategies as st

from hapnet.ext.devices import serial_frames as wire
from hapnet.ext.devices.serial_axis import _elapsed_us
from hapnet.ext.devices.serial_frames import Untimely, period_us

ABOUT = wire.About(2, 1000, 0, 20, 3_000_000, 1_500_000, 1000, 1000, 80_000, 2, 1)
NUMBERS = st.integers(0, 2**16 - 1)
STATES = st.builds(
    wire.BoardState, st.integers(0, 255), NUMBERS, st.integers(0, 2**32 - 1), st.integers(-(2**31), 2**31 - 1), NUMBERS,
    st.integers(0, 2**32 - 1),
)  # fmt: skip


def test_the_frames_of_the_page() -> None:
    """Byte for byte as serial_axis.md lays them out; the CRC of the digits 1 to 9 as its catalogues give it, 29B1."""
    state = wire.BoardState(0x31, 77, 123_000, 20_513_000, 250, 4021)
    assert wire.state(state)[:-2].hex() == "53314d0078e00100e8003901fa00b50f0000"
    assert wire.state(state)[-2:] == crc16(wire.state(state)[:-2]).to_bytes(2, "big")
    assert wire.command(wire.BoardCommand(b"F", 77, -1000))[:-2].hex() == "464d0018fc"
    assert crc16(b"123456789") == 0x29B1
    assert (len(wire.state(state)), len(wire.about(ABOUT)), wire.COMMAND_SIZE) == (20, 32, 7)


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE bit by bit, as its definition says: polynomial 0x1021, start 0xFFFF."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def test_the_flags() -> None:
    state = wire.BoardState(0b0101_0010, 0, 0, 0, 0, 0)
    assert (state.buttons, state.homed, state.counted) == (2, True, -1)
    assert wire.BoardState(wire.flags(2, homed=True, counted=-1), 0, 0, 0, 0, 0) == state


@given(st.lists(STATES, max_size=5), st.data())
@pytest.mark.long
def test_frames_read_back_however_they_are_cut(states: list[wire.BoardState], data: st.DataObject) -> None:
    stream = wire.about(ABOUT) + b"".join(map(wire.state, states))
    frames, found = wire.FrameParser(), []
    while stream:
        cut = data.draw(st.integers(1, len(stream)))
        found += frames.feed(stream[:cut])
        stream = stream[cut:]
    assert found == [ABOUT, *states]
    assert frames.damaged == 0


@given(STATES, st.data())
@pytest.mark.long
def test_a_damaged_frame_is_dropped_and_the_next_is_found(state: wire.BoardState, data: st.DataObject) -> None:
    """Any one byte lost or changed is damage that this checksum always finds."""
    whole = wire.state(state)
    at = data.draw(st.integers(0, len(whole) - 1))
    other = data.draw(st.integers(0, 255).filter(lambda byte: byte != whole[at]))
    for spoiled in (whole[:at] + bytes([other]) + whole[at + 1 :], whole[:at] + whole[at + 1 :]):
        after = [wire.state(state._replace(command=k)) for k in range(4)]  # a letter before them may look like a frame
        found = wire.FrameParser().feed(spoiled + b"".join(after))
        assert found[-3:] == [state._replace(command=k) for k in (1, 2, 3)]
        assert len(found) <= 4 or spoiled == whole


@given(st.binary(max_size=300))
def test_rubbish_is_no_frame_and_nothing_raises(raw: bytes) -> None:
    """A frame among random bytes has a chance of 1 in 65,536 at each letter: here a frame is one with the right CRC."""
    for found in wire.FrameParser().feed(raw):
        assert isinstance(found, wire.BoardState | wire.About)
    wire.commands(raw)


@given(st.lists(st.tuples(NUMBERS, st.integers(-wire.FULL, wire.FULL)), max_size=4), st.binary(max_size=6))
@pytest.mark.long
def test_commands_read_back_after_rubbish(sent: list[tuple[int, int]], before: bytes) -> None:
    commands = [wire.BoardCommand(b"F", number, force) for number, force in sent]
    found, left = wire.commands(before + b"".join(map(wire.command, commands)))
    assert found == commands
    assert len(left) < wire.COMMAND_SIZE


@given(st.integers(0, 2**32 - 1), st.integers(-(2**31), 2**31 - 1))
def test_what_wraps_has_the_right_difference(start: int, change: int) -> None:
    assert wire.signed((start + change) % wire.WRAP - start) == change


# Timing


def arrivals(period: int, together: int, clock: float = 1.0, count: int = 60) -> list[tuple[float, list[int]]]:
    """States each `period` [us] that arrive so many together; the board's clock wraps in the middle."""
    states = [(wire.WRAP - 10_000 + round(k * period * clock)) % wire.WRAP for k in range(count)]
    return [((k + together) * period * 1e-6, states[k : k + together]) for k in range(0, count, together)]


@pytest.mark.parametrize(("period", "together"), [(1000, 1), (2000, 1), (1000, 2), (2000, 2)])
def test_the_period_is_what_the_board_made(period: int, together: int) -> None:
    assert period_us(arrivals(period, together)) == period


def test_one_late_arrival_is_no_burst() -> None:
    found = arrivals(1000, 1)
    together = [time_us for _, times in found[10:30] for time_us in times]
    assert period_us([*found[:10], (found[29][0], together), *found[30:]]) == 1000


@pytest.mark.parametrize(("period", "together"), [(1000, 3), (1000, 16), (2000, 3), (2000, 8)])
def test_bursts_are_named(period: int, together: int) -> None:
    apart = f"one each {period * 1e-3:g} ms, but arrive {period * together * 1e-3:g} ms apart"
    with pytest.raises(Untimely, match=apart) as found:
        period_us(arrivals(period, together))
    assert found.value.bursts


@pytest.mark.parametrize(("clock", "says"), [(64.0, "64 times as fast"), (0.5, "0.5 times as fast")])
def test_a_clock_that_is_wrong_is_named(clock: float, says: str) -> None:
    """A PWM at 62.5 kHz on timer 0 makes Arduino's micros() 64 times too fast."""
    with pytest.raises(Untimely, match=says):
        period_us(arrivals(1000, 1, clock))


def test_too_few_states() -> None:
    for count in (0, 1, 7):
        with pytest.raises(Untimely, match=f"only {count} states"):
            period_us(arrivals(1000, 1, count=count))


def test_states_that_get_lost_leave_the_period() -> None:
    """Each second one: the rest still shows how fast the board is, as some come one after the other."""
    kept = [one for k, one in enumerate(arrivals(1000, 1, count=200)) if k % 5 not in (1, 3)]
    assert period_us(kept) == 1000


@pytest.mark.parametrize(
    ("before_us", "time_us", "elapsed_us"),
    [
        (None, 7, None),
        (7, 7, None),
        (7, 8, 1),
        (2**32 - 3, 2, 5),
        (0, 500_000, 500_000),
        (0, 500_001, None),
        (8, 7, None),
    ],
)
def test_the_boards_time_between_states(before_us: int | None, time_us: int, elapsed_us: int | None) -> None:
    """Modulo 2^32 us. In more than 0.5 s the impulse may have wrapped."""
    state = wire.BoardState(0, 0, time_us, 0, 0, 0)
    assert _elapsed_us(None if before_us is None else state._replace(time_us=before_us), state) == elapsed_us
