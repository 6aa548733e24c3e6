"""A device and a world as processes of their own that faults can be done to, and what they left written."""

import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hapnet.errors import RecordingError
from hapnet.recording.mcap import read_recording
from hapnet.summary.run import merge
from hapnet.transport.config import free_address
from hapnet.wire.messages import Role
from tests.support.processes import HAPNET, Program, assert_accounts_agree, assert_passive, read_json, resident_kB

OTHER: dict[Role, Role] = {"device": "world", "world": "device"}

RECOVERY_S = 2.0
"""What is promised: after a fault has ended positions flow again within this and one round trip."""

METRONOME = (sys.executable, "-c", """
import time
last = time.monotonic()
while True:
    time.sleep(1e-3)
    now = time.monotonic()
    if now - last > 6e-3:
        print(now - last, flush=True)
    last = now
""")  # fmt: skip
"""A process that does nothing a thousand times a second, and says when the machine kept it from that for 5 ms more."""

PRESSED = (
    "--set", "operator_model.wait_s=0", "--set", "operator_model.reach_s=0.5", "--set", "operator_model.hold_s=3600",
)  # fmt: skip
"""A hand that goes to the wall at once and stays there."""

PRESSED_M = 0.002
"""A hand that is so far from the proxy presses [m]: with 100 N/m it feels 0.2 N, with 600 N/m 1.2 N."""

_PRESSED_STEPS = 5  # of the world: no longer the impact, which may bounce


class Side(Program):
    """One process of a side, with its log, recording and summary in files of its own.

    stem : of their names. command : what is started. env : variables beside this process's own.
    """

    def __init__(
        self,
        role: Role,
        stem: Path,
        *argv: object,
        command: Sequence[str] = HAPNET,
        env: Mapping[str, str] | None = None,
    ) -> None:
        self.role = role
        self.recording, self._log, self._json = (stem.with_suffix(end) for end in (".mcap", ".jsonl", ".json"))
        files = ("--record", self.recording, "--log", self._log, "--json", self._json)
        super().__init__(role, *argv, *files, command=command, env=env)

    @property
    def log(self) -> list[dict[str, Any]]:
        """What it said so far."""
        text = self._log.read_text("utf-8") if self._log.exists() else ""
        return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]

    def said(self, kind: str, since_ns: int = 0) -> list[dict[str, Any]]:
        """What it said of a kind; of any if that is empty."""
        return [line for line in self.log if kind in ("", line["kind"]) and line["monotonic_ns"] >= since_ns]

    def until_said(self, kind: str, since_ns: int = 0) -> int:
        """Wait until it says something of that kind; when it said it first since then [ns]."""
        self.until(f"{kind} in its log", lambda: bool(self.said(kind, since_ns)))
        return int(self.said(kind, since_ns)[0]["monotonic_ns"])

    @property
    def summary(self) -> dict[str, Any]:
        return read_json(self._json)

    @property
    def starved_s(self) -> float:
        """How long its threads were ready to run and had no processor, in all [s]: this machine's doing."""
        tasks = Path(f"/proc/{self.process.pid}/task").iterdir()
        return sum(int((task / "schedstat").read_text("ascii").split()[1]) for task in tasks) * 1e-9

    @property
    def memory_MB(self) -> float:
        """What is resident of it now."""
        return resident_kB(self.process.pid) / 1024.0

    def until_pressed(self, since_ns: int, *, wall: bool) -> None:
        """Wait until the world has recorded some steps, begun since then, with the hand pressing.

        Pressing on the wall, or else against the coupling: the device is well away from the proxy, which it pulls at.
        """

        def pressed() -> bool:
            try:
                world = read_recording(self.recording).world
            except RecordingError:  # nothing there yet
                return False
            if world is None or len(world["time_ns"]) < _PRESSED_STEPS or world["time_ns"][-_PRESSED_STEPS] < since_ns:
                return False
            pull = world["target_m"] - world["position_m"]
            how = world["penetration_m"] > 0.0 if wall else np.abs(pull[:, 0]) > PRESSED_M
            return bool(how[-_PRESSED_STEPS:].all())

        self.until("pressed", pressed)


RENDERING = ("--rendering", "paper")
"""Faults are judged by the paper's own coupling, whose set-position stands still while nothing comes. The accounts and
the protocol are the same with any feel."""


class Pair:
    """Both sides and all the processes that ever played them."""

    def __init__(
        self,
        directory: Path,
        *both: object,
        device: Sequence[object] = (),
        world: Sequence[object] = (),
        dial: str | None = None,
        listener: Role = "world",
        env: Mapping[str, str] | None = None,
    ) -> None:
        self.address = free_address()
        self._directory, self._env = directory, env
        self._argv: dict[Role, tuple[object, ...]] = {
            "world": (*both, *world),
            "device": (*both, *device),
        }
        self._argv[listener] += ("-l", self.address)
        self._argv[OTHER[listener]] += ("-e", dial or self.address)
        self.lives: dict[Role, list[Side]] = {"device": [], "world": []}

    def start(self, role: Role) -> Side:
        lives = self.lives[role]
        stem = self._directory / f"{role}{len(lives)}"
        lives.append(
            Side(role, stem, *RENDERING, *self._argv[role], "--duration", 0, "--seed", len(lives), env=self._env)
        )
        return lives[-1]

    @property
    def device(self) -> Side:
        return self.lives["device"][-1]

    @property
    def world(self) -> Side:
        return self.lives["world"][-1]

    def until_paired(self) -> int:
        """Wait until both are; when the later one was [ns]."""
        return max(side.until_said("paired") for side in (self.device, self.world))

    def stop(self) -> None:
        """Ask both to end, together, and see that they do so in order."""
        for side in (self.device, self.world):
            side.process.send_signal(signal.SIGTERM)
        for side in (self.device, self.world):
            code, _, stderr = side.end()
            assert (code, stderr) == (128 + signal.SIGTERM, ""), (side.role, code, stderr)

    def accounts(self) -> dict[str, Any]:
        """The summary of both, once they have ended, and that their accounts agree to the nanojoule."""
        summary = merge(self.device.summary, self.world.summary)
        assert_accounts_agree(summary)
        for way in ("up", "down"):
            assert summary["energy"][way]["in_flight_nJ"] == 0
            assert summary["energy"][way]["sent_nJ"] > 0
        assert_passive(summary)
        return summary

    def kill(self) -> None:
        for lives in self.lives.values():
            for side in lives:
                side.kill()


@contextlib.contextmanager
def pair(directory: Path, *both: object, **more: Any) -> Iterator[Pair]:
    """See `Pair`; whatever happens, nothing of it is left running."""
    both_sides = Pair(directory, *both, **more)
    try:
        both_sides.start("world")
        both_sides.start("device")
        yield both_sides
    finally:
        both_sides.kill()


@contextlib.contextmanager
def asleep(*processes: int) -> Iterator[None]:
    """Stopped, as the processes of a host that sleeps, and woken again whatever happens."""
    try:
        for process in processes:
            os.kill(process, signal.SIGSTOP)
        yield
    finally:
        for process in processes:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGCONT)


def let_pass(seconds: float) -> None:
    """How long a fault lasts, or until the next one: part of what is done, not of waiting for what it brings."""
    time.sleep(seconds)
