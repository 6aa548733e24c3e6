"""A world with several hands in real time: one process, one thread that makes all steps, and a side for each hand.

The sides are those of `hapnet world` (`hapnet.realtime.runner`), each with its own session, link, account and
recording. They are clients of a Zenoh router in this process, which listens and dials as the world's command says; a
device reaches its seat by its name. With ``-m client`` they use the router that the command dials instead.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, cast

from hapnet.assembly.build import Setup
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.many.graph import RIGHTS, TOUCH
from hapnet.ext.many.hands import JointSteps
from hapnet.ext.many.joint import JointSeat
from hapnet.ext.many.reservoirs import Reservoirs
from hapnet.realtime.controllers import UNPAIRED_STEP_NS, ThreadedWorld
from hapnet.realtime.runner import RealtimeSide
from hapnet.realtime.servo import Stepper
from hapnet.side.notices import Notice
from hapnet.summary.run import Summary
from hapnet.transport.config import ZenohSettings
from hapnet.transport.router import FREE

Step = Callable[[int], int]


class JointLoop:
    """One thread that makes the steps of all hands of a world. reservoirs : of their seats; None: there is one hand."""

    def __init__(self, reservoirs: Reservoirs | None) -> None:
        self._reservoirs = reservoirs
        self._lock = threading.Lock()
        self._stepper = Stepper(self._step, self._fail, time.monotonic_ns)
        self._running: list[_OneLoop] = []
        self._joint = JointSteps(())
        self._began = False
        self.worlds: dict[_OneLoop, ThreadedWorld] = {}

    def for_hand(self, step: Step, on_error: Callable[[BaseException], None], clock: Callable[[], int]) -> _OneLoop:
        """The loop of one hand; a `hapnet.realtime.servo.MakeStepLoop`."""
        return _OneLoop(self, step, on_error)

    def begin(self, one: _OneLoop) -> None:
        """Let a hand take part in the steps."""
        with self._lock:
            self._running.append(one)
            self._change()
            if not self._began:
                self._began = True
                self._stepper.start()

    def end(self, one: _OneLoop) -> None:
        """Let a hand take part no more; with the last one the thread ends."""
        with self._lock:
            if one in self._running:
                self._running.remove(one)
                self._change()
            last = self._began and not self._running
        if last and threading.current_thread().name != "world":
            self._stepper.stop()

    def _change(self) -> None:
        worlds = [self.worlds[one] for one in self._running]
        self._joint = JointSteps([(world.side, world.wire.session) for world in worlds], self._reservoirs)

    def _step(self, now_ns: int) -> int:
        with self._lock:
            self._joint.begin(now_ns)
            lengths = [UNPAIRED_STEP_NS]
            for one in list(self._running):
                try:
                    length_ns = one.step(now_ns)
                except BaseException as error:
                    self._running.remove(one)
                    self._change()
                    one.on_error(error)
                    continue
                if self.worlds[one].side.origin_ns is not None:
                    lengths.append(length_ns)
            self._joint.end(now_ns)
        return lengths[1] if len(lengths) > 1 else lengths[0]

    def _fail(self, error: BaseException) -> None:
        for one in self._running:
            one.on_error(error)


class _OneLoop:
    """The part of one hand in a `JointLoop`."""

    def __init__(self, loop: JointLoop, step: Step, on_error: Callable[[BaseException], None]) -> None:
        self._loop, self.step, self.on_error = loop, step, on_error

    def start(self) -> None:
        """Begin to step."""
        self._loop.begin(self)

    def stop(self) -> None:
        """Make no more steps."""
        self._loop.end(self)


class SeatedWorld:
    """A world in real time, with a seat for each of several hands.

    setups : by the names of the seats, see `hapnet.ext.many.hands`. zenoh : the settings of their sides, see `routed`.
    session : part of the key expressions. seed : of the links and steps; None: a random one. records : the recordings'
    paths by the names of the seats. notify : called with a seat's name and each of its notices, on the event loop.
    refused : called with the time [ns]; returns a text with the refusals of the router since the last call.
    """

    def __init__(
        self,
        setups: Mapping[str, Setup],
        zenoh: ZenohSettings,
        *,
        session: str = "default",
        seed: int | None = None,
        records: Mapping[str, Path],
        notify: Callable[[str, Notice], None],
        refused: Callable[[int], list[str]] = lambda now_ns: [],
    ) -> None:
        first = next(iter(setups.values()))
        self._reservoirs = Reservoirs.of(first.params, first.scene)
        loop = JointLoop(self._reservoirs if len(setups) > 1 else None)
        self.sides: dict[str, RealtimeSide] = {}
        self.failures: dict[str, str] = {}
        self._notify = notify
        for number, (name, setup) in enumerate(setups.items()):
            made: list[_OneLoop] = []

            def keep(*parts: Any, made: list[_OneLoop] = made) -> _OneLoop:
                made.append(loop.for_hand(*parts))
                return made[0]

            side = RealtimeSide(
                setup, "world", zenoh, session=session, name=name, seed=None if seed is None else seed + number,
                record=records.get(name), notify=partial(notify, name), make_steps=keep,
                refused=(lambda now_ns: []) if number else refused,
            )  # fmt: skip
            self.sides[name] = side
            loop.worlds[made[0]] = cast(ThreadedWorld, side.control)

    async def run(self, stop: asyncio.Event, duration_s: float) -> dict[str, Summary]:
        """Run until `stop` is set, or each seat's duration is over; returns the seats' summaries.

        A seat whose side fails is closed, and the others go on (`failures`). A device that does not fit is refused.
        """
        await asyncio.gather(*(self._run(name, side, stop, duration_s) for name, side in self.sides.items()))
        return {name: side.summary() for name, side in self.sides.items()}

    async def _run(self, name: str, side: RealtimeSide, stop: asyncio.Event, duration_s: float) -> None:
        own = asyncio.Event()
        passing = asyncio.create_task(_set_after(stop, own))
        try:
            await side.run(own, duration_s)
        except HapnetError as error:
            self.failures[name] = str(error)
            closed = Notice("closed", f"the seat is closed: {error}", time.monotonic_ns(), "error")
            self._notify(name, closed)
        finally:
            passing.cancel()

    @property
    def environment(self) -> dict[str, float] | None:
        """The account of the shared bodies, with all hands; None: there is one hand, or each is alone among walls."""
        seat = next(iter(self.sides.values())).setup.scene
        return seat.shared.as_dict() if isinstance(seat, JointSeat) and len(self.sides) > 1 else None

    @property
    def reservoirs(self) -> dict[str, Any] | None:
        """The accounts of the seats' reservoirs; None: there is one hand."""
        sides = [(name, cast(ThreadedWorld, side.control).side) for name, side in self.sides.items()]
        return self._reservoirs.as_dict(sides) if len(sides) > 1 else None


async def _set_after(stop: asyncio.Event, own: asyncio.Event) -> None:
    await stop.wait()
    own.set()


def seat_names(text: str) -> dict[str, str]:
    """The rights of the seats in the text of `--seats`, by their names: names with commas, or a number.

    A name may be followed by its right, as in ``bob:watch``. Raises InvalidParameter.
    """
    if text.isdecimal():
        count = int(text)
        words: Sequence[str] = [f"seat{number}" for number in range(1, count + 1)] if 1 <= count <= 64 else []
    else:
        words = text.split(",")
    named = [word.strip().partition(":") for word in words]
    rights = {name: right if colon else TOUCH for name, colon, right in named}
    is_named = rights and all(rights) and len(rights) == len(named) and FREE not in rights
    if not is_named or not {*rights.values()} <= {*RIGHTS}:
        raise InvalidParameter("--seats", text, "1 to 64, or different names such as alice,bob or alice,bob:watch")
    return rights
