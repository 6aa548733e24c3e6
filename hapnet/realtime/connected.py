"""A side of a pair in an asyncio program: its data and events, and the calls that change it while it runs."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

from hapnet.checks import Vector
from hapnet.realtime.feed import Stream
from hapnet.realtime.side_events import SideEvent
from hapnet.realtime.side_task import SideTask
from hapnet.recording.samples import DeviceSample, WorldSample
from hapnet.summary.structure import Summary
from hapnet.wire.fields import Signal
from hapnet.wire.messages import Role
from netem import LinkProfile

SampleType = TypeVar("SampleType", DeviceSample, WorldSample)


class SetPosition(NamedTuple):
    """The set-positions of a side at one time: `target_m`, the newest from the peer, and `set_position_m`, the result
    of passive set-position modulation, to which the side's spring is tied [m]. `time_ns` : this machine's monotonic
    clock."""

    time_ns: int
    target_m: Vector
    set_position_m: Vector


class ConnectedSide(Generic[SampleType]):
    """The common part of `ConnectedDevice` and `ConnectedWorld`. For the event loop that entered its block.

    Only `summary` makes the servo wait, for some 0.2 ms: all other reads return copies, and each stream has a bounded
    queue of its own. After the side's end, or that of its block, calls that would change it raise `Ended`, or the error
    with which the side failed.
    """

    def __init__(self, task: SideTask) -> None:
        self._task = task

    @property
    def role(self) -> Role:
        """ "device" or "world"."""
        return self._task.side.role

    # -- its data and events -------------------------------------------------------------------------------------------

    async def wait_paired(self) -> None:
        """Wait for the first peer; return at once if there was one. Raises `Ended`, or the error of a failed side."""
        await self._task.paired()

    async def wait_ended(self) -> Summary:
        """Wait until the side ends by itself; returns its summary. Raises the error with which it failed."""
        return await self._task.result()

    @property
    def is_paired(self) -> bool:
        """Whether there is a peer now. It may be silent."""
        return self._task.side.wire.session.peer is not None

    def events(self) -> Stream[SideEvent]:
        """All events, from the first one on (200 are kept); each call makes a stream of its own.

        The last event is ``ended``. After it the stream ends, or raises the error with which the side failed.
        """
        return self._task.events.stream(_same)

    @property
    def sample(self) -> SampleType | None:
        """The newest sample; None before pairing. A device makes `Params.record_hz` a second, a world one a step."""
        newest: SampleType | None = self._task.samples.newest
        return newest

    def samples(self) -> Stream[SampleType]:
        """The samples from now on; each call makes a stream of its own."""
        return self._task.samples.stream(_same)

    @property
    def set_position(self) -> SetPosition | None:
        """The newest set-positions; None before pairing."""
        return None if (sample := self._task.samples.newest) is None else _set_position(sample)

    def set_positions(self) -> Stream[SetPosition]:
        """The set-positions of each sample from now on; each call makes a stream of its own."""
        return self._task.samples.stream(_set_position)

    def summary(self) -> Summary:
        """The summary so far, or of the whole run; the other side's part is the one it reported, or None."""
        return self._task.summary()

    # -- changes while it runs -----------------------------------------------------------------------------------------

    @property
    def link(self) -> LinkProfile:
        """The emulated link through which this side sends now."""
        return self._task.side.profile

    def change_link(self, text: str) -> None:
        """Send through another emulated link from now on: tc-netem's syntax, or a profile's name.

        Raises NetemError, InvalidParameter: there is no such link.
        """
        self._task.require_running()
        self._task.side.change_link(text)

    def report(self, name: str, value: Signal) -> None:
        """Send the other side a small value beside the stream.

        Raises InvalidParameter: it is no number, text, boolean, None or tuple of numbers, or there are too many.
        """
        self._task.require_running()
        self._task.side.report(name, value)

    tell = report
    """The former name of `report`, kept for one more release."""

    def pause(self, paused: bool = True) -> None:
        """Halt the simulated device or world, or let it continue. Servo, protocol and link keep running."""
        self._task.require_running()
        self._task.side.pause(paused)

    def stop_force(self, why: str) -> None:
        """End the device's force for good; either side may call it. why : the reason, for people."""
        self._task.require_running()
        self._task.side.stop_force(why)

    def record(self, path: str | PathLike[str] | None) -> None:
        """End the running recording, if there is one, and begin another at `path`; None: only end it.

        Raises RecordingError: it cannot be written.
        """
        self._task.require_running()
        self._task.side.record(None if path is None else Path(path))


class ConnectedDevice(ConnectedSide[DeviceSample]):
    """A device whose servo runs, made by `connect_device`."""

    def lead(self, position: Sequence[float]) -> None:
        """Lead the simulated hand to `position` [m], shape (n,), if the parameter `operator` is ``mouse``.

        Raises InvalidParameter: this device has no such hand, or `position` is not valid.
        """
        self._task.require_running()
        self._task.side.lead(tuple(position))


class ConnectedWorld(ConnectedSide[WorldSample]):
    """A world that steps, made by `connect_world`."""


def _same(item: Any) -> Any:
    return item


def _set_position(sample: DeviceSample | WorldSample) -> SetPosition:
    return SetPosition(sample.time_ns, sample.target_m, sample.set_position_m)
