"""A node with several pairs in real time: one process, one thread that makes all steps and ticks, a side for each pair.

The sides are those of `hapnet world` and `hapnet device` (`hapnet.realtime.runner`), each with its own session, link,
account and recording. They are clients of a Zenoh router in this process, which listens and dials as the command says.
Both sides of a pair meet by a name (`Graph.port_of`). With ``-m client`` they use the router that the command dials
instead.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from hapnet.assembly.build import Setup, compiled_ends
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.many.accounts import work_of
from hapnet.ext.many.bodies import EdgeEnds, SharedBody
from hapnet.ext.many.graph import RIGHTS, TOUCH
from hapnet.ext.many.joint import seat_of
from hapnet.ext.many.loop import JointLoop, WorldLoop
from hapnet.ext.many.reservoirs import Reservoirs
from hapnet.ext.many.shared_bodies import bind
from hapnet.realtime.controllers import ThreadedDevice, ThreadedWorld
from hapnet.realtime.runner import RealtimeSide
from hapnet.side.notices import Notice
from hapnet.side.world import WorldSide
from hapnet.summary.run import Summary
from hapnet.transport.config import ZenohSettings
from hapnet.transport.router import FREE
from hapnet.wire.messages import Role


@dataclass(frozen=True)
class NodePort:
    """A node's end of a pair: the pair's setup, and the node's role in it."""

    setup: Setup
    role: Role


@dataclass(frozen=True)
class Outputs:
    """Where the results of a node go while it runs.

    records : the recordings' paths by the names of the ports. notify : called with a port's name and each of its
    notices, on the event loop. refused : called with the time [ns]; returns a text with the refusals of the router
    since the last call.
    """

    records: Mapping[str, Path]
    notify: Callable[[str, Notice], None]
    refused: Callable[[int], list[str]] = lambda now_ns: []


class NodeSides:
    """A node in real time, with a side for each of its pairs.

    ports : by their names, see `Graph.port_of`; that of a follower's leader first. body : of a device with several
    pairs, or of a follower; None: the node is a world. zenoh : the settings of the sides, see `routed`.
    session : part of the key expressions. seed : of the links and steps; None: a random one. realtime : as in `Servo`.
    """

    def __init__(
        self,
        ports: Mapping[str, NodePort],
        zenoh: ZenohSettings,
        outputs: Outputs,
        *,
        body: SharedBody | None = None,
        period_ns: int | None = None,
        session: str = "default",
        seed: int | None = None,
        realtime: bool = False,
    ) -> None:
        self._body, self._notify = body, outputs.notify
        seats = [port.setup for port in ports.values() if port.role == "world"]
        shared = Reservoirs.of(seats[0].params, seats[0].scene) if seats else None
        self._reservoirs = shared if len(seats) > 1 else None
        self._scene = seats[0].scene if len(seats) > 1 else None
        loop = JointLoop(self._reservoirs, period_ns, realtime=realtime)
        self.sides: dict[str, RealtimeSide] = {}
        self.failures: dict[str, str] = {}
        for number, (name, port) in enumerate(ports.items()):
            made: list[WorldLoop] = []
            setup = port.setup
            if (seat := seat_of(setup.scene)) is not None:
                seat.hand = seat.hand._replace(name=name)

            def keep(*parts: Any, made: list[WorldLoop] = made) -> WorldLoop:
                made.append(loop.for_world(*parts))
                return made[0]

            if port.role == "device" and body is not None:
                setup = replace(setup, ends=EdgeEnds(body, compiled_ends()))
            side = RealtimeSide(
                setup, port.role, zenoh, session=session, name=name, seed=None if seed is None else seed + number,
                record=outputs.records.get(name), notify=partial(outputs.notify, name), make_steps=keep,
                make_servo=loop.for_device, refused=(lambda now_ns: []) if number else outputs.refused,
            )  # fmt: skip
            self.sides[name] = side
            if isinstance(side.control, ThreadedWorld):
                made[0].world = side.control
        bind(body, self._worlds.values())

    async def run(self, stop: asyncio.Event, duration_s: float) -> dict[str, Summary]:
        """Run until `stop` is set, or each pair's duration is over; returns the sides' summaries.

        A side that fails is closed, and the others go on (`failures`). A peer that does not fit is refused.
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
            what = "seat" if side.role == "world" else "pair"
            closed = Notice("closed", f"the {what} is closed: {error}", time.monotonic_ns(), "error")
            self._notify(name, closed)
        finally:
            passing.cancel()

    def interrupt(self, why: str) -> None:
        """Store why all sides are to end before their time; the caller also sets `stop`."""
        for side in self.sides.values():
            side.interrupt(why)

    def leave_at_once(self) -> None:
        """Leave at once; the peers may not be notified."""
        for side in self.sides.values():
            side.leave_at_once()

    @property
    def _worlds(self) -> dict[str, WorldSide]:
        controls = {name: side.control for name, side in self.sides.items()}
        return {name: control.side for name, control in controls.items() if isinstance(control, ThreadedWorld)}

    @property
    def environment(self) -> dict[str, float] | None:
        """The account of the shared bodies, with all hands; None: there is one hand, or each is alone among walls."""
        seat = None if self._scene is None else seat_of(self._scene)
        return None if seat is None else seat.shared.as_dict()

    @property
    def reservoirs(self) -> dict[str, Any] | None:
        """The accounts of the seats' reservoirs; None: there is one hand."""
        return None if self._reservoirs is None else self._reservoirs.as_dict(list(self._worlds.items()))

    @property
    def work(self) -> dict[str, float] | None:
        """The work at all forces of the body together, and what the ledgers count; None: its node leads no other."""
        controls = [side.control for side in self.sides.values()]
        devices = [control.side for control in controls if isinstance(control, ThreadedDevice)]
        return work_of(self._body, devices) if self._body is not None and devices else None


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
