"""The packets of servo buses, beside the makers' pages and the makers' SDKs."""

import random
from typing import Any

import pytest

from hapnet.ext.robots.bus_packets import PING, READ, WRITE, BusPacket, Dynamixel2, FeetechPackets, Packets, Reply
from hapnet.ext.robots.dynamixel import MODELS

MANUAL = (  # examples of the e-manual, docs/en/dxl/protocol2
    (Dynamixel2().packet(1, PING), "FF FF FD 00 01 03 00 01 19 4E"),
    (Dynamixel2().packet(0xFE, PING), "FF FF FD 00 FE 03 00 01 31 42"),
    (Dynamixel2().status(1, Reply(0, b"\x06\x04\x26")), "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"),
    (Dynamixel2().read(1, 132, 4), "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
    (Dynamixel2().status(1, Reply(0, b"\xa6\0\0\0")), "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"),
    (Dynamixel2().write(1, 116, b"\0\x02\0\0"), "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"),
)


@pytest.mark.parametrize(("made", "shown"), MANUAL)
def test_packets_are_those_of_the_manual(made: bytes, shown: str) -> None:
    assert made == bytes.fromhex(shown)


class Port:
    """What a maker's packet handler writes to."""

    is_using = False
    written = b""

    def clearPort(self) -> None:
        pass

    def writePort(self, data: list[int]) -> int:
        self.written = bytes(data)
        return len(data)


def test_packets_are_those_of_the_makers() -> None:
    """Any data, with the header's bytes among them: those that Dynamixel stuffs."""
    dynamixel, feetech = pytest.importorskip("dynamixel_sdk"), pytest.importorskip("scservo_sdk")
    rng, port = random.Random(1), Port()
    for _ in range(200):
        data = bytes(rng.choices((0xFF, 0xFD, 0x00, 0x55), k=rng.randrange(20)))
        servo = rng.randrange(253)
        theirs: Any = [0] * 4 + [servo, len(data) + 3, 0, WRITE, *data, 0, 0]
        handler = dynamixel.Protocol2PacketHandler()
        theirs = handler.addStuffing(theirs)
        handler.addStuffing = lambda packet: packet  # it was, just now; 4.1.0 itself drops what it returns
        port.is_using = False
        handler.txPacket(port, theirs)
        assert Dynamixel2().packet(servo, WRITE, data) == port.written
        theirs = [0, 0, servo, len(data) + 2, READ, *data, 0]
        port.is_using = False
        feetech.protocol_packet_handler().txPacket(port, theirs)
        assert FeetechPackets().packet(servo, READ, data) == port.written


@pytest.mark.parametrize("kind", [Dynamixel2, FeetechPackets])
def test_whole_packets_are_found_among_damaged_ones(kind: type[Packets]) -> None:
    """In parts of any length, with rubbish between: those that were not touched, in their order."""
    rng, frames = random.Random(2), kind()
    sent, stream = [], b""
    for k in range(300):
        packet = BusPacket(k % 250, 3, rng.randbytes(6))
        data = frames.packet(*packet)
        at = rng.randrange(4, len(data) - 1)
        if k % 3 == 1:
            data = data[:at] + bytes((data[at] ^ 4,)) + data[at + 1 :]
        elif k % 3 == 2:
            data = data[:at] + data[at + 1 :] + rng.randbytes(rng.randrange(3))
        else:
            sent.append(packet)
        stream += data + bytes(24)  # a pause, in which the receiver gives a packet up
    found = []
    while stream:
        size = rng.randrange(1, 40)
        found += frames.feed(stream[:size])
        stream = stream[size:]
    assert [packet for packet in found if packet in sent] == sent
    if kind is Dynamixel2:  # a CRC of 16 bits; a sum of 8 lets one in 256 pass
        assert found == sent
    assert frames.damaged > 1000


def test_a_damaged_length_does_not_swallow_what_follows() -> None:
    frames = Dynamixel2()
    good = frames.packet(1, PING)
    broken = bytearray(good)
    broken[6] = 0x80
    assert frames.feed(bytes(broken) + good) == [BusPacket(1, PING, b"")]


PRINTED = {
    "XH430-V350": (1040, 4.714, 1.34), "XH430-V210": (1050, 3.714, 1.34), "XM540-W270": (1120, 2.409, 2.69),
    "XM540-W150": (1130, 1.659, 2.69), "XH540-V270": (1140, 3.833, 2.69), "XH540-V150": (1150, 2.667, 2.69),
    "XW540-T260": (1170, 1.939, 2.69), "XW540-T140": (1180, 1.408, 2.69),
}  # fmt: skip
"""Model number, torque per current [Nm/A] and unit of the current [mA], as the pages of the e-manual print them."""


@pytest.mark.parametrize("name", PRINTED)
def test_models_are_those_of_the_manual(name: str) -> None:
    number, torque, unit = PRINTED[name]
    assert MODELS[number].name == name
    assert MODELS[number].torque == pytest.approx(torque, abs=5e-4)
    assert MODELS[number].unit_A == pytest.approx(1e-3 * unit)


def test_models_without_current_control_give_no_torque() -> None:
    """Of the X series these are the XL430 and XC430, and the two servos in one case."""
    assert {model.name for model in MODELS.values() if not model.torque} == {
        "XL430-W250", "XC430-W150", "XC430-W240", "2XL430-W250", "2XC430-W250",
    }  # fmt: skip
    assert len({model.name for model in MODELS.values()}) == len(MODELS)
