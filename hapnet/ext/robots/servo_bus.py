"""A servo bus on a serial port: reads several servos at once, within a time limit.

It does not use the makers' SDKs. Both wait in a busy loop for 34 ms and more for a servo that does not answer, which is
longer than a haptic servo may stall, and drop the answers of all later servos: servo_bus.md has the measurements.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

from hapnet.errors import HapnetError
from hapnet.ext.devices.serial_port import SerialPort
from hapnet.ext.robots.bus_packets import REBOOT, Packets, Reply

BITS_A_BYTE = 10
_LATENCY_S = 1e-3
"""The latency of USB, kernel and servo, added to the bytes' own time [s]."""

_TRIES, _ANSWER_S = 25, 0.02


def transfer_s(count: int, baud: int) -> float:
    """The time that so many bytes take on the wire [s]."""
    return count * BITS_A_BYTE / baud


class ServoBus:
    """The servos at the port `path`. packets : their protocol. baud : bits a second.

    Attributes
    ----------
    asked, answered : the number of answers due so far, and of answers received complete.

    Raises InvalidParameter: the port cannot be opened. HapnetError: its adapter delays bytes.
    """

    def __init__(self, path: str, baud: int, packets: Packets) -> None:
        self.port = SerialPort(path, baud)
        self.baud, self.packets = baud, packets
        self.asked = self.answered = 0

    def sync_read(self, address: int, size: int, servos: Sequence[int], budget_s: float) -> dict[int, Reply]:
        """The servos' answers; the request to servos without an answer is repeated within the budget [s].

        Raises DeviceSilent: the port is closed.
        """
        until = time.monotonic() + budget_s
        while self.port.read(1e-6):  # drop late answers to an earlier request
            pass
        self.packets.forget()
        found: dict[int, Reply] = {}
        missing, again = list(servos), False
        while missing:
            request = self.packets.sync_read(address, size, missing)
            due_s = transfer_s(len(request) + len(missing) * (self.packets.status_bytes + size), self.baud)
            left = until - time.monotonic()
            if again and due_s > left:
                break
            again = True
            self.asked += len(missing)
            self.port.write(request)
            found |= self._answers(missing, size, min(left, due_s + _LATENCY_S))
            missing = [servo for servo in servos if servo not in found]
        self.answered += len(found)
        return found

    def sync_write(self, address: int, values: Mapping[int, bytes]) -> None:
        """Write to several servos, which do not answer. Raises DeviceSilent."""
        self.port.write(self.packets.sync_write(address, values))

    def glance(self, servo: int, address: int, size: int, budget_s: float) -> Reply | None:
        """A few bytes of one servo's table, requested once; None: no answer in time. Raises DeviceSilent."""
        self.port.write(self.packets.read(servo, address, size))
        return self._answers((servo,), size, budget_s).get(servo)

    def read(self, servo: int, address: int, size: int) -> bytes:
        """A few bytes of one servo's table, requested repeatedly; for the start, before control runs.

        Raises HapnetError: no answer.
        """
        return self._ask(servo, self.packets.read(servo, address, size), size)

    def write(self, servo: int, address: int, data: bytes) -> None:
        """Write into a servo's table. Raises HapnetError: it does not answer, or refuses."""
        self._ask(servo, self.packets.write(servo, address, data), 0)

    def reboot(self, servo: int) -> None:
        """Restart a servo, which ends a shutdown. Raises HapnetError: it does not answer."""
        self._ask(servo, self.packets.packet(servo, REBOOT), 0)

    def _ask(self, servo: int, packet: bytes, size: int) -> bytes:
        for _ in range(_TRIES):
            self.port.write(packet)
            reply = self._answers((servo,), size, _ANSWER_S).get(servo)
            if reply is not None and not reply.error & 0x7F:
                return reply.data
            if reply is not None:
                raise HapnetError(f"servo {servo} at {self.port.path} refuses a packet: error {reply.error:#04x}")
        raise HapnetError(f"no answer of servo {servo} at {self.port.path}: check its power and baud ({self.baud})")

    def _answers(self, servos: Sequence[int], size: int, seconds: float) -> dict[int, Reply]:
        """Collect answers until that of the last servo, as they come in order, or until the time is over."""
        until = time.monotonic() + seconds
        found: dict[int, Reply] = {}
        while servos[-1] not in found and (left := until - time.monotonic()) > 0.0:
            for packet in self.packets.feed(self.port.read(left)):
                reply = self.packets.reply(packet)
                if reply is not None and packet.servo in servos and len(reply.data) == size:
                    found[packet.servo] = reply
        return found
