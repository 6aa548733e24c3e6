"""Two sides in one event loop, over Zenoh."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from typing import Any

from hapnet.assembly.build import prepare
from hapnet.params import Params
from hapnet.realtime.controllers import ThreadedDevice, ThreadedWorld
from hapnet.realtime.runner import RealtimeSide
from hapnet.side.device import DeviceSide
from hapnet.side.notices import Notice
from hapnet.transport.config import ZenohSettings
from hapnet.wire.messages import Role

WAIT_S = 30.0
LINK = "delay 5ms 2ms loss 5%"


class Running:
    """A side and what it reported; `stop` ends it."""

    def __init__(self, role: Role, address: str, params: Params, **more: Any) -> None:
        self.notices: list[Notice] = []
        self.stop = asyncio.Event()
        where = ZenohSettings(listen=(address,)) if role == "world" else ZenohSettings(connect=(address,))
        setup = prepare(params, "sampled")
        self.side = RealtimeSide(setup, role, where, seed=1, notify=self.notices.append, **more)
        self.task = asyncio.create_task(self.side.run(self.stop, params.duration_s))

    async def until(self, condition: Callable[[], bool]) -> None:
        """Poll until it holds; what ended the side meanwhile is raised."""
        async with asyncio.timeout(WAIT_S):
            while not condition():
                if self.task.done():
                    self.task.result()
                    raise AssertionError(f"{self.side.role} has ended")
                await asyncio.sleep(0.01)

    async def end(self) -> dict[str, Any]:
        self.stop.set()
        return await asyncio.wait_for(self.task, WAIT_S)

    @property
    def count(self) -> int:
        """Ticks of the device's servo, or steps of the world."""
        control = self.side.control
        assert isinstance(control, ThreadedDevice | ThreadedWorld)
        side = control.side
        return side.ticks if isinstance(side, DeviceSide) else side.steps

    def reported(self, kind: str) -> list[str]:
        return [notice.text for notice in self.notices if notice.kind == kind]


def parameters(**changes: object) -> Params:
    given = {"duration_s": 0.0, "link.up": LINK, "link.down": LINK, **changes}
    return Params().set({name.replace("__", "."): value for name, value in given.items()})


def idle(role: Role) -> RealtimeSide:
    return RealtimeSide(prepare(parameters(), "sampled"), role, ZenohSettings(connect=("tcp/127.0.0.1:1",)))


@contextlib.asynccontextmanager
async def running(*sides: Running) -> AsyncIterator[None]:
    try:
        yield
    finally:
        for side in sides:
            side.stop.set()
        await asyncio.gather(*(side.task for side in sides), return_exceptions=True)
