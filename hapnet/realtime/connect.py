"""`connect_device` and `connect_world`: one side of a pair as an asynchronous context manager."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from contextlib import AbstractAsyncContextManager, ExitStack, asynccontextmanager
from dataclasses import dataclass
from functools import partial
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypedDict, Unpack, overload

from hapnet import checks
from hapnet.assembly import device_class
from hapnet.assembly.build import prepare
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.loading import shared_with_children
from hapnet.params import Params, as_params
from hapnet.plant.device import Device
from hapnet.plant.worlds.protocol import World, is_world
from hapnet.realtime.connected import ConnectedDevice, ConnectedWorld
from hapnet.realtime.runner import RealtimeSide
from hapnet.realtime.side_task import SideTask
from hapnet.recording.samples import Sample
from hapnet.side.notices import Notice
from hapnet.transport.config import ZenohSettings, zenoh_warnings
from hapnet.wire.messages import Role

Settings = Params | Mapping[str, object] | None
Endpoints = str | Iterable[str]
DeviceChoice = str | Device | Callable[..., Device] | None
Scene = str | World | Callable[..., Any] | None


class _Options(TypedDict, total=False):
    """The arguments of a call for either side, beside its parameters."""

    scene: Scene
    connect: Endpoints
    listen: Endpoints
    zenoh: ZenohSettings | None
    session: str
    name: str
    duration_s: float
    record: str | PathLike[str] | None
    seed: int | None
    once: bool


@overload
def connect_device(
    params: Settings = None,
    *,
    role: Literal["leader"] = "leader",
    device: DeviceChoice = None,
    realtime: bool = False,
    **options: Unpack[_Options],
) -> AbstractAsyncContextManager[ConnectedDevice]: ...


@overload
def connect_device(
    params: Settings = None,
    *,
    role: Literal["follower"],
    device: DeviceChoice = None,
    realtime: bool = False,
    **options: Unpack[_Options],
) -> AbstractAsyncContextManager[ConnectedWorld]: ...


def connect_device(
    params: Settings = None,
    *,
    role: Literal["leader", "follower"] = "leader",
    device: DeviceChoice = None,
    scene: Scene = None,
    connect: Endpoints = (),
    listen: Endpoints = (),
    zenoh: ZenohSettings | None = None,
    session: str = "default",
    name: str = "device",
    duration_s: float = 0.0,
    record: str | PathLike[str] | None = None,
    seed: int | None = None,
    realtime: bool = False,
    once: bool = False,
) -> AbstractAsyncContextManager[ConnectedDevice] | AbstractAsyncContextManager[ConnectedWorld]:
    """Run a haptic device, simulated or real, for as long as the block lasts; a world elsewhere is its peer.

        async with hapnet.connect_device({"scene": "wall"}, connect="tcp/192.168.0.2:17447") as device:
            await device.wait_paired()
            async for event in device.events():
                print(event.kind, event.text)

    The block begins when the servo runs and the world can connect; `wait_paired` waits for it. However the block is
    left, even by an exception or a cancellation, the force is set to zero first; then the world is notified, the
    recording closed, and no thread, task, socket or file remains. A block that ends normally waits for energy in
    flight: at most 2 s plus the link's delay. A cancelled block does not.

    params : a `Params`, or changes to the defaults by dotted names, such as ``{"device.stiffness": 200}``.
    role : "follower": this device is a robot that follows a leader elsewhere, in the place of a virtual world. `device`
        then replaces the parameter `follower.robot`, and is simulated by default.
    device : replaces the parameter `hardware`: a driver's name with its options (``"serial:/dev/ttyACM0"``,
        ``"simulated"``), a device (`hapnet.plant.device.Device`), or a function that makes one from ``dof``.
    scene : replaces the parameter `scene`: its name, a world such as `Scene`, or a function that makes one. It must
        have as many axes as the scene on the world's side.
    connect, listen : endpoints to dial or to listen on, such as ``"tcp/192.168.0.2:17447"``. If there are neither, the
        two sides find each other on this machine, and are not reachable from elsewhere.
    zenoh : replaces these by all settings of the connection, such as certificates.
    session, name : keep several pairs apart; the same on both sides.
    duration_s : end this long after pairing [s], in place of the parameter; 0: when the block is left.
    record : the path of a file to record to.
    seed : the seed of the emulated link; None: a random one.
    realtime : run the servo in a process of its own, with SCHED_FIFO and locked memory where that is allowed.
    once : end with the first peer; do not wait for another one.

    Raises InvalidParameter: an argument, or a parameter, is not allowed. TransportError: the connection cannot be
    opened, for example because an address is in use. RecordingError: the recording cannot be written. HapnetError: the
    device cannot be made, or fails, or the world does not fit. All are raised as the block begins or, later, when it is
    left; streams and `wait_paired` raise them too.
    """
    checks.one_of("role", role, ("leader", "follower"))
    follows = role == "follower"
    call = _Call(
        role="world" if follows else "device", device="simulated" if follows and device is None else device,
        params=params, scene=scene, link=_Connection(connect, listen, zenoh, session, name),
        duration_s=duration_s, record=record, seed=seed, realtime=realtime, once=once,
    )  # fmt: skip
    return _world(call) if follows else _device(call)


def connect_world(
    params: Settings = None,
    *,
    scene: Scene = None,
    connect: Endpoints = (),
    listen: Endpoints = (),
    zenoh: ZenohSettings | None = None,
    session: str = "default",
    name: str = "device",
    duration_s: float = 0.0,
    record: str | PathLike[str] | None = None,
    seed: int | None = None,
    once: bool = False,
) -> AbstractAsyncContextManager[ConnectedWorld]:
    """Run a virtual world for as long as the block lasts; a device elsewhere is its peer, and after it another one.

        async with hapnet.connect_world({"scene": "box"}, listen="tcp/0.0.0.0:17447") as world:
            async for sample in world.samples():
                print(sample.position_m, sample.penetration_m)

    Parameters and errors are those of `connect_device`. `name` is the device's, for several devices on one network.
    `seed` also seeds the lengths of the steps.
    """
    call = _Call(
        role="world", params=params, scene=scene, link=_Connection(connect, listen, zenoh, session, name),
        duration_s=duration_s, record=record, seed=seed, once=once,
    )  # fmt: skip
    return _world(call)


@asynccontextmanager
async def _device(call: _Call) -> AsyncIterator[ConnectedDevice]:
    async with _running(call) as task:
        yield ConnectedDevice(task)


@asynccontextmanager
async def _world(call: _Call) -> AsyncIterator[ConnectedWorld]:
    async with _running(call) as task:
        yield ConnectedWorld(task)


@asynccontextmanager
async def _running(call: _Call) -> AsyncIterator[SideTask]:
    """Run the side in a task, which has ended when this context is left."""
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        hint = "under anyio choose the backend asyncio, not trio"
        raise HapnetError(f"connect_{call.role} needs asyncio's event loop, and none runs here: {hint}") from None
    call.check()
    with ExitStack() as names:
        task = SideTask(partial(call.make, names), call.duration_s)
        try:
            await task.open()
            yield task
        except BaseException:
            await task.leave(leave_at_once=True)
            raise
        await task.leave(leave_at_once=False)
        if task.failure is not None:
            raise task.failure


class _Connection(NamedTuple):
    """The arguments by which a side reaches its peer; see `connect_device`."""

    connect: Endpoints
    listen: Endpoints
    zenoh: ZenohSettings | None
    session: str
    name: str

    def check(self) -> None:
        """Raise InvalidParameter for an argument of the wrong type."""
        for name in ("session", "name"):
            _require(name, getattr(self, name), str, "a name")
        _require("zenoh", self.zenoh, ZenohSettings | None, "a ZenohSettings, or None")

    def settings(self) -> ZenohSettings:
        """Return Zenoh's settings. Raises InvalidParameter."""
        connect, listen = _endpoints("connect", self.connect), _endpoints("listen", self.listen)
        if self.zenoh is None:
            return ZenohSettings(connect=connect, listen=listen, multicast_scouting=not (connect or listen))
        for name, given in (("connect", connect), ("listen", listen)):
            if given:
                raise InvalidParameter(name, " ".join(given), "", why=f"give {name} inside zenoh, or leave zenoh out")
        return self.zenoh


@dataclass(frozen=True, kw_only=True)
class _Call:
    """The arguments of a call; see `connect_device`."""

    role: Role
    params: Settings
    device: DeviceChoice = None
    scene: Scene
    link: _Connection
    duration_s: float
    record: str | PathLike[str] | None
    seed: int | None
    realtime: bool = False
    once: bool

    def check(self) -> None:
        """Raise InvalidParameter for an argument of the wrong type."""
        self.link.check()
        for name in ("realtime", "once"):
            _require(name, getattr(self, name), bool, "True or False")
        _require("record", self.record, str | PathLike | None, "a file's path, or None")
        checks.non_negative("duration_s", self.duration_s)
        if self.seed is not None:
            checks.whole("seed", self.seed, at_least=0)

    def make(
        self, names: ExitStack, notify: Callable[[Notice], None], watch: Callable[[Sample], None]
    ) -> tuple[RealtimeSide, tuple[str, ...]]:
        """Return the side, and warnings for its user. names : holds the names of parts that were given as objects."""
        try:
            return self._made(names, notify, watch)
        except InvalidParameter as error:
            if self.device is None or error.name not in ("hardware", "follower.robot"):
                raise
            raise error.renamed("device", self.device) from error

    def _made(
        self, names: ExitStack, notify: Callable[[Notice], None], watch: Callable[[Sample], None]
    ) -> tuple[RealtimeSide, tuple[str, ...]]:
        zenoh = self.link.settings()
        setup = prepare(self._parameters(names))
        warnings = setup.warnings + zenoh_warnings(zenoh)
        side = RealtimeSide(
            setup, self.role, zenoh, session=self.link.session, name=self.link.name, seed=self.seed,
            record=None if self.record is None else Path(fspath(self.record)),
            realtime=self.realtime, once=self.once, notify=notify, watch=watch,
        )  # fmt: skip
        return side, warnings

    def _parameters(self, names: ExitStack) -> Params:
        if isinstance(self.params, Mapping) and "duration_s" in self.params:
            raise InvalidParameter("params", self.params, "", why="give duration_s as an argument of its own")
        changes: dict[str, object] = {"duration_s": self.duration_s}
        if self.device is not None:
            chosen = "hardware" if self.role == "device" else "follower.robot"
            changes[chosen] = _named(names, "device", self.device, device_class.allowed(), _is_device)
        if self.scene is not None:
            changes["scene"] = _named(
                names, "scene", self.scene, "a scene's name, a world, or a function that makes one", is_world
            )
        return (Params() if self.params is None else as_params(self.params)).set(changes)


def _require(name: str, value: object, kind: Any, allowed: str) -> None:
    if not isinstance(value, kind):
        raise InvalidParameter(name, value, allowed)


def _endpoints(name: str, given: object) -> tuple[str, ...]:
    if isinstance(given, str):
        return (given,)
    if isinstance(given, Iterable):
        endpoints = tuple(given)
        if all(isinstance(each, str) for each in endpoints):
            return endpoints
    raise InvalidParameter(name, given, "an endpoint such as tcp/192.168.0.2:17447, or several in a list")


def _is_device(part: object) -> bool:
    return not isinstance(part, type) and any(
        all(hasattr(part, name) for name in ("dof", "read", command)) for command in ("apply", "move")
    )


def _named(names: ExitStack, name: str, part: object, allowed: str, is_made: Callable[[object], bool]) -> str:
    """The name of `part` for parameters. part : a name, a ready object, or a function that makes one."""
    if isinstance(part, str):
        return part
    if is_made(part):
        return names.enter_context(shared_with_children(_Made(part), type(part).__name__))
    if not callable(part):
        raise InvalidParameter(name, part, allowed)
    return names.enter_context(shared_with_children(part, getattr(part, "__name__", type(part).__name__)))


class _Made:
    """A factory that returns a ready part."""

    def __init__(self, part: object) -> None:
        self._part = part

    def __call__(self, **given: object) -> object:
        return self._part

    def __getattr__(self, name: str) -> Any:
        return getattr(self._part, name)
