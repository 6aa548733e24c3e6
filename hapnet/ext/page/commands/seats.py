"""`hapnet play --seats`: one world here, and one page's address; each browser that opens it gets a hand of its own."""

from __future__ import annotations

import json
import os
import signal
import tempfile
import threading
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from hapnet.assembly.build import Setup
from hapnet.commands import output
from hapnet.commands.log import Repeats
from hapnet.commands.options import ZenohOptions
from hapnet.commands.side import PARENT, exit_code
from hapnet.errors import HapnetError, TransportError
from hapnet.ext.page.commands.far_world import FarWorld, MouseHand, end_child
from hapnet.ext.page.commands.options import PageOptions
from hapnet.ext.page.commands.view import show
from hapnet.ext.page.entrance import Inner
from hapnet.ext.page.history import History
from hapnet.ext.page.seating import BrowserSeat, Seating, SeatsServer
from hapnet.ext.page.viser_page import ViserPage
from hapnet.loading import extension
from hapnet.param_sources import COMMAND
from hapnet.params import Params
from hapnet.processes.start import PIPE, Program, module, started
from hapnet.processes.system import handled
from hapnet.summary.words import headline
from hapnet.transport.config import ZenohSettings, free_address
from hapnet.transport.router import taken_names

if TYPE_CHECKING:
    from rich.console import Console

SESSION = "play"

FIXED = "several hands share this world: the command of hapnet play sets scene, coupling and the link from the world"

FRAME_S = 1.0 / 30.0
"""The time between two pictures [s]: several pages are drawn by one process."""

LOOK_S = 0.2


class Occupied:
    """Somebody in a seat: the device's side in a process, and the page that leads it. A `seating.Occupant`.

    far : as of `MouseHand`, with json_to, a file. names : of all hands. words : gets a line with the verdict.
    """

    def __init__(self, params: Params, far: FarWorld, names: Mapping[str, str], words: Console) -> None:
        self._far, self._words = far, words
        self._label = names[far.name]
        self._closing = ExitStack()
        history = History(joins=False, names=names)
        with ExitStack() as failing:
            self._hand = MouseHand(params, far, history, failing, FIXED)
            self._page = ViserPage(history, self._hand, frame_s=FRAME_S)
            self._closing = failing.pop_all()
        self.inner: Inner = self._page.connect

    def close(self) -> None:
        self._closing.close()
        self._page.end_drawing()
        self._page.stop()
        summary = None
        with suppress(OSError, ValueError):
            summary = json.loads(Path(self._far.json_to or "").read_text("utf-8"))
        said = "it left no account" if summary is None else headline(summary)[0]
        self._words.print(f"{self._label}: {said}", markup=False)


class Occupants:
    """Makes the occupants of seats. address : of the world. out : the directory for files; None: none are written."""

    def __init__(
        self,
        params: Params,
        address: str,
        seed: int,
        out: Path | None,
        private: Path,
        names: Mapping[str, str],
        words: Console,
        *,
        realtime: bool,
    ) -> None:
        self._params, self._seed, self._out, self._private = params, seed, out, private
        self._zenoh = ZenohOptions(connect=[address], no_multicast_scouting=True)
        self._settings = ZenohSettings(connect=(address,))
        self._names, self._words, self._realtime = names, words, realtime
        self._numbers = count(1)

    def occupy(self, seat: BrowserSeat) -> Occupied:
        """Put a device's side into this seat."""
        number = next(self._numbers)
        out = None if self._out is None else self._out / f"{number:02d}-{seat.name}"
        far = FarWorld(
            self._zenoh, SESSION, seat.name, self._seed + number, out, files=out is not None,
            realtime=self._realtime, json_to=str(self._private / f"{number}.json"), quiet=True,
        )  # fmt: skip
        return Occupied(self._params, far, self._names, self._words)

    def elsewhere(self) -> Collection[str]:
        """The seats of all devices that the world's router knows; none if it does not answer."""
        with suppress(TransportError):
            return taken_names(self._settings, SESSION)
        return ()


def play(
    params: Params,
    seats: str,
    setups: Mapping[str, Setup],
    seed: int,
    out: Path | None,
    page: PageOptions,
    json_to: str | None,
    *,
    realtime: bool,
) -> int:
    """Serve the page, and run the world, until a signal ends it; returns the exit code.

    params : of the world, and of all hands. seats : as of `hapnet world --seats`. setups : by the names of the seats.
    """
    words = output.console(json_to)
    directory = None if out is None else output.run_directory(out, seed)
    address = free_address()
    dof = next(iter(setups.values())).dof
    with ExitStack() as closing:
        private = Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="hapnet-")))
        file = private / "params.toml"
        file.write_text(params.toml(sources=True), encoding="utf-8")
        summary = private / "world.json"
        world = _world(file, seats, address, seed, directory, summary)
        closing.callback(end_child, world)
        threading.Thread(target=_show_troubles, args=(world, words), name="world", daemon=True).start()
        seating = Seating(setups)
        occupants = Occupants(
            params.set({"scene": "free", "dof": dof}, COMMAND), address, seed, directory, private, seating.labels,
            words, realtime=realtime,
        )  # fmt: skip
        with _stopped() as (stop, caught):
            with SeatsServer(seating, occupants.occupy, occupants.elsewhere, page.host, page.port) as served:
                words.print(f"open {served.url} in up to {len(setups)} browsers, ?name=NAME for a name; Ctrl-C ends")
                words.print(
                    f"`hapnet device --session {SESSION} --name free -e {address}` is one more hand", style="dim"
                )
                if page.browser:
                    show(served.url)
                while not stop.wait(LOOK_S):
                    if world.poll() is not None:
                        raise HapnetError("the world has ended, so nothing is left to touch")
            world.send_signal(signal.SIGTERM)
            code = world.wait()
        written = output.Written()
        with written.part():
            result = json.loads(summary.read_text("utf-8"))
            extension("seats").show_seats(words, "world", result)
            output.write_json(result, json_to)
    return written.code(exit_code(caught) if code in (0, 128 + signal.SIGTERM) else code)


def _world(params: Path, seats: str, address: str, seed: int, directory: Path | None, summary: Path) -> Program:
    command = module("hapnet", "world", "--seats", seats, "--params", str(params), "--listen", address)
    command += ["--session", SESSION, "--seed", str(seed), "--json", str(summary), "--log", "-"]
    command += ["--no-files"] if directory is None else ["--out", str(directory / "world")]
    return started(command, stdout=PIPE, environment={PARENT: str(os.getpid())}, own_group=True)


def _show_troubles(world: Program, words: Console) -> None:
    """Print the world's warnings and errors, until it has ended."""
    repeats = Repeats()
    assert world.stdout is not None
    for line in world.stdout:
        with suppress(ValueError, KeyError):
            notice = json.loads(line)
            if notice["level"] != "info" and (text := repeats.line("world", notice)) is not None:
                words.print(text, style="yellow", markup=False)


@contextmanager
def _stopped() -> Iterator[tuple[threading.Event, list[signal.Signals]]]:
    """An event that a signal to end this process sets, and the signals that came."""
    stop, caught = threading.Event(), list[signal.Signals]()

    def on_signal(number: int, stack: object) -> None:
        caught.append(signal.Signals(number))
        stop.set()

    with handled(on_signal):
        yield stop, caught
