"""The Inverse3's driver against a service in memory."""

from __future__ import annotations

import contextlib
import json
import random
from collections import deque
from operator import mul
from typing import Any

import pytest

from hapnet.checks import Vector
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from hapnet.ext.devices import inverse3, inverse3_safety, websocket
from hapnet.ext.devices.inverse3 import PATIENCE_S, Inverse3

ELSEWHERE = 5.0
"""Positions are counted from there before the preset acts [m]."""


class Service:
    """The service and its event socket, in memory: each message that it takes is answered by the state as of then."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.position = [0.0, 0.0, 0.0]
        self.force: Vector = (0.0, 0.0, 0.0)
        self.forces: list[Vector] = []
        self.status = {"calibrated": True, "power_supply": True}
        self.arms = ["049D"]
        self.kind, self.preset, self.ignores, self.spellings = "inverse3", "defaults", False, ("vector",)
        self.deaf = False
        self.grips: list[dict[str, Any]] = []
        self.answers = self.listens = self.takes = True
        self.rubbish = 0
        self.untaken: deque[dict[str, Any]] = deque()
        self.work_J = 0.0
        """By the forces that acted, from the positions between them."""

    def call(self, host: str, port: int) -> Line:
        return Line(self, host, port)

    def move(self, *by: float) -> None:
        self.work_J += sum(map(mul, self.force, by))
        self.position = [a + b for a, b in zip(self.position, by, strict=True)]

    def state(self, origin: float = 0.0) -> bytes:
        position = dict(zip("xyz", [origin + x for x in self.position], strict=True))
        still = {"x": 0.0, "y": 0.0, "z": 0.0}
        acts = dict(zip("xyz", self.force, strict=True))
        state = {"cursor_position": position, "cursor_velocity": still, "current_cursor_force": acts}
        return json.dumps(
            {
                "session_id": 7,
                self.kind: [
                    {"device_id": name, "state": state, "status": self.status, "config": {"preset": self.preset}}
                    for name in self.arms
                ],
                "wireless_verse_grip": self.grips,
            }
        ).encode()

    def work_off(self, line: Line) -> None:
        """Take the messages that it has not taken yet."""
        while self.takes and self.untaken:
            self.rubbish -= 1
            message = self.untaken.popleft()
            arm = message[self.kind][0]
            state = self.state(ELSEWHERE if "configure" in arm else 0.0)  # the preset acts from now on
            if "configure" in arm and not self.ignores:
                self.preset = arm["configure"]["preset"]["preset"]
            line.inbox.append(state if self.rubbish < 0 else b"{")
            reported = arm["commands"]["set_cursor_force"]["vector"]
            self.force = (0.0, 0.0, 0.0) if self.deaf else (reported["x"], reported["y"], reported["z"])
            self.forces.append(self.force)


class Line:
    """What the driver has of a connection."""

    def __init__(self, service: Service, host: str, port: int) -> None:
        self.service, self.url = service, f"ws://{host}:{port}"
        self.is_events = port == 10020
        self.is_open = False
        self.calls = 0
        self.inbox: deque[bytes] = deque()

    def receive(self, seconds: float) -> list[bytes]:
        if not self.service.listens:
            self.is_open = False
            self.inbox.clear()
            self.service.untaken.clear()
            raise DeviceSilent(f"nothing answers at {self.url}")
        if not self.is_open:
            self.is_open = True
            self.calls += 1
            if not self.is_events:
                self.inbox.append(self.service.state(ELSEWHERE))
        if not self.is_events:
            self.service.work_off(self)
        found = list(self.inbox) if self.service.answers or self.is_events else []
        if found:
            self.inbox.clear()
        elif not self.is_events:
            self.service.now_s += seconds
        return found

    def send(self, message: bytes) -> None:
        assert not self.is_events
        if not self.service.listens:
            raise DeviceSilent(f"the service at {self.url} closed the connection")
        self.service.untaken.append(json.loads(message))
        self.service.work_off(self)

    def close(self) -> None:
        self.is_open = False


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> Service:
    made = Service()

    class Time:
        @staticmethod
        def monotonic() -> float:
            return made.now_s

        @staticmethod
        def sleep(seconds: float) -> None:
            made.now_s += seconds

    monkeypatch.setattr(inverse3, "time", Time)
    monkeypatch.setattr(inverse3_safety, "time", Time)
    monkeypatch.setattr(websocket, "Caller", made.call)
    monkeypatch.setattr(inverse3_safety, "Caller", made.call)
    return made


def tick(service: Service, driver: Inverse3, force: Vector, *moved: float) -> tuple[Vector, Vector | None]:
    """The handle moves, a period later the servo reads and sends a force; what it read, and which force acted."""
    service.move(*moved or (0.0, 0.0, 0.0))
    service.now_s += 0.001
    position, _ = driver.read()
    acted = driver.acted()
    driver.apply(force)
    return position, acted


def begun() -> Inverse3:
    """A driver that was read, and renders 1 N."""
    driver = Inverse3(1)
    driver.read()
    driver.apply((1.0,))
    return driver


def test_the_account_counts_what_acted_between_the_readings(service: Service) -> None:
    """Random forces and motions: the work of what `acted` says is the true one, up to the reading in flight."""
    driver = Inverse3(3)
    chance = random.Random(1)
    last, counted, true = driver.read()[0], 0.0, [service.work_J]
    driver.apply((0.0, 0.0, 0.0))
    for _ in range(200):
        true.append(service.work_J)
        position, acted = tick(
            service, driver, tuple(chance.gauss(0.0, 2.0) for _ in range(3)), *(chance.gauss(0.0, 1e-3) for _ in "xyz")
        )
        assert acted is not None
        counted += sum(f * (b - a) for f, a, b in zip(acted, last, position, strict=True))
        last = position
    assert counted == pytest.approx(true[-1], rel=1e-9)
    assert abs(true[-1]) > 1e-3  # not because nothing happened
    assert counted != pytest.approx(service.work_J, rel=1e-6)  # the last motion was not read yet


def test_a_tick_sends_one_message_and_waits_for_none(service: Service) -> None:
    driver = Inverse3(1, axes="z")
    driver.read()
    driver.apply((1.0,))
    before, started_s = len(service.forces), service.now_s
    for _ in range(10):
        tick(service, driver, (1.0,))
    assert len(service.forces) == before + 10
    assert service.now_s == pytest.approx(started_s + 0.01)
    assert service.forces[-1] == (0.0, 0.0, 1.0)


def test_axes_are_chosen_and_turned_round(service: Service) -> None:
    driver = Inverse3(2, axes="z-x")
    driver.read()
    driver.apply((0.0, 0.0))
    service.move(0.01, 0.02, 0.03)
    tick(service, driver, (1.5, 2.5))
    assert service.force == (-2.5, 0.0, 1.5)
    assert tick(service, driver, (0.0, 0.0)) == ((0.03, -0.01), (0.0, 0.0))
    assert tick(service, driver, (0.0, 0.0))[1] == (1.5, 2.5)


def test_a_bad_state_is_missed_and_asked_for_again_with_the_same_force(service: Service) -> None:
    driver = begun()
    service.rubbish = 1
    tick(service, driver, (2.0,))
    service.move(0.001, 0.0, 0.0)
    with pytest.raises(DeviceSilent, match="no state of the arm 049D"):
        driver.read()
    sent = len(service.forces)
    assert driver.read() == ((0.001,), (0.0,))
    assert service.forces[sent:] == [(2.0, 0.0, 0.0)]
    assert driver.acted() == (2.0,)  # along the motion 2 N put more out than 1 N
    assert driver.damaged == 1


@pytest.mark.parametrize(("way", "counts"), [(1.0, 1.0), (-1.0, 0.0)])
def test_after_a_late_answer_the_force_counts_only_if_it_put_energy_out(
    service: Service, way: float, counts: float
) -> None:
    """The service may have forgotten the force meanwhile: then it took nothing in."""
    driver = begun()
    tick(service, driver, (1.0,))
    tick(service, driver, (1.0,))
    service.takes = False
    driver.apply((1.0,))  # queues up behind nothing: the answer to the one before is there
    driver.read()
    for _ in range(3):
        with pytest.raises(DeviceSilent, match="no state from ws://localhost:10001 for 5 ms"):
            driver.read()
    service.move(way * 0.002, 0.0, 0.0)
    service.takes = True
    driver.read()
    assert driver.acted() == (counts,)


def test_a_stalled_service_is_silent_within_its_patience_and_hears_no_force_once(service: Service) -> None:
    driver = begun()
    tick(service, driver, (1.0,))
    service.takes = False
    for _ in range(100):
        before_s = service.now_s
        with contextlib.suppress(DeviceSilent):
            driver.read()
        assert service.now_s <= before_s + PATIENCE_S + 1e-9
        with contextlib.suppress(DeviceSilent):
            driver.apply((0.0,))
    assert len(service.untaken) <= 2
    service.takes = True
    driver.read()
    assert driver.acted() is None  # for half a second nobody knows what acted
    assert service.force == (0.0, 0.0, 0.0)


def test_a_restarted_service_is_greeted_again(service: Service) -> None:
    driver = begun()
    tick(service, driver, (1.0,))
    service.listens = False
    for _ in range(5):
        with pytest.raises(DeviceSilent, match="nothing answers at ws://localhost:10001"):
            driver.read()
        with pytest.raises(DeviceSilent):
            driver.apply((0.0,))
    assert driver.braked() == "the event socket, which reports its brake, is not connected"
    service.listens = True
    sent = len(service.forces)
    service.position = [0.02, 0.0, 0.0]
    assert driver.read() == ((0.02,), (0.0,))
    assert driver.braked() == ""
    assert set(service.forces[sent:]) == {(0.0, 0.0, 0.0)}
    driver.apply((1.0,))
    assert service.force == (1.0, 0.0, 0.0)


def test_a_force_that_was_under_way_when_the_session_was_lost_may_have_acted(service: Service) -> None:
    driver = begun()
    driver.read()
    service.takes = False
    driver.apply((3.0,))
    service.listens = False
    with pytest.raises(DeviceSilent):
        driver.read()
    service.takes = service.listens = True
    service.move(0.001, 0.0, 0.0)
    driver.read()
    assert driver.acted() == (3.0,)


def event(safety_type: str, device: str = "049D") -> bytes:
    data = {"device_family": "inverse", "device_id": device, "safety_type": safety_type}
    return json.dumps({"name": "device-safety-triggered", "level": "warning", "data": data}).encode()


def report(driver: Inverse3, safety_type: str, device: str = "049D", **more: str) -> None:
    line: Any = driver._safety.caller
    line.inbox.append(json.dumps(json.loads(event(safety_type, device)) | more).encode())


def test_there_is_no_force_while_the_brake_is_on(service: Service) -> None:
    driver = begun()
    tick(service, driver, (1.0,))
    report(driver, "ebrake_triggered", "06DA")  # of another arm
    tick(service, driver, (1.0,), 0.001, 0.0, 0.0)
    assert driver.braked() == ""
    report(driver, "ebrake_triggered")
    tick(service, driver, (1.0,), -0.001, 0.0, 0.0)
    assert driver.braked() == "its emergency brake is on"
    assert service.force == (0.0, 0.0, 0.0)
    _, acted = tick(service, driver, (1.0,))
    assert acted == (0.0,)  # it may have ended before it took this motion's energy in
    report(driver, "ebrake_released")
    tick(service, driver, (1.0,))
    assert service.force == (1.0, 0.0, 0.0)


def test_a_stalled_motor_gets_no_force_for_a_second(service: Service) -> None:
    driver = begun()
    report(driver, "stall_detected")
    tick(service, driver, (1.0,))
    assert (driver.braked(), service.force) == ("a motor has stalled", (0.0, 0.0, 0.0))
    service.now_s += 1.0
    assert driver.braked() == ""


@pytest.mark.parametrize(("flag", "why"), [("calibrated", "it is not calibrated"), ("power_supply", "it has no power")])
def test_without_power_or_calibration_there_is_no_force(service: Service, flag: str, why: str) -> None:
    driver = Inverse3(1)
    driver.home()
    driver.read()
    driver.apply((1.0,))
    service.status[flag] = False
    tick(service, driver, (1.0,))
    tick(service, driver, (1.0,))
    assert (driver.braked(), service.force) == (why, (0.0, 0.0, 0.0))
    with pytest.raises(HapnetError, match=r"049D (has no power|is not calibrated)"):
        driver.home()


def test_of_several_arms_one_must_be_named(service: Service) -> None:
    service.arms = ["049D", "06DA"]
    with pytest.raises(InvalidParameter, match="one of the service's arms: 049D, 06DA"):
        Inverse3(1)
    driver = Inverse3(1, device="06DA")
    driver.apply((0.0,))
    service.arms = ["049D"]
    with pytest.raises(DeviceSilent, match="no state of the arm 06DA"):
        read(driver, times=3)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"address": "10001"}, "a host and a port"),
        ({"address": "localhost:port"}, "a host and a port"),
        ({"preset": "custom"}, "arm_front_centered"),
        ({"spelling": "force"}, "vector, values"),
        ({"axes": "yz"}, "1 of xyz"),
        ({"events": 65536}, "a port, or 0"),
    ],
)
def test_options_are_checked(service: Service, options: dict[str, Any], says: str) -> None:
    with pytest.raises(InvalidParameter, match=says):
        Inverse3(1, **options)


def test_no_service_is_said_in_one_line(service: Service) -> None:
    service.listens = False
    with pytest.raises(HapnetError, match="no Inverse Service: nothing answers at ws://localhost:10001"):
        Inverse3(1)


@pytest.mark.parametrize("silent", ["answers", "listens"])
def test_arms_are_found_within_a_fifth_of_a_second(service: Service, silent: str) -> None:
    service.arms = ["049D", "06DA"]
    assert (Inverse3.found(), service.now_s) == (("device=049D", "device=06DA"), 100.0)
    setattr(service, silent, False)
    assert Inverse3.found() == ()
    assert service.now_s == pytest.approx(100.2, abs=0.011)


@pytest.mark.parametrize("silent", ["answers", "listens"])
def test_a_session_is_waited_for_for_two_seconds(service: Service, silent: str) -> None:
    setattr(service, silent, False)
    with pytest.raises(HapnetError):
        Inverse3(1)
    assert service.now_s == pytest.approx(102.0, abs=0.011)


def read(driver: Inverse3, times: int) -> None:
    for _ in range(times):
        driver.read()
