"""The processes behind the page of `hapnet play`: pairs, one after another."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import signal
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from hapnet.assembly.build import prepare
from hapnet.assembly.links import link_profile
from hapnet.assembly.scenes import for_its_scene
from hapnet.checks import Vector
from hapnet.commands import output
from hapnet.commands.log import Repeats
from hapnet.commands.pair import Pair
from hapnet.commands.side import catch, exit_code
from hapnet.commands.standby import Reserve
from hapnet.couplings.registry import coupling
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.page.choices import CHOICES, SCENES, label_of
from hapnet.ext.page.controls import Direction, require_no_file
from hapnet.ext.page.history import Episode, History
from hapnet.param_sources import PAGE
from hapnet.params import Params
from hapnet.processes.system import give_back_freed
from hapnet.summary.recorded import of_parts
from hapnet.summary.structure import Summary
from hapnet.summary.words import headline

if TYPE_CHECKING:
    from rich.console import Console

SESSION = "play"


class PageRecordings:
    """The recordings that the page switches on and off, with a number for each. out : as of `--out`. seed : of the run.

    Attributes
    ----------
    on : whether the running pair is to be recorded.
    """

    def __init__(self, out: Path | None, seed: int) -> None:
        self._out, self._seed = out, seed
        self._made: Path | None = None
        self._count = 0
        self.on = False

    @property
    def directory(self) -> Path:
        """The recordings' directory; the one where they would be by default if none was made."""
        return self._made or output.default_directory(self._out, self._seed)

    def prepare(self) -> None:
        """Make the directory, unless it was made before. Raises HapnetError."""
        if self._made is None:
            self._made = output.run_directory(self._out, self._seed)

    def next_stem(self) -> Path:
        """The beginning of the next recording's file names."""
        assert self._made is not None, "it was prepared when recording was switched on"
        self._count += 1
        return self._made.absolute() / f"{self._count:02d}"


class PairSequence:
    """Pairs of processes, one after another, under the page's `Controls`.

    Changes of the link, of the hand and of recordings go to the running pair. A change of the coupling ends that pair:
    its force goes to zero, and another pair starts at the handle's place, with a new energy account. Each pair has its
    own verdict, which is printed when the pair ends.

    params, seed : of the first episode. out : the directory for recordings. address : where the world listens.
    history : holds the handle's place and the margins of both ports; shows the verdict of each pair that has ended.
    """

    fixed = ""

    def __init__(
        self,
        params: Params,
        seed: int,
        out: Path | None,
        address: str,
        console: Console,
        history: History,
        *,
        realtime: bool,
    ) -> None:
        self._params, self._seed, self._address = params, seed, address
        self._words, self._history, self._realtime = console, history, realtime
        self._first = params
        self._meshes: Path | None = None
        self._episodes = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._pair: Pair | None = None
        self._over = asyncio.Event()
        self._position: Vector | None = None
        self._elsewhere = False
        self.reserve: Reserve = Reserve()
        self._recordings = PageRecordings(out, seed)
        self._repeats = Repeats()
        self.summary: Summary | None = None
        """The summary of the last pair that has ended."""

    async def run(self, stop: asyncio.Event) -> None:
        """Run one episode after another until `stop` is set.

        Raises HapnetError: a process failed; the message comes from that process.
        """
        self._loop = asyncio.get_running_loop()
        with tempfile.TemporaryDirectory(prefix="hapnet-") as meshes:
            self._meshes = Path(meshes)
            freeing = asyncio.create_task(give_back_freed())
            try:
                await self._run(stop)
            finally:
                freeing.cancel()
                await self.reserve.close()

    async def _run(self, stop: asyncio.Event) -> None:
        stopping = asyncio.create_task(stop.wait())
        stopping.add_done_callback(lambda task: self._over.set())
        while not stop.is_set():
            self._over.clear()
            self._pair = None
            params = for_its_scene(self._params)
            with tempfile.TemporaryDirectory(prefix="hapnet-") as directory:
                pair = Pair(
                    params, self._seed, Path(directory), self._on_notice, record=False, console=True,
                    realtime=self._realtime, session=SESSION, address=self._address, place=self._handle(),
                    orphaned=self._recordings.directory,
                )  # fmt: skip
                self._elsewhere = False
                await pair.start(await self.reserve.take())
                self._pair = pair
                self.reserve.prepare()
                if (link := self._params.link) != params.link:  # it changed while the processes started
                    self._link("up", link.up)
                    self._link("down", link.down)
                if self._position is not None:
                    self._lead(self._position)
                if self._recordings.on:
                    self._record()
                await pair.run(self._over)
                self.summary = self._report(params, pair, last=stop.is_set() or pair.failure is not None)
                if pair.failure is not None:
                    raise HapnetError(pair.failure)
        stopping.cancel()

    def leave_at_once(self) -> None:
        """End without waiting for the energy in flight."""
        if self._pair is not None:
            self._pair.stop()

    # -- the page's controls, on its threads -------------------------------------------------------------------------

    def lead(self, position: Vector) -> None:
        self._call(self._lead, position)

    def let_go(self, why: str) -> None:
        self._call(self._let_go, why)

    def link(self, direction: Direction, text: str) -> None:
        require_no_file(text)
        self._call(self._link, direction, str(link_profile(f"link.{direction}", text)))

    def coupling(self, name: str, rendering: str) -> None:
        if (name, rendering) not in CHOICES.values():  # only the run's own coupling may be loaded by its name
            if name != self._first.coupling:
                raise InvalidParameter("coupling", name, ", ".join(CHOICES), CHOICES)
            rendering = self._first.rendering
        changes: dict[str, object] = {"coupling": name, "rendering": rendering}
        if "device" not in coupling(name).set_positions:
            changes["device.smoothing_s"] = 0.0  # the filter needs set-positions
        self._anew(changes)

    def scene(self, label: str) -> None:
        words = {**SCENES, self._first.scene: self._first.scene}.get(label)
        if words is None:
            raise InvalidParameter("scene", label, ", ".join(SCENES), SCENES)
        self._anew({"scene": words, "dof": self._first.dof if words == self._first.scene else 0})

    def mesh(self, name: str, content: bytes) -> None:
        if self._meshes is None:
            raise HapnetError("no pair is running yet")
        file = self._meshes / f"{secrets.token_hex(4)}{Path(name).suffix.lower()}"
        file.write_bytes(content)
        self._anew({"scene": f"mesh:{file}?unit=mm", "dof": 0})

    def smoothing(self, seconds: float) -> None:
        self._anew({"device.smoothing_s": seconds})

    def reset(self) -> None:
        self._anew({})

    def pause(self, on: bool) -> None:
        self._call(self._send_both, lambda role: {"do": "pause", "on": on})

    def record(self, on: bool) -> None:
        if on:
            self._recordings.prepare()
        self._call(self._switch_recording, on)

    # -- on the loop -------------------------------------------------------------------------------------------------

    def _call(self, do: Callable[..., None], *args: Any) -> None:
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop is closed: there is nothing left to control
                self._loop.call_soon_threadsafe(do, *args)

    def _anew(self, changes: dict[str, object]) -> None:
        prepare(for_its_scene(self._params.set(changes, PAGE)), "sampled")  # in the page's thread, which shows an error

        def change() -> None:
            self._params = self._params.set(changes, PAGE)
            self._history.leave()
            self._elsewhere = "scene" in changes
            if self._elsewhere:
                self._position = None
            self._send_both(lambda role: {"do": "leave_at_once"})
            self._over.set()

        self._call(change)

    def _handle(self) -> Vector | None:
        """The last place of the handle in this world [m]; None: no sample has arrived."""
        track = self._history.snapshot().device
        return None if track is None or self._elsewhere else tuple(track.position_m[-1].tolist())

    def _report(self, params: Params, pair: Pair, *, last: bool) -> Summary | None:
        """Print the result of a pair that has ended, and pass its verdict to the page; returns its summary.

        last : no other pair follows. A process that was killed left no account; then the summary has only the other
        process's report. Returns None if the pair was replaced before it ran.
        """
        if len(pair.parts) < 2 and not last:
            return None
        summary = of_parts(
            {role: cast(Summary, part) for role, part in pair.parts.items()}, {}, None, pair.failed,
            coupling=params.coupling, seed=self._seed, margins=self._history.margins(),
        )  # fmt: skip
        verdict = summary["verdict"]
        self._history.end(Episode(params.coupling, params.rendering, verdict))
        self._episodes += 1
        label, seconds = label_of(params.coupling, params.rendering), summary["duration_s"] or 0.0
        self._words.print(
            f"{self._episodes}: {label}, {seconds:.0f} s: {headline(summary)[0]}",
            style="red" if verdict["passive"] is False else None,
            markup=False,
        )
        output.show_fact(self._words, summary)
        return summary

    def _lead(self, position: Vector) -> None:
        self._position = position
        if self._pair is not None:
            self._pair.send("device", do="lead", position=position)

    def _let_go(self, why: str) -> None:
        if self._pair is not None:
            self._pair.send("device", do="let_go", why=why)

    def _link(self, direction: Direction, text: str) -> None:
        self._params = self._params.set({f"link.{direction}": text}, PAGE)
        if self._pair is not None:
            self._pair.send("device" if direction == "up" else "world", do="link", words=text)

    def _switch_recording(self, on: bool) -> None:
        self._recordings.on = on
        if on:
            if self._pair is not None and not self._over.is_set():  # otherwise the next episode begins to record
                self._record()
        else:
            self._send_both(lambda role: {"do": "record", "path": None})

    def _record(self) -> None:
        stem = self._recordings.next_stem()
        self._send_both(lambda role: {"do": "record", "path": f"{stem}-{role}.mcap"})
        self._words.print(f"recording {stem}-device.mcap and -world.mcap; afterwards: hapnet report {stem}-*.mcap")

    def _send_both(self, command: Callable[[str], dict[str, Any]]) -> None:
        if self._pair is not None:
            for role in ("device", "world"):
                self._pair.send(role, **command(role))

    def _on_notice(self, role: str, line: bytes, notice: dict[str, Any]) -> None:
        """Show warnings and errors. Beside a browser a servo is often late; a line every ten seconds counts this."""
        kind, text = notice["kind"], notice["text"]
        if notice["level"] == "info" or self._over.is_set():
            return
        if (text := self._repeats.line(role, notice)) is None:
            return
        if kind == "overrun":
            text += "; it shares the processor with the browser (--realtime helps)"
        self._words.print(f"{role}: {text}", style="yellow", markup=False)


async def run(stage: PairSequence) -> int:
    """Run `stage` until a signal ends it; returns the exit code."""
    stop = asyncio.Event()
    caught: list[signal.Signals] = []
    catch(stop, caught, again=stage.leave_at_once)
    await stage.run(stop)
    return exit_code(caught)
