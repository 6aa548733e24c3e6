import asyncio
import json
import os
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from hapnet import cli
from hapnet.errors import InvalidParameter, TransportError
from hapnet.ext.doctor import machine
from hapnet.ext.doctor.machine import MISSING, OK, SKIPPED, WARNING, Check
from hapnet.transport.config import ZenohSettings, free_address
from hapnet.transport.security import Security
from hapnet.transport.zenoh import ZenohTransport

Capture = pytest.CaptureFixture[str]


def test_every_check_has_a_state_a_value_and_advice_where_something_is_wrong() -> None:
    found = list(machine.examine())
    names = [check.name for check in found]
    assert len(set(names)) == len(names)
    assert set(names) >= {
        "clock resolution", "timerfd", "SCHED_FIFO", "locked memory", "frequency scaling", "zenoh reachable",
    }  # fmt: skip
    for check in found:
        assert check.state in (OK, WARNING, MISSING, SKIPPED)
        assert check.value
        assert check.advice or check.state in (OK, SKIPPED)
        assert "\n" not in check.value + check.advice
    assert found[-1].state == SKIPPED


def test_asking_changes_nothing() -> None:
    policy = os.sched_getscheduler(0)
    machine.real_time_scheduling()
    machine.locked_memory()
    assert os.sched_getscheduler(0) == policy
    status = Path("/proc/self/status").read_text("utf-8")
    assert "VmLck:\t       0 kB" in status


def test_refused_scheduling_says_how_to_allow_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    check = machine.real_time_scheduling()
    assert check.state == WARNING
    assert "Operation not permitted" in check.value
    for words in ("rtprio 80", "/etc/security/limits.conf", "ulimit -r"):
        assert words in check.advice


@pytest.mark.parametrize(
    ("limit", "capabilities", "state"),
    [
        ("8388608", "00000000a80425fb", WARNING),
        ("1099511627776", "0000000000000000", WARNING),  # a limit is a limit: memory to come is locked too
        ("8388608", "00000000a80465fb", OK),  # bit 14
        ("unlimited", "0000000000000000", OK),
    ],
)
def test_locked_memory_needs_no_limit_or_the_capability(
    limit: str, capabilities: str, state: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Obliging:
        """A C library that locks whatever it is asked to."""

        def __init__(self, *args: object, **kwargs: object) -> None:
            pass

        def mlockall(self, flags: int) -> int:
            assert flags == 1 | 2  # MCL_CURRENT | MCL_FUTURE, as the servo asks for
            return 0

        def munlockall(self) -> int:
            return 0

    monkeypatch.setattr(machine, "_limit", lambda name: limit)
    monkeypatch.setattr(machine, "_read", lambda path: f"Name:\tpython\nCapEff:\t{capabilities}\nCapBnd:\tff\n")
    monkeypatch.setattr("ctypes.CDLL", Obliging)
    check = machine.locked_memory()
    assert check.state == state
    assert ("memlock unlimited" in check.advice) == (state == WARNING)


def test_checks_come_one_by_one_and_a_bad_endpoint_before_all() -> None:
    checks = machine.examine()
    assert next(checks).name == "python"
    with pytest.raises(InvalidParameter):
        next(machine.examine(["no endpoint"]))


@pytest.mark.parametrize(
    ("governors", "state"),
    [((), OK), (("performance", "performance"), OK), (("performance", "powersave"), WARNING)],
)
def test_governors(governors: tuple[str, ...], state: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number, governor in enumerate(governors):
        directory = tmp_path / f"cpu{number}" / "cpufreq"
        directory.mkdir(parents=True)
        (directory / "scaling_governor").write_text(governor + "\n", "utf-8")
    monkeypatch.setattr(machine, "_PROCESSORS", tmp_path)
    check = machine.frequency_scaling()
    assert check.state == state
    assert ("cpupower" in check.advice) == (state == WARNING)


@pytest.mark.parametrize(
    ("runtime", "state", "says"), [("950000", OK, "95 %"), ("-1", OK, "all"), ("0", WARNING, "0"), ("", SKIPPED, "")]
)
def test_share_of_real_time(runtime: str, state: str, says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "_read", lambda path: runtime if "runtime" in path else "1000000")
    check = machine.real_time_share()
    assert check.state == state
    assert says in check.value


def test_one_processor_and_a_busy_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0})
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    monkeypatch.setattr(os, "getloadavg", lambda: (3.0, 1.0, 1.0))
    assert machine.processors().state == WARNING
    assert machine.load().state == WARNING
    monkeypatch.setattr(os, "getloadavg", lambda: (0.1, 1.0, 1.0))
    assert machine.load().state == OK


def test_what_is_missing_is_exit_code_1(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    version = metadata.version

    def absent(name: str) -> str:
        if name == "msgpack":
            raise metadata.PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(metadata, "version", absent)
    assert cli.main(["doctor"]) == 1
    out = capsys.readouterr().out
    (line,) = [line for line in out.splitlines() if line.startswith("missing")]
    assert "pip install msgpack" in line


def test_one_line_each_and_json(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    checks = [Check("this", OK, "fine"), Check("that", WARNING, "slow " * 60, "hurry")]
    monkeypatch.setattr("hapnet.ext.doctor.machine.examine", lambda *asked: checks)
    assert cli.main(["doctor", "--json", "-"]) == 0
    out, err = capsys.readouterr()
    found: list[dict[str, Any]] = json.loads(out)
    assert [set(check) for check in found] == [{"name", "state", "value", "advice"}] * 2
    assert len(err.splitlines()) == 2
    assert err.splitlines()[1].endswith("→ hurry")


async def test_zenoh_that_answers() -> None:
    address = free_address()
    world = ZenohTransport(ZenohSettings(listen=(address,)), lambda kind, data, now_ns: None, role="world")
    await world.open()
    try:
        check = await asyncio.to_thread(machine.zenoh_reachable, address)
    finally:
        await world.close()
    assert check.state == OK
    assert address in check.value


def test_a_line_is_shown_before_the_next_check(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    shown: list[str] = []

    def checks(*asked: object) -> Iterator[Check]:
        yield Check("this", OK, "fine")
        shown.append(capsys.readouterr().out)
        yield Check("that", OK, "fine")

    monkeypatch.setattr("hapnet.ext.doctor.machine.examine", checks)
    assert cli.main(["doctor"]) == 0
    assert len(shown) == 1
    assert "this" in shown[0]


def test_zenoh_that_cannot_be_opened_is_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    async def refuse(self: ZenohTransport) -> None:
        raise TransportError("no route\nto host")

    monkeypatch.setattr(ZenohTransport, "open", refuse)
    check = machine.zenoh_reachable("tcp/192.0.2.1:7447")
    assert check.state == MISSING
    assert "no route to host" in check.value
    assert check.advice


def test_zenoh_that_does_not_answer_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "REACH_S", 0.2)
    check = machine.zenoh_reachable(free_address())
    assert check.state == MISSING
    assert "did not answer within 0.2 s" in check.value


async def test_zenoh_over_tls(certificates: Path) -> None:
    address = free_address("tls")
    files = {name: (certificates / f"{name}.pem", certificates / f"{name}.key") for name in ("world", "alice")}
    listens = Security(certificates / "ca.pem", *files["world"], mutual_tls=True)
    world = ZenohTransport(
        ZenohSettings(listen=(address,), security=listens), lambda kind, data, now_ns: None, role="world"
    )
    alice, nobody = Security(certificates / "ca.pem", *files["alice"]), Security(certificates / "ca.pem")
    await world.open()
    try:
        accepted, answered = [
            await asyncio.to_thread(check, address, alice) for check in (machine.tls_handshake, machine.zenoh_reachable)
        ]
        refused = await asyncio.to_thread(machine.tls_handshake, address, nobody)
    finally:
        await world.close()
    assert (accepted.state, answered.state) == (OK, OK)
    assert refused.state == MISSING
    assert refused.value == f"{address}: the listener requires a certificate: give --tls-cert and --tls-key"


def test_a_tls_endpoint_is_shaken_hands_with_before_it_is_dialled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "REACH_S", 0.2)
    address = free_address("tls")
    handshake, dialled = list(machine.examine([address]))[-2:]
    assert (handshake.name, handshake.state) == ("tls handshake", MISSING)
    assert handshake.value == f"{address}: no program listens there"
    assert (dialled.name, dialled.state) == ("zenoh reachable", MISSING)
