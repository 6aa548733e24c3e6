"""The servo's lateness under load: a device and a world process over Zenoh, as `hapnet run` starts them.

1 kHz of positions each way over an empty link, both sides recording. Meanwhile a bare deadline loop runs in a process
of its own under the same scheduling.
"""

from __future__ import annotations

import contextlib
import json
import secrets
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from queue import Empty, SimpleQueue
from tempfile import TemporaryDirectory
from typing import Any

from hapnet.bench.children import READY_S, Child, busy, uninterrupted
from hapnet.bench.row import Limit, Options, Row, row
from hapnet.bench.servo import BARE, Lateness, bare_loop, late_share
from hapnet.errors import HapnetError
from hapnet.params import Params
from hapnet.runtime.zenoh_config import free_address

KILOHERTZ = {"world.step_min_s": 0.001, "world.step_max_s": 0.001, "device.pspm_period_s": 0.001}
LATE_EXCESS = 0.0003
"""0.03 points: by how much the share of ticks late by a period may exceed the bare loop's."""


def servo_traffic(options: Options) -> Row:
    """The device's servo with 1 kHz each way and recording."""
    subject, bare = [], []
    rates: list[float] = []
    for _ in range(options.rounds):
        ours, theirs, rate = _round(options)
        subject.append(ours)
        bare.append(theirs)
        rates.append(rate)
    what = "lateness with 1 kHz each way over Zenoh, both sides recording, from pairing"
    beside = f", beside {options.beside} busy processes" if options.beside else ""
    return row(
        "servo_traffic",
        "us",
        what + beside,
        [part.distribution for part in subject],
        BARE + ", same time, from pairing",
        [part.distribution for part in bare],
        more={**late_share(subject, bare), "messages_per_s": min(rates)},
        limits=(
            Limit("ratio", 1.3),
            Limit("ratio_p99", 1.5 if options.realtime else 2.0),
            Limit("late_period_excess", LATE_EXCESS),
        ),
        note="; ".join([f"{min(rates):.0f} messages/s the slower way", *filter(None, [subject[0].refusal])]),
    )


def _round(options: Options) -> tuple[Lateness, Lateness, float]:
    """Lateness of the servo and of the bare loop, and the slower direction's messages a second."""
    seconds = options.seconds
    with contextlib.ExitStack() as stack:
        stack.enter_context(busy(options.beside))
        directory = Path(stack.enter_context(TemporaryDirectory(prefix="hapnet-bench-")))
        loop = stack.enter_context(Child(bare_loop, seconds, options.realtime))
        loop.wait_ready()
        params = Params().set({**KILOHERTZ, "link.up": "", "link.down": "", "duration_s": seconds})
        (directory / "params.toml").write_text(params.toml(), encoding="utf-8")
        address, session = free_address(), f"bench-{secrets.token_hex(4)}"
        with uninterrupted():
            world = stack.enter_context(_Side("world", directory, "--listen", address, "--session", session))
        world.expect("waiting")  # it has loaded its libraries: that must not disturb what is measured
        flags = ["--realtime"] if options.realtime else []
        with uninterrupted():
            device = stack.enter_context(_Side("device", directory, "--connect", address, "--session", session, *flags))
        device.expect("paired")
        loop.go()
        bare = loop.result(seconds + 30.0)
        summaries = [side.summary(seconds + 30.0) for side in (device, world)]
    servo = summaries[0]["device"]["servo"]
    bins = tuple((round(edge * 1e3), count) for edge, count in servo["late_histogram_us"])
    # up, the few messages about energy count too; down, a position each step
    sent = (summaries[0]["links"]["up"]["offered"], summaries[1]["world"]["step"]["count"])
    rate = min(count / summary["duration_s"] for count, summary in zip(sent, summaries, strict=True))
    return Lateness(bins, servo["skipped"], device.notices.get("realtime")), bare, rate


class _Side:
    """A process of `hapnet device` or `hapnet world`."""

    def __init__(self, role: str, directory: Path, *flags: str) -> None:
        self.role = role
        self.notices: dict[str, str] = {}
        """The newest notice of each kind."""
        self._json = directory / f"{role}.json"
        command = [sys.executable, "-m", "hapnet", role, *flags, "--no-multicast-scouting", "--log", "-"]
        command += ["--params", str(directory / "params.toml"), "--seed", "0"]
        command += ["--record", str(directory / f"{role}.mcap"), "--json", str(self._json)]
        self._errors = (directory / f"{role}.err").open("w+", encoding="utf-8")  # a pipe would fill up, and block it
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=self._errors, text=True)
        self._queue: SimpleQueue[str | None] = SimpleQueue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> _Side:
        return self

    def __exit__(self, *exc: object) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()
        assert self._process.stdout is not None
        self._process.stdout.close()
        self._errors.close()

    def expect(self, kind: str) -> None:
        """Return when it tells something of this kind."""
        for told in self._told(READY_S):
            if told == kind:
                return
        raise HapnetError(self._failure(f"ended before it was {kind}"))

    def summary(self, timeout_s: float) -> dict[str, Any]:
        """Its summary, once it has ended."""
        for _ in self._told(timeout_s):
            pass
        if self._process.wait(timeout_s) != 0:
            raise HapnetError(self._failure(f"ended with exit code {self._process.returncode}"))
        summary: dict[str, Any] = json.loads(self._json.read_text(encoding="utf-8"))
        return summary

    def _told(self, timeout_s: float) -> Iterator[str]:
        with contextlib.suppress(Empty):
            while (kind := self._queue.get(timeout=timeout_s)) is not None:
                yield kind
            return
        raise HapnetError(f"the {self.role} process said nothing for {timeout_s:.0f} s")

    def _failure(self, otherwise: str) -> str:
        self._process.kill()
        self._process.wait()
        self._errors.seek(0)
        said = self._errors.read().strip().splitlines()
        return f"the {self.role} process: {said[-1].removeprefix('hapnet: ') if said else otherwise}"

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with contextlib.suppress(json.JSONDecodeError):
                notice = json.loads(line)
                self.notices[notice["kind"]] = notice["text"]
                self._queue.put(notice["kind"])
        self._queue.put(None)
