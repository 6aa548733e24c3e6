"""`hapnet play` with the world on another host: the hand's side, in a process of its own, and the page run here."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import tempfile
import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapnet.assembly.links import link_profile
from hapnet.checks import Vector
from hapnet.commands import output
from hapnet.commands.options import ZenohOptions
from hapnet.commands.side import CONSOLE, PAGE, zenoh_settings
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.page.commands.options import PageOptions
from hapnet.ext.page.commands.view import show
from hapnet.ext.page.controls import Direction, require_no_file
from hapnet.ext.page.history import History
from hapnet.ext.page.server import serve
from hapnet.ext.page.watcher import TelemetryReader, Watcher
from hapnet.laws import COUPLING_NAMES
from hapnet.param_sources import COMMAND
from hapnet.params import Params
from hapnet.processes.child import frames
from hapnet.processes.start import NOTHING, PIPE, Program, end, module, started
from hapnet.processes.system import handled
from hapnet.recording.telemetry import Status, Telemetry
from hapnet.transport.router import FREE, free_name

if TYPE_CHECKING:
    from rich.console import Console

FIXED = "the world is on another host: its command sets scene, coupling and the link from the world"

FROM_WORLD = ("dof", "coupling", "rendering")
"""The parameters that this side takes from the world."""

PATIENCE_S = 2.0
"""After this time without a world a line states what the command waits for [s]."""

LINGER_S = 20.0
"""How long the hand's side may take to end when the page has failed [s]."""


@dataclass(frozen=True)
class FarWorld:
    """The world to connect to, how to reach it, and the outputs of this side.

    seed, out, files, realtime, json_to : as of `hapnet device`. quiet : print nothing but errors.
    """

    zenoh: ZenohOptions
    session: str
    name: str
    seed: int
    out: Path | None
    files: bool
    realtime: bool
    json_to: str | None = None
    quiet: bool = False

    def words(self) -> list[str]:
        """The flags of `hapnet device` for these settings."""
        words = [*self.zenoh.words(), "--session", self.session, "--name", self.name, "--seed", str(self.seed)]
        words += [] if self.out is None else ["--out", str(self.out)]
        words += [] if self.json_to is None else ["--json", self.json_to]
        words += ["--log", "-"] * self.quiet
        return [*words, *["--no-files"] * (not self.files), *["--realtime"] * self.realtime]


def play(params: Params, far: FarWorld, page: PageOptions) -> int:
    """Lead the hand on a page until a signal ends it; returns the exit code of the hand's side.

    params : of the hand's side.
    """
    if far.zenoh.encrypt and far.zenoh.secret_file is None:
        why = "it needs --secret-file, with which the page decrypts the telemetry"
        raise InvalidParameter("--encrypt", "alone", "", why=why)
    settings = zenoh_settings(far.zenoh)
    words = output.console(far.json_to)
    if far.name == FREE:
        far = replace(far, name=free_name(settings, far.session))
        words.print(f"takes the free seat {far.name}", markup=False)
    with ExitStack() as closing:
        found: queue.SimpleQueue[Status] = queue.SimpleQueue()

        def take(message: Telemetry) -> None:
            if isinstance(message, Status) and message.role == "world":
                found.put(message)

        watcher = Watcher(settings, take, session=far.session, name=far.name)
        watcher.open()
        closing.callback(watcher.close)
        world = _first(found, watcher, words)
        watcher.close()
        params = fitting(params, world)
        words.print(f"the world: {world.about.get('scene')}, coupled by {params.coupling}", markup=False)
        history = History(joins=False)
        hand = MouseHand(params, far, history, closing)
        served = closing.enter_context(serve(history, hand, host=page.host, port=page.port))
        words.print(f"open {served.url} and drag the handle; Ctrl-C ends")
        if page.browser:
            show(served.url)
        return hand.wait()


def _first(found: queue.SimpleQueue[Status], watcher: Watcher, console: Console) -> Status:
    """The world's first status; while it is missing, print what the command waits for."""
    shown = ""
    since_s = time.monotonic()
    while True:
        with contextlib.suppress(queue.Empty):
            return found.get(timeout=0.2)
        if time.monotonic() < since_s + PATIENCE_S:
            continue
        if watcher.telemetry.undecrypted:
            raise HapnetError("the world's telemetry is encrypted: give the world's --secret-file")
        text = f"waiting for a world's telemetry: {watcher.where}"
        text += f" ({watcher.problem})" if watcher.problem else ""
        if text != shown:
            console.print(text, style="yellow", markup=False)
        shown = text


def fitting(params: Params, world: Status) -> Params:
    """`params` with the axes, the coupling and the rendering of the world, unless the user has set them.

    Nothing else is taken from the network: a user's own coupling must be given here too.
    """
    theirs = world.about.get("params")
    offered: dict[str, Any] = {"dof": world.about.get("dof")}
    if isinstance(theirs, dict) and theirs.get("coupling") in COUPLING_NAMES:
        offered |= {name: theirs.get(name) for name in ("coupling", "rendering")}
    changes = {name: value for name, value in offered.items() if value is not None and not params.asked(name)}
    return params.set({"scene": "free", **changes}, COMMAND)


class MouseHand:
    """The hand's side, a `hapnet device` that the mouse moves, and the page's `Controls` of it.

    The child process prints its own lines and verdict on this terminal, and writes its own files.

    history : receives the telemetry of both sides. closing : ends the process if it still runs. fixed : why the page
    cannot change more.
    """

    def __init__(self, params: Params, far: FarWorld, history: History, closing: ExitStack, fixed: str = FIXED) -> None:
        self.fixed = fixed
        self._lock = threading.Lock()
        file = Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="hapnet-"))) / "params.toml"
        file.write_text(params.toml(sources=True), encoding="utf-8")
        ours, theirs = os.pipe()
        command = module("hapnet", "device", "--params", str(file), *far.words())
        try:
            self._child = started(
                command,
                stdin=PIPE,
                stdout=NOTHING if far.quiet else None,
                keeps=(theirs,),
                environment={CONSOLE: "1", PAGE: f"{theirs} {os.getpid()}"},
                own_group=True,
            )
        finally:
            os.close(theirs)
        closing.callback(end_child, self._child)
        reader = TelemetryReader(far.zenoh.security.secret_word(), history.take)
        threading.Thread(target=_read, args=(ours, reader), name="telemetry", daemon=True).start()

    def wait(self) -> int:
        """Forward signals that end this process, until the side has ended; returns its exit code."""
        with handled(lambda number, frame: self._child.send_signal(number)):
            return self._child.wait()

    def lead(self, position: Vector) -> None:
        self._send(do="lead", position=position)

    def let_go(self, why: str) -> None:
        self._send(do="let_go", why=why)

    def link(self, direction: Direction, text: str) -> None:
        require_no_file(text)
        if direction == "down":
            raise HapnetError(self.fixed)
        self._send(do="link", words=str(link_profile("link.up", text)))

    def pause(self, on: bool) -> None:
        self._send(do="pause", on=on)

    def _refuse(self, *given: object) -> None:
        raise HapnetError(self.fixed)

    coupling = scene = mesh = smoothing = reset = _refuse

    def record(self, on: bool) -> None:
        raise HapnetError("this side is recorded from its start; hapnet play --no-files records nothing")

    def _send(self, **command: Any) -> None:
        with self._lock, contextlib.suppress(OSError):  # it has ended
            assert self._child.stdin is not None
            self._child.stdin.write(json.dumps(command).encode() + b"\n")
            self._child.stdin.flush()


def _read(file: int, reader: TelemetryReader) -> None:
    with os.fdopen(file, "rb") as pipe:
        for data in frames(pipe):
            reader.read(data)


def end_child(child: Program) -> None:
    """Ask a program to end, and wait until it has."""
    if child.poll() is None:
        child.terminate()
        end(child, LINGER_S)
    if child.stdin is not None:
        with contextlib.suppress(OSError):
            child.stdin.close()
