"""Starts the two processes of a pair for a benchmark, and reads their notices and summaries."""

from __future__ import annotations

import contextlib
import json
import secrets
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from queue import Empty, SimpleQueue
from tempfile import TemporaryDirectory
from typing import Any

from hapnet.errors import HapnetError
from hapnet.ext.bench.row import Options
from hapnet.ext.bench.servo import PERIOD_NS, Lateness
from hapnet.params import Params
from hapnet.processes.child import READY_S
from hapnet.processes.start import PIPE, how_it_ended, side_command, started
from hapnet.transport.config import local_address

_INCOMPLETE = 3
"""Exit code of a side whose recording is incomplete, such as of a fast servo on busy cores. Its summary is used."""


def start_pair(
    stack: ExitStack,
    params: Params,
    *,
    realtime: bool,
    beside: Callable[[str], AbstractContextManager[object]] | None = None,
) -> tuple[Side, Side]:
    """Start a device and a world that pair; both record, and are ended with `stack`.

    beside : entered with the world's address before the device starts, so that it does not disturb the measurement.
    """
    directory = Path(stack.enter_context(TemporaryDirectory(prefix="hapnet-bench-")))
    (directory / "params.toml").write_text(params.toml(sources=True), encoding="utf-8")
    address, session = local_address(str(directory)), f"bench-{secrets.token_hex(4)}"
    world = stack.enter_context(Side("world", directory, "--listen", address, session=session))
    world.expect("waiting")  # then its libraries are loaded, which would disturb the measurement
    if beside is not None:
        stack.enter_context(beside(address))
    flags = ["--realtime"] if realtime else []
    device = stack.enter_context(Side("device", directory, "--connect", address, *flags, session=session))
    device.expect("paired")
    return device, world


def lateness(summary: dict[str, Any], device: Side, period_ns: int = PERIOD_NS) -> Lateness:
    """The lateness of the device's servo from pairing on."""
    servo = summary["device"]["servo"]
    bins = tuple((round(edge * 1e3), count) for edge, count in servo["late_histogram_us"])
    return Lateness(bins, servo["skipped"], device.notices.get("realtime"), period_ns)


def beside_and_alone(
    params: Params, options: Options, beside: Callable[[str], AbstractContextManager[object]]
) -> tuple[list[Lateness], list[Lateness]]:
    """The lateness of the device's servo in a pair with `beside`, and in the same pair alone, in turns."""
    watched: list[Lateness] = []
    alone: list[Lateness] = []
    for number in range(options.rounds):
        turns = [(watched, beside), (alone, None)]
        for parts, near in turns if number % 2 else reversed(turns):
            with ExitStack() as stack:
                device, world = start_pair(stack, params, realtime=options.realtime, beside=near)
                parts.append(lateness(device.summary(options.seconds + 60.0), device))
                world.summary(30.0)
    return watched, alone


class Side:
    """A process of `hapnet device` or `hapnet world`."""

    def __init__(self, role: str, directory: Path, *flags: str, session: str = "bench") -> None:
        self.role = role
        self.notices: dict[str, str] = {}
        """The newest notice of each kind."""
        self._json = directory / f"{role}.json"
        command = side_command(
            role, *flags, session=session, params=directory / "params.toml", seed=0,
            record=directory / f"{role}.mcap", summary=str(self._json),
        )  # fmt: skip
        self._errors = (directory / f"{role}.err").open("w+", encoding="utf-8")  # a pipe would fill up, and block
        self._process = started(command, stdout=PIPE, stderr=self._errors.fileno())
        self._queue: SimpleQueue[str | None] = SimpleQueue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> Side:
        return self

    def __exit__(self, *exc: object) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()
        assert self._process.stdout is not None
        self._process.stdout.close()
        self._errors.close()

    def expect(self, kind: str) -> None:
        """Wait for a notice of this kind."""
        for found in self._kinds(READY_S):
            if found == kind:
                return
        raise HapnetError(self._failure(f"ended before it was {kind}"))

    def summary(self, timeout_s: float) -> dict[str, Any]:
        """The process's summary; waits until it has ended."""
        for _ in self._kinds(timeout_s):
            pass
        if self._process.wait(timeout_s) not in (0, _INCOMPLETE):
            raise HapnetError(self._failure(how_it_ended(self._process.returncode)))
        summary: dict[str, Any] = json.loads(self._json.read_text(encoding="utf-8"))
        return summary

    def _kinds(self, timeout_s: float) -> Iterator[str]:
        with contextlib.suppress(Empty):
            while (kind := self._queue.get(timeout=timeout_s)) is not None:
                yield kind
            return
        raise HapnetError(f"the {self.role} process sent no notice for {timeout_s:.0f} s")

    def _failure(self, otherwise: str) -> str:
        self._process.kill()
        self._process.wait()
        self._errors.seek(0)
        lines = self._errors.read().strip().splitlines()
        return f"the {self.role} process: {lines[-1].removeprefix('hapnet: ') if lines else otherwise}"

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with contextlib.suppress(json.JSONDecodeError):
                notice = json.loads(line)
                self.notices[notice["kind"]] = notice["text"]
                self._queue.put(notice["kind"])
        self._queue.put(None)
