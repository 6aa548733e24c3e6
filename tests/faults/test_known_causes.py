"""Real runs, each with a known cause: the verdict names that cause and no other, and the exit code is its own.

With a line for each on what was expected and what was said:
``pytest -n 0 -rP -m soak tests/faults/test_known_causes.py``.
"""

from __future__ import annotations

import json
import os
import re
import signal
import sys
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from hapnet.recording.mcap import read_recording
from hapnet.summary.verdict import findings
from hapnet.transport.config import free_address
from tests.faults.support import asleep, let_pass
from tests.support.arms import limited
from tests.support.faulty_parts import DRIVERS, LAWS, WORLDS
from tests.support.processes import HAPNET, Program, child_of, size, started

pytestmark = [pytest.mark.soak, pytest.mark.timeout(600)]

LIMIT_S = 240.0
SIDES = ("device", "world")
BUSY = frozenset({"leak", "risk"})
"""Causes that a busy machine adds: a servo that it kept from its work."""

SHAKEN = (
    "--operator", "sine", "--set", "operator_model.amplitude_m=0.04", "--set", "operator_model.frequency_hz=2",
    "--link", "delay 100ms 30ms",
)  # fmt: skip


class Ended(NamedTuple):
    """How a command ended. summary : what it wrote; empty: nothing."""

    code: int
    out: str
    err: str
    summary: dict[str, Any]


class Known(NamedTuple):
    """causes : those of the table that it must show, and no other. says : a pattern of what it prints.

    also : causes that may come too.
    """

    causes: frozenset[str]
    code: int
    says: str
    also: frozenset[str] = frozenset()


def known(*causes: str, code: int, says: str, also: tuple[str, ...] = ()) -> Known:
    return Known(frozenset(causes), code, says, frozenset(also))


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in (("drivers", DRIVERS), ("laws", LAWS), ("worlds", WORLDS)):
        Path(f"{name}.py").write_text(text, "utf-8")


def ended(program: Program, file: Path | str = "summary.json") -> Ended:
    code, out, err = program.end(LIMIT_S)
    path = Path(file)
    return Ended(code, out, err, json.loads(path.read_text("utf-8")) if size(path) else {})


def judged(name: str, got: Ended, expected: Known) -> None:
    shown = {one.cause: one.text for one in findings(got.summary)} if got.summary else {}
    said = "".join(line for line in got.out.splitlines(keepends=True) if re.match("(NOT )?PASSIV", line))
    extra = shown.keys() - expected.causes - expected.also - BUSY
    row = f"{name:34} expected {sorted(expected.causes)} code {expected.code}; said {sorted(shown)} code {got.code}"
    print(f"{row}\n    {said.strip()}\n    {got.err.strip()}")
    assert "Traceback" not in got.out + got.err, got.err
    assert not extra, (extra, said, got.err)
    assert expected.causes <= shown.keys(), (shown, said, got.err)
    assert got.code == expected.code, (said, got.err)
    assert re.search(expected.says, said + got.err, re.MULTILINE), said + got.err
    for cause in expected.causes:
        assert shown[cause] in said, said


DEVICE = ("--dof", "1", "--device")
EARLY = ("account",)  # on a busy machine it fails before its first tick
LITTLE = ("--set", "device.ceiling_J=0.0005", "--set", "world.ceiling_J=0.0005")
RUNS: dict[str, tuple[tuple[str, ...], Known]] = {
    "an ordinary run": ((), known(code=0, says="^PASSIVE: gave out at most")),
    "zoh on a bad link": (
        ("--coupling", "zoh", *SHAKEN),
        known("bound", code=0, says=r"^NOT PASSIVE: gave out .* mJ, more than", also=("hand", "true positions")),
    ),
    "a law that claims too much": (
        ("--coupling", "laws:Claims", *SHAKEN),
        known("bound", code=4, says="claims to be passive, but was not", also=("hand",)),
    ),
    "encoders of 10 mm": (
        (*DEVICE, "drivers:Coarse", "--set", "device.self_test_N=0", *LITTLE),
        known("blur", code=0, says="^PASSIVITY NOT KNOWN: .*the encoders are coarse", also=("speed",)),
    ),
    "a device that repeats readings": (
        (*DEVICE, "drivers:Steps"),
        known("repeats", code=0, says="^PASSIVITY NOT KNOWN: the device makes [0-9]+ readings"),
    ),
    "a device faster than it declares": (
        ("--set", "device.greatest_speed=0.02"),
        known("speed", code=0, says="^PASSIVITY NOT KNOWN: the device moved at .*, and declares at most 0.02 m/s"),
    ),
    "a device that never answers": ((*DEVICE, "drivers:Mute"), known(code=2, says="a device that can be read")),
    "a device that answers only once": (
        (*DEVICE, "drivers:Silent", "--duration", "20"),
        known("no reading", code=2, says="no reading"),
    ),
    "a silent device whose port goes": (
        (*DEVICE, "drivers:Gone", "--duration", "20"),
        known(code=2, says="the port is gone"),
    ),
    "a port that goes during the run": (
        (*DEVICE, "drivers:Unplugged"), known(code=2, says="the port is gone", also=EARLY)
    ),
    "a driver that raises": (
        (*DEVICE, "drivers:Raises"), known(code=2, says="RuntimeError: the bus says no", also=EARLY)
    ),
    "a driver that hangs for 4 s": (
        (*DEVICE, "drivers:Hangs", "--duration", "8"),
        known("blocked", code=3, says=r"driver blocks: read\(\) of drivers:Hangs took [45]\.\d+ s"),
    ),
    "a driver with stalls of 50 ms": (
        (*DEVICE, "drivers:Stalls", "--duration", "6"),
        known("blocked", code=3, says=r"driver blocks: read\(\) of drivers:Stalls"),
    ),
    "a motor whose sign flips": (
        (*DEVICE, "drivers:Flips", "--duration", "6"),
        known("stopped", code=3, says="force was stopped after"),
    ),
    "a dead-man switch that is released": (
        ("--set", "device.enable=0-1"), known(code=0, says="^PASSIVE: gave out at most")
    ),
    "a world that raises": (
        ("--scene", "worlds:Raises"), known(code=2, says="ArithmeticError: no strength left", also=("world failed",))
    ),
    "a world with energy nan": (
        ("--scene", "worlds:Endless"),
        known(code=2, says="its stored_J is nan", also=("world's account", "world failed")),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_a_run_of_both_sides(name: str) -> None:
    words, expected = RUNS[name]
    length = () if "--duration" in words else ("--duration", "4")
    with started("run", *words, *length, "--out", "out") as program:
        judged(name, ended(program, "out/summary.json"), expected)


def _signalled(role: str, number: signal.Signals) -> Known:
    if number == signal.SIGUSR1:
        return known("stopped", code=3, says=f"the {'follower' if role == 'world' else role}'s force was stopped after")
    if number == signal.SIGTERM:
        return known(code=2, says=f"the {role} ended before its time: was ended by SIGTERM")
    return known("torn", code=2, says=f"^PASSIVITY NOT KNOWN: the {role}'s recording is incomplete")


@pytest.mark.parametrize(("role", "number"), [
    ("device", signal.SIGKILL), ("device", signal.SIGTERM), ("world", signal.SIGKILL), ("world", signal.SIGTERM),
    ("device", signal.SIGUSR1),
])  # fmt: skip
def test_a_side_that_gets_a_signal(role: str, number: signal.Signals) -> None:
    with started("run", "--duration", "6", "--out", "out") as program:
        program.until("samples", lambda: all(size(Path(f"out/{one}.mcap")) > 2_000 for one in SIDES), LIMIT_S)
        let_pass(2.0)
        os.kill(child_of(program.process.pid, role), number)
        got = ended(program, "out/summary.json")
    expected = _signalled(role, number)
    if number == signal.SIGUSR1:  # somebody asked for it: it changes no verdict
        expected = known(code=3, says="force was stopped after")
    judged(f"{role} gets {number.name}", got, expected)
    assert read_recording(f"out/{role}.mcap").torn == (number == signal.SIGKILL)


def test_a_launcher_that_is_interrupted() -> None:
    with started("run", "--duration", "30", "--out", "out") as program:
        program.until("samples", lambda: size(Path("out/device.mcap")) > 2_000, LIMIT_S)
        let_pass(1.0)
        program.process.send_signal(signal.SIGINT)
        judged("Ctrl-C", ended(program, "out/summary.json"), known(code=130, says="^PASSIVE: "))


def test_a_servo_that_stood_still_while_it_pushed() -> None:
    with started("run", *DEVICE, "drivers:Good", "--duration", "5", "--out", "out") as program:
        program.until("samples", lambda: size(Path("out/device.mcap")) > 8_000, LIMIT_S)
        let_pass(1.0)
        with asleep(child_of(program.process.pid, "device")):
            let_pass(0.3)
        got = ended(program, "out/summary.json")
    assert "the servo stalled for longer than watchdog_s" in got.summary["verdict"]["reason"]
    judged("a servo that stands still", got, known(code=0, says="servo stalled for longer than watchdog_s"))


def test_a_full_disk() -> None:
    with started("run", "--duration", "4", "--out", "out", command=(*limited(20_000), *HAPNET)) as program:
        got = ended(program, "out/summary.json")
    judged("a full disk", got, known(code=3, says="File too large", also=("torn",)))


class TwoHosts:
    """A world that listens and a device that dials, which write their summaries."""

    def __init__(self) -> None:
        self.address, self.number = free_address(), 0
        self.programs: list[Program] = []
        self.files: dict[Program, str] = {}

    def start(self, role: str, *more: object) -> Program:
        self.number += 1
        file = f"{role}{self.number}.json"
        dials = ("-l" if role == "world" else "-e", self.address)
        program = Program(role, *dials, "--json", file, "--no-files", *more)
        self.files[program] = file
        self.programs.append(program)
        return program

    def ended(self, program: Program) -> Ended:
        return ended(program, self.files[program])

    def __enter__(self) -> TwoHosts:
        return self

    def __exit__(self, *raised: object) -> None:
        for program in self.programs:
            program.kill()


PRESSES = ("--operator", "press", "--duration", "6")
UNPROVED = ("unproved",)


@pytest.fixture
def hosts() -> Any:
    with TwoHosts() as made:
        yield made


def paired(*programs: Program) -> None:
    for program in programs:
        program.until("paired", lambda one=program: any("paired" in line for line in one.out), LIMIT_S)


def test_nobody_proves_who_the_peer_is(hosts: TwoHosts) -> None:
    world = hosts.start("world", "--duration", "6")
    device = hosts.start("device", *PRESSES)
    for name, program in (("device", device), ("world", world)):
        expected = known("unproved", code=0, says="^PASSIVE: .*the peer's identity is not proven")
        judged(f"neither word nor certificate: {name}", hosts.ended(program), expected)


@pytest.mark.parametrize("lost", ["world", "device"])
def test_a_side_that_is_killed_elsewhere(lost: str, hosts: TwoHosts) -> None:
    sides = {"world": hosts.start("world", "--once", "--duration", "9")}
    sides["device"] = hosts.start("device", "--operator", "press", "--duration", "9")
    paired(*sides.values())
    let_pass(3.0)
    sides[lost].process.kill()
    (other,) = sides.keys() - {lost}
    says = f"^PASSIVITY NOT KNOWN: the rest of the {lost}'s account is missing since its last report"
    expected = known("peer lost", "unproved", code=3, says=says)
    judged(f"the {lost} elsewhere is killed: {other}", hosts.ended(sides[other]), expected)


@pytest.mark.parametrize("word", [False, True])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("anew", ["world", "device"])
def test_a_side_that_is_restarted(anew: str, number: signal.Signals, word: bool, hosts: TwoHosts) -> None:
    """Nobody else spoke in its name. Who says goodbye has told its whole account; who is killed has not."""
    Path("word").write_text("correct horse", "ascii")
    Path("word").chmod(0o600)
    more = ("--secret-file", "word") if word else ()
    sides = {
        "world": hosts.start("world", "--duration", "30" if anew == "world" else "0", *more),
        "device": hosts.start("device", "--operator", "press", "--duration", "0", *more),
    }
    paired(*sides.values())
    let_pass(2.0)
    sides[anew].process.send_signal(number)
    sides[anew].process.wait()
    sides[anew] = hosts.start(anew, *(("--operator", "press") if anew == "device" else ()), "--duration", "0", *more)
    paired(sides[anew])
    let_pass(3.0)
    (other,) = sides.keys() - {anew}
    sides[other].process.send_signal(signal.SIGTERM)
    proof = () if word else UNPROVED
    vanishes = number == signal.SIGKILL
    causes = ("former", *proof) if vanishes else ()
    says = f"^PASSIVITY NOT KNOWN: .*the account of an earlier {anew} is missing" if vanishes else "^PASSIVE"
    got = hosts.ended(sides[other])
    name = f"{anew} restarted after {number.name}{', with a word' * word}"
    judged(name, got, known(*causes, code=143, says=says, also=("peer lost", *proof)))


def test_a_wrong_word(hosts: TwoHosts) -> None:
    for name in ("right", "wrong"):
        Path(name).write_text(f"{name} horse", "ascii")
        Path(name).chmod(0o600)
    hosts.start("world", "--duration", "20", "--secret-file", "right")
    device = hosts.start("device", *PRESSES, "--secret-file", "wrong")
    device.until_line("secret")
    let_pass(1.0)
    device.process.send_signal(signal.SIGTERM) if device.process.poll() is None else None
    got = hosts.ended(device)
    print(f"a wrong word: code {got.code}\n{got.out}{got.err}")
    assert got.code in (2, 143)
    assert not got.summary or got.summary["verdict"]["passive"] is None


def test_a_device_that_nobody_answers(hosts: TwoHosts) -> None:
    device = hosts.start("device", *PRESSES)
    device.until_line("waiting")
    device.process.send_signal(signal.SIGTERM)
    judged("no world", hosts.ended(device), known("accounts", code=143, says="there is no energy account"))


STRANGER = """
import json, sys, time, zenoh
from hapnet.wire.messages import Hello, Welcome, decode
from hapnet.wire.secret import Secret, sealed
config = zenoh.Config()
for key, value in (("mode", "client"), ("connect/endpoints", [sys.argv[1]]), ("scouting/multicast/enabled", False)):
    config.insert_json5(key, json.dumps(value))
session, mine, heard = zenoh.open(config), Secret(b"h" * 32), {}

def take(sample):
    try:
        message = decode(sample.payload.to_bytes())
    except Exception:
        return
    if isinstance(message, Hello) and (message.more or {}).get("key") not in (None, mine.public):
        heard[message.role] = message

kept = [session.declare_subscriber(f"hapnet/default/device/{way}/control", take) for way in ("up", "down")]
says = {role: session.declare_publisher(f"hapnet/default/device/{way}/control", express=True)
        for role, way in (("device", "up"), ("world", "down"))}
print("listens", flush=True)
end = time.monotonic() + float(sys.argv[2])
while time.monotonic() < end:
    for role, other in (("device", "world"), ("world", "device")):
        if len(heard) == 2:
            to, me = heard[role], heard[other]
            key = mine.key(me.incarnation, to.incarnation, to.more["key"])
            more = {"key": mine.public, "encrypts": False}
            says[other].put(sealed(Welcome(me.incarnation, to.incarnation, to.number, me.role, me.dof, me.name,
                                           me.about, more), key))
    time.sleep(0.002)
"""


def test_a_stranger_who_welcomes_both_in_the_others_name(hosts: TwoHosts) -> None:
    world = hosts.start("world", "--duration", "12")
    world.until_line("waiting")
    stranger = Program(hosts.address, "20", command=(sys.executable, "-c", STRANGER))
    try:
        stranger.until_line("listens")
        device = hosts.start("device", "--operator", "press", "--duration", "8")
        got = hosts.ended(device)
    finally:
        stranger.kill()
    expected = known("contradiction", code=5, says="another sender used the world's name",
                     also=("unproved", "account", "peer lost", "accounts"))  # fmt: skip
    judged("a stranger between both", got, expected)
