"""One-way latency through an empty link: from the servo's hand-over to the decoded value in the peer's slot.

The whole path of `RealtimeSide` is measured in real processes, from the time at which the servo hands a message over to
the time at which the peer's endpoint has decoded it. In turns with it, raw Zenoh carries messages of the same form
between two processes with the same configuration. Both ends are on one machine, so they share CLOCK_MONOTONIC.

With `--realtime` the hand-over is in the servo's process, which stores no times. Then the latency counts from the
stamp in the message, the start of the tick that sent it. So it includes the hop from that process, and the tick.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import time
from collections.abc import Callable, Iterator
from tempfile import TemporaryDirectory
from typing import Literal

import zenoh

from hapnet.assembly.build import prepare
from hapnet.errors import HapnetError
from hapnet.ext.bench.row import Distribution, Limit, Options, RoundFigures, Row
from hapnet.ext.bench.traffic import KILOHERTZ
from hapnet.params import Params
from hapnet.processes.child import Child, WaitForStart
from hapnet.realtime.runner import RealtimeSide
from hapnet.realtime.servo import set_timer_slack, tuned_interpreter
from hapnet.side.notices import Notice
from hapnet.transport.config import ZenohSettings, free_address, local_address, zenoh_config
from hapnet.transport.entities import publisher
from hapnet.wire.events import PositionReceived
from hapnet.wire.messages import Position, decode, encode
from hapnet.wire.stream_frames import sequence_of

Stamps = list[tuple[int, bytes]]
"""The time [ns] at which a message was handed over (or a raw message arrived), and its bytes."""

Arrivals = list[tuple[int, int]]
"""The time [ns] at which a message arrived, and its number: a pair encrypts, so the bytes differ on the way."""

_PERIOD_NS = 1_000_000
_KEY = "hapnet/ext/bench/raw/up/position"
_SETTLE_S = 0.5  # at the start, not measured, as connections and caches are cold
_AFTER_S = 0.5  # at the end, for the last messages
_JOIN_S = 30.0


def one_way_latency(options: Options) -> Row:
    """Latency at 1 kHz of the whole path, of raw Zenoh with its defaults and with hapnet's settings, and of sockets.

    The two sides have the link that `hapnet run` gives them.
    """
    subject, bare, same, sockets = in_turns([hapnet_once, default_once, raw_once, socket_once], options)
    more = {
        f"{name}_{figure}": getattr(RoundFigures.of(rounds), figure)
        for name, rounds in (("same_link", same), ("udp_sockets", sockets))
        for figure in ("median", "p99")
    }
    return Row(
        "one_way_latency",
        "us",
        "a 1-DOF position from the servo's hand-over to the decoded value in the peer's slot, 1 kHz, as in hapnet run",
        subject,
        "raw Zenoh, put to direct callback, same bytes, its default configuration and publisher over tcp",
        bare,
        more=more,
        limits=(Limit("ratio", 1.0), Limit("ratio_p99", 1.25)),
        note=f"raw Zenoh over the same link with the same settings {more['same_link_median']:.3g}, "
        f"p99 {more['same_link_p99']:.3g}; plain udp sockets, all that is physically needed, "
        f"{more['udp_sockets_median']:.3g}, p99 {more['udp_sockets_p99']:.3g}",
    )


def one_way_latency_realtime(options: Options) -> Row:
    """The latency for a device with `--realtime`, whose servo's own process adds a socket to the path."""
    refusals: list[str] = []

    def once(seconds: float) -> Distribution:
        handed_over, arrived, refusal = run_sides(seconds, realtime=True)
        refusals.append(refusal)
        return join(tick_starts(handed_over), arrived)

    subject, bare = in_turns([once, raw_once], options)
    return Row(
        "one_way_latency_realtime",
        "us",
        "the same with --realtime, from the tick's start in the servo's own process: the tick itself counts, both hops",
        subject,
        "raw Zenoh, from put, as above",
        bare,
        note=refusals[0],
    )


def in_turns(kinds: list[Callable[[float], Distribution]], options: Options) -> list[list[Distribution]]:
    """The rounds of each kind of measurement; in each round another kind is the first."""
    rounds: list[list[Distribution]] = [[] for _ in kinds]
    for number in range(options.rounds):
        for turn in range(len(kinds)):
            kind = (number + turn) % len(kinds)
            rounds[kind].append(kinds[kind](options.seconds))
    return rounds


def hapnet_once(seconds: float) -> Distribution:
    """Latencies [us] through two `RealtimeSide`s."""
    handed_over, arrived, _ = run_sides(seconds, realtime=False)
    return join(handed_over, arrived)


def run_sides(seconds: float, *, realtime: bool) -> tuple[Stamps, Arrivals, str]:
    """Run a device and a world in processes of their own; returns hand-overs, arrivals, and `StampedSide.refusal`."""
    with (
        _link() as address,
        Child(run_side, "world", address, seconds, False) as world,
        Child(run_side, "device", address, seconds, realtime) as device,
    ):
        (handed_over, _, refusal), (_, arrived, _) = (side.result(seconds + _JOIN_S) for side in (device, world))
        return handed_over, arrived, refusal


def raw_once(seconds: float) -> Distribution:
    """Latencies [us] through raw Zenoh over the same link with the same settings."""
    with _link() as address:
        return _bare_once(send_zenoh, receive_zenoh, address, seconds, True)


def default_once(seconds: float) -> Distribution:
    """Latencies [us] through raw Zenoh with its default configuration and publisher, over tcp."""
    return _bare_once(send_zenoh, receive_zenoh, free_address(), seconds, False)


def socket_once(seconds: float) -> Distribution:
    """Latencies [us] through two udp sockets."""
    return _bare_once(send_plain, receive_plain, free_address("udp"), seconds)


def _bare_once(
    send: Callable[..., Stamps], receive: Callable[..., Stamps], address: str, seconds: float, *given: bool
) -> Distribution:
    with Child(receive, address, seconds, *given) as receiver:
        receiver.wait_ready()
        with Child(send, address, seconds, *given) as sender:
            sender.wait_ready()
            for child in (receiver, sender):
                child.go()
            sent, came = (child.result(seconds + _JOIN_S) for child in (sender, receiver))
            return join(sent, [(at_ns, number) for at_ns, data in came if (number := sequence_of(data)) is not None])


@contextlib.contextmanager
def _link() -> Iterator[str]:
    """A context with the address at which the two processes of a run connect."""
    with TemporaryDirectory(prefix="hapnet-bench-") as directory:
        yield local_address(directory)


def tick_starts(handed_over: Stamps) -> Stamps:
    """The starts of the ticks that sent these positions, from the positions' stamps; other messages are left out."""
    messages = [(decode(data), data) for _, data in handed_over]
    return [(message.sent_ns, data) for message, data in messages if isinstance(message, Position)]


def join(handed_over: Stamps, arrived: Arrivals) -> Distribution:
    """Latencies [us] of the messages that were sent after the first half second and arrived."""
    if not handed_over:
        raise HapnetError("one_way_latency: the servo sent no message")
    since_ns = handed_over[0][0] + round(_SETTLE_S * 1e9)
    sent = {sequence_of(data): at_ns for at_ns, data in handed_over if at_ns >= since_ns}
    late = [at_ns - sent[number] for at_ns, number in arrived if number in sent]
    if not late:
        raise HapnetError("one_way_latency: no message arrived")
    return Distribution.of(late, 1e-3)


class StampedSide(RealtimeSide):
    """A side that stores when its control thread hands a position over, and when its endpoint has decoded one."""

    def __init__(self, role: Literal["device", "world"], address: str, params: Params, *, realtime: bool) -> None:
        ends = (address,)
        where = ZenohSettings(listen=ends) if role == "world" else ZenohSettings(connect=ends)
        self.refusal: str = ""
        """The reason why real-time scheduling was refused; empty if it was granted, or not requested."""
        setup = prepare(params, "sampled")
        super().__init__(setup, role, where, session="bench", seed=0, realtime=realtime, notify=self._note_refusal)
        self.handed_over: Stamps = []
        self.arrived: Arrivals = []
        receive, arrived, clock = self.wire.receive, self.arrived, time.monotonic_ns

        def stamped(now_ns: int, data: bytes) -> object:
            events = receive(now_ns, data)
            came_ns = clock()
            arrived.extend((came_ns, event.sequence) for event in events if type(event) is PositionReceived)
            return events

        vars(self.wire)["receive"] = stamped  # an attribute of the instance, which hides the class's method

    def _note_refusal(self, notice: Notice) -> None:
        if notice.kind == "realtime":
            self.refusal = notice.text

    def _send(self, data: bytes) -> None:
        self.handed_over.append((time.monotonic_ns(), data))
        super()._send(data)


def run_side(
    wait_for_start: WaitForStart, role: Literal["device", "world"], address: str, seconds: float, realtime: bool
) -> tuple[Stamps, Arrivals, str]:
    """Run one side for `seconds` after pairing; returns its hand-overs, its arrivals, and `refusal`."""
    words = {"device.pspm_period_s": KILOHERTZ["device.pspm_period_s"], "link.up": "", "link.down": ""}
    duration_s = seconds + _SETTLE_S
    params = Params().set({**words, "operator": "sine", "duration_s": duration_s})
    side = StampedSide(role, address, params, realtime=realtime)

    async def run() -> None:
        await side.run(asyncio.Event(), duration_s)

    asyncio.run(run())
    return side.handed_over, side.arrived, side.refusal


def send_zenoh(wait_for_start: WaitForStart, address: str, seconds: float, ours: bool) -> Stamps:
    """Put messages of the same form on absolute deadlines like the servo; with hapnet's settings, or Zenoh's own."""
    with zenoh.open(_config("connect", address, ours)) as session:
        sender = publisher(session, _KEY, "position") if ours else session.declare_publisher(_KEY)
        give_up = time.monotonic() + 10.0
        while not session.info.transports() and time.monotonic() < give_up:
            time.sleep(0.01)
        return _send(wait_for_start, sender.put, seconds)


def receive_zenoh(wait_for_start: WaitForStart, address: str, seconds: float, ours: bool) -> Stamps:
    """Stamp the arriving messages, on Zenoh's own thread."""
    stamps: Stamps = []

    def on_sample(sample: zenoh.Sample) -> None:
        data = sample.payload.to_bytes()
        stamps.append((time.monotonic_ns(), data))

    with zenoh.open(_config("listen", address, ours)) as session, tuned_interpreter():
        session.declare_subscriber(_KEY, zenoh.handlers.Callback(on_sample, indirect=False))
        wait_for_start()
        time.sleep(seconds + _SETTLE_S + _AFTER_S)
        return list(stamps)


def send_plain(wait_for_start: WaitForStart, address: str, seconds: float) -> Stamps:
    """As `send_zenoh`, through a socket."""
    host, _, port = address.partition("/")[2].rpartition(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect((host, int(port)))
        return _send(wait_for_start, sender.send, seconds)


def receive_plain(wait_for_start: WaitForStart, address: str, seconds: float) -> Stamps:
    """As `receive_zenoh`, from a socket."""
    host, _, port = address.partition("/")[2].rpartition(":")
    stamps: Stamps = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind((host, int(port)))
        receiver.settimeout(_AFTER_S)
        wait_for_start()
        end_ns = time.monotonic_ns() + round((seconds + _SETTLE_S + _AFTER_S) * 1e9)
        while time.monotonic_ns() < end_ns:
            with contextlib.suppress(TimeoutError):
                data = receiver.recv(4096)
                stamps.append((time.monotonic_ns(), data))
    return stamps


def _config(side: Literal["connect", "listen"], address: str, ours: bool) -> zenoh.Config:
    if ours:
        ends = (address,)
        return zenoh_config(ZenohSettings(connect=ends) if side == "connect" else ZenohSettings(listen=ends))
    config = zenoh.Config()
    for name in ("connect", "listen"):
        config.insert_json5(f"{name}/endpoints", json.dumps([address] if name == side else []))
    config.insert_json5("scouting/multicast/enabled", "false")  # it would find other programs
    return config


def _send(wait_for_start: WaitForStart, put: Callable[[bytes], object], seconds: float) -> Stamps:
    set_timer_slack()
    with tuned_interpreter():
        wait_for_start()
        deadline_ns = time.monotonic_ns()
        frames = [
            encode(Position(2**62, number, deadline_ns, (0.0123,)))
            for number in range(round((seconds + _SETTLE_S) * 1e9 / _PERIOD_NS))
        ]
        stamps: Stamps = []
        for data in frames:
            deadline_ns = max(deadline_ns + _PERIOD_NS, time.monotonic_ns())
            while (left_ns := deadline_ns - time.monotonic_ns()) > 0:
                time.sleep(left_ns * 1e-9)
            stamps.append((time.monotonic_ns(), data))
            put(data)
        time.sleep(0.2)  # until the last has arrived
        return stamps
