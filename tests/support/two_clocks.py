"""Two hosts with clocks of their own: messages over emulated links between them, or a whole simulated pair."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapnet.params import Params
from hapnet.recording.samples import Recording
from hapnet.side.link_port import LinkPort
from hapnet.simulation.simulation import Simulation
from netem import Link, LinkProfile
from netem.presets import PRESETS

SECOND = 1_000_000_000
Times = NDArray[np.int64]


class Clock:
    """The world's host's clock [ns] as a function of the device's: ahead by `offset_s`, and faster by `drift`.

    bend : the drift changes by this in a second.
    """

    def __init__(self, offset_s: float, drift: float, bend: float = 0.0) -> None:
        self._offset_ns, self._drift, self._bend = round(offset_s * SECOND), drift, bend

    def __call__(self, device_ns: int) -> int:
        return device_ns + self._offset_ns + round(device_ns * (self._drift + 0.5e-9 * self._bend * device_ns))

    def device_ns(self, world_ns: int) -> int:
        """The device's clock when this one shows that."""
        found = world_ns - self._offset_ns
        for _ in range(4):
            found += world_ns - self(found)
        return found


class Traffic(NamedTuple):
    """What two hosts recorded of each other's messages, and the truth.

    device, world : columns, each on its own clock. steps_ns : the world's steps on the device's clock.
    delays_s : of all messages that arrived.
    """

    device: dict[str, NDArray[Any]]
    world: dict[str, NDArray[Any]]
    steps_ns: Times
    delays_s: NDArray[np.float64]


def traffic(
    profiles: tuple[str, str], seed: int, clock: Clock, duration_s: float, steps_s: tuple[float, float] = (0.01, 0.05)
) -> Traffic:
    """Messages as the sides send them: the device's every 5 ms, the world's at steps of these lengths.

    profiles : of the links to the world, and to the device.
    """
    up, down, draws = np.random.SeedSequence(seed).spawn(3)
    lengths = np.random.default_rng(draws).uniform(*steps_s, round(2.0 * duration_s / sum(steps_s)))
    steps = (np.cumsum(lengths) * SECOND).astype(np.int64).tolist()
    to_world = _delivered(profiles[0], up, range(0, steps[-1], 5_000_000))
    to_device = _delivered(profiles[1], down, steps)
    ticks = range(0, steps[-1], 1_000_000)
    of_device, of_world = _used(to_device, ticks), _used(to_world, steps)
    return Traffic(
        {
            "time_ns": np.array([now for now, _, _ in of_device], dtype=np.int64),
            "transit_s": np.array([(came - clock(sent)) / SECOND for _, sent, came in of_device]),
        },
        {
            "time_ns": np.array([clock(now) for now, _, _ in of_world], dtype=np.int64),
            "transit_s": np.array([(clock(came) - sent) / SECOND for _, sent, came in of_world]),
        },
        np.array(steps, dtype=np.int64),
        np.array([(came - sent) / SECOND for sent, came in to_world + to_device]),
    )


def _delivered(profile: str, seed: np.random.SeedSequence, times: Any) -> list[tuple[int, int]]:
    """When each message was sent, and when it came, in the order in which they came."""
    link: Link[int] = Link(LinkProfile.parse(PRESETS.get(profile, profile)), seed=seed)
    came: list[tuple[int, int]] = []
    for now in times:
        came += [(sent, at) for at, sent in link.poll(now)]
        link.send(now, now, 100)
    return came + [(sent, at) for at, sent in link.poll(times[-1] + 60 * SECOND)]


def _used(messages: list[tuple[int, int]], times: Any) -> list[tuple[int, int, int]]:
    """At each time with a message: that time, and when the newest was sent and came."""
    found, k, newest = [], 0, (-1, -1)
    for now in times:
        while k < len(messages) and messages[k][1] <= now:
            newest = max(newest, messages[k])
            k += 1
        if newest[0] >= 0:
            found.append((now, *newest))
    return found


class TwoHosts(Simulation):
    """A simulation whose world has another clock; the device has the simulation's."""

    def __init__(self, params: Params, seed: int, clock: Clock) -> None:
        self._clock = clock
        super().__init__(params, seed, kernel=False)
        self.world_port = LinkPort(_Wire(self.world_endpoint, clock), self.down)
        self.world = _World(self.world, clock)

    def recordings(self, duration_s: float) -> tuple[Recording, Recording]:
        """The device's and the world's, of a run of so many seconds; their UTC differs by 0.3 s."""
        begin_ns = self.pair()
        self._until(begin_ns + round(duration_s * SECOND))
        whole, role = self._recorder.recording(), {"session": "s", "name": "n"}
        origin_ns, world_ns = self.device.origin_ns, self.world.origin_ns
        utc_ns = 1_700_000_000 * SECOND
        device = {**whole.meta, **role, "role": "device", "clock": "a", "origin_ns": origin_ns, "utc_origin_ns": utc_ns}
        world = {**whole.meta, **role, "role": "world", "clock": "b", "origin_ns": world_ns,
                 "utc_origin_ns": utc_ns + 300_000_000}  # fmt: skip
        return replace(whole, meta=device, world=None), replace(whole, meta=world, device=None)


class _Wire:
    """The world's wire half, which gets its own clock's time."""

    def __init__(self, wire: Any, clock: Clock) -> None:
        self._wire, self._clock = wire, clock

    def __getattr__(self, name: str) -> Any:
        return getattr(self._wire, name)

    def receive(self, now_ns: int, data: bytes) -> Any:
        return self._wire.receive(self._clock(now_ns), data)

    def poll(self, now_ns: int) -> Any:
        return self._wire.poll(self._clock(now_ns))

    @property
    def next_due_ns(self) -> int | None:
        due_ns = self._wire.next_due_ns
        return due_ns if not due_ns else self._clock.device_ns(due_ns) + 1


class _World:
    """The world's side, which gets its own clock's time."""

    def __init__(self, side: Any, clock: Callable[[int], int]) -> None:
        self._side, self._clock = side, clock

    def __getattr__(self, name: str) -> Any:
        return getattr(self._side, name)

    def step(self, now_ns: int) -> bytes | None:
        return self._side.step(self._clock(now_ns))
