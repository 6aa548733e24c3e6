"""The Inverse3's driver against its emulator, over sockets."""

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from hapnet.ext.devices import inverse3, inverse3_messages as wire, websocket
from hapnet.ext.devices.emulator import EmulatedHandle
from hapnet.ext.devices.inverse3 import Inverse3
from hapnet.ext.devices.inverse3_emulator import DEVICE, Inverse3Emulator
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Impedance, Rest

MS = 1_000_000


def read(driver: Inverse3, times: int) -> None:
    for _ in range(times):
        driver.read()


def hear(caller: websocket.Caller) -> None:
    for _ in range(1000):
        caller.receive(0.01)


class Steered:
    """An emulator on sockets in a thread; its clock is the test's."""

    def __init__(self, port: int = 0, events: int = 0, **options: Any) -> None:
        self.now_ns = 0
        device = SimulatedDevice(Rest(3, Impedance(0.1, 1.0, 100.0), (0.0, 0.0, 0.0)))
        self.emulator = Inverse3Emulator(EmulatedHandle(device), lambda: self.now_ns, port, events, **options)
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.emulator.run, args=(self.stop,), daemon=True)
        self.thread.start()

    def driver(self, **options: Any) -> Inverse3:
        return Inverse3(3, address=f"127.0.0.1:{self.emulator.port}", events=self.emulator.events, **options)

    def end(self) -> None:
        self.stop.set()
        self.thread.join(10.0)
        assert not self.thread.is_alive()


@contextlib.contextmanager
def steered(**options: Any) -> Iterator[Steered]:
    made = Steered(**options)
    try:
        yield made
    finally:
        made.end()


def patiently(act: Callable[[], Any], holds: Callable[[], bool]) -> None:
    """Act until it holds, for a bounded time; other processes may keep the emulator's thread waiting meanwhile."""
    until_s = time.monotonic() + 20.0
    while not holds():
        assert time.monotonic() < until_s
        with contextlib.suppress(DeviceSilent):
            act()


@pytest.mark.parametrize(
    ("understands", "spelling", "force"),
    [("both", "auto", 1.5), ("values", "auto", 1.5), ("vector", "auto", 1.5), ("values", "vector", 0.0)],
)
def test_the_force_reaches_the_emulated_arm_and_ends_by_itself(understands: str, spelling: str, force: float) -> None:
    with steered(spelling=understands) as rig, contextlib.closing(rig.driver(spelling=spelling)) as driver:
        handle = rig.emulator.handle
        answered = handle.commands
        patiently(driver.read, lambda: driver.acted() is not None)
        driver.apply((0.0, 0.0, 1.5))
        patiently(driver.read, lambda: handle.force == (0.0, 0.0, force))
        assert rig.emulator.greetings == 1
        assert driver.orientation() == (1.0, 0.0, 0.0, 0.0)
        assert driver.buttons() == (False, False, False)
        if force:
            assert handle.commands > answered
            rig.now_ns += 9 * MS
            handle.read(rig.now_ns)
            assert handle.force == (0.0, 0.0, 1.5)
            rig.now_ns += 3 * MS
            handle.read(rig.now_ns)
            assert handle.force == (0.0, 0.0, 0.0)
            assert handle.released == 1


@pytest.mark.parametrize(("faults", "says"), [
    ({"ignores": True}, "it has it at defaults"), ({"spelling": "values"}, "it reports no preset; a service before"),
])  # fmt: skip
def test_a_service_with_another_frame_is_refused(faults: dict[str, Any], says: str) -> None:
    with steered(**faults) as rig, contextlib.closing(rig.driver()) as driver, pytest.raises(HapnetError, match=says):
        driver.home()


def test_a_sleeping_grip_has_no_pressed_button() -> None:
    with steered(button=True, asleep=True) as rig, contextlib.closing(rig.driver()) as driver:
        assert driver.buttons() == (False, False, False)
        assert driver.orientation() is None
    with steered(button=True) as rig, contextlib.closing(rig.driver()) as driver:
        assert driver.buttons() == (True, False, False)


def test_the_driver_finds_its_emulator_again_and_sees_its_brake() -> None:
    with steered() as rig:
        port, events = rig.emulator.port, rig.emulator.events
        with contextlib.closing(rig.driver()) as driver:
            rig.emulator.announce("ebrake_triggered")
            patiently(driver.read, lambda: driver.braked() == "its emergency brake is on")
            rig.emulator.announce("ebrake_released")
            patiently(driver.read, lambda: driver.braked() == "")
            rig.end()
            with pytest.raises(DeviceSilent):
                read(driver, times=100)
            with steered(port=port, events=events) as again:
                came: list[Any] = []
                patiently(lambda: came.append(driver.read()), lambda: bool(came) and not driver.braked())
                assert again.emulator.greetings == 1


def test_a_message_is_handled_after_the_emulators_latency() -> None:
    with steered(latency=0.002) as rig:
        handle = rig.emulator.handle
        commands: list[int] = []
        with socket.create_connection(("127.0.0.1", rig.emulator.port)):  # somebody who says nothing disturbs nobody
            caller = websocket.Caller("127.0.0.1", rig.emulator.port)
            with contextlib.closing(caller):
                patiently(lambda: commands.append(len(caller.receive(0.01))), lambda: sum(commands) == 1)  # inventory
                caller.send(wire.command(DEVICE, (0.0, 0.0, 1.0)))
                assert caller.receive(0.05) == []
                assert handle.commands == 0
                rig.now_ns += 2 * MS
                patiently(lambda: commands.append(len(caller.receive(0.01))), lambda: sum(commands) == 2)
                assert handle.force == (0.0, 0.0, 1.0)


def test_states_that_are_all_rubbish_are_no_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inverse3, "_START_S", 0.1)
    with steered(rubbish=1.0) as rig, pytest.raises(HapnetError, match="no Inverse Service: a message from"):
        rig.driver()


def test_it_ends_when_it_is_killed() -> None:
    with steered(killed=1.0) as rig:
        rig.now_ns = 1000 * MS
        rig.thread.join(20.0)
        assert not rig.thread.is_alive()


def test_what_is_no_websocket_is_no_device() -> None:
    """A server that says something else, and one that says nothing at all."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        caller = websocket.Caller("127.0.0.1", port)
        assert caller.receive(0.0) == []
        connection, _ = server.accept()
        connection.sendall(b"SSH-2.0-no websocket\r\n" * 10)
        with pytest.raises(DeviceSilent, match="closed the connection"):
            hear(caller)
        connection.close()
        caller.close()


def test_of_several_addresses_the_one_that_answers_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """As `localhost` may stand for one of each family."""
    with steered() as rig, socket.create_server(("127.0.0.1", 0)) as server:
        port, closed = rig.emulator.port, server.getsockname()[1]
        server.close()
        known = [(socket.AF_INET, 1, 6, "", ("127.0.0.1", number)) for number in (closed, port)]
        monkeypatch.setattr(websocket.socket, "getaddrinfo", lambda *_, **__: known)
        with contextlib.closing(websocket.Caller("localhost", port)) as caller:
            came: list[bytes] = []
            patiently(lambda: came.extend(caller.receive(0.01)), lambda: bool(came))
            assert caller.calls == 2


def test_a_host_that_does_not_exist_is_named() -> None:
    with pytest.raises(InvalidParameter, match=r"no-such-host\.invalid:1"):
        websocket.Caller("no-such-host.invalid", 1)


@pytest.mark.parametrize(("origin", "status"), [("", b"101"), ("Origin: http://evil.example\r\n", b"403")])
def test_a_web_page_cannot_command_it(origin: str, status: bytes) -> None:
    """A browser names the page's origin in each WebSocket; a driver names none."""
    with steered() as rig, socket.create_connection(("127.0.0.1", rig.emulator.port), timeout=20.0) as browser:
        browser.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n{origin}"
            "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
        )
        assert browser.recv(100).split()[1] == status
