"""The `netem` command. Slow imports (numpy, asyncio, zenoh, rich, matplotlib) wait for the command that needs them."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Coroutine
from contextlib import suppress
from dataclasses import astuple, dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from netem import output, units
from netem.errors import NetemError
from netem.groups import grouped
from netem.notes import notes
from netem.presets import ALIASES, PRESETS
from netem.profile import LinkProfile, compose
from netem.progress import Progress
from netem.version_flag import versions

if TYPE_CHECKING:
    from netem.live import RelayFigures
    from netem.relay import UdpRelay
    from netem.tcp_relay import TcpRelay
    from netem.zenoh_relay import ZenohRelay

app = typer.Typer(
    name="netem",
    help="A link emulator in the syntax of Linux's tc-netem. It needs no root and no kernel module, and the same seed "
    "gives the same link.",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _profiles() -> list[tuple[str, str]]:
    return list(PRESETS.items())


Words = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="WORDS",
        help="A profile's name (`netem profiles`), tc-netem's text, such as 'delay 40ms 10ms loss gemodel 1% 20%', or "
        "the file of a recorded link.",
        autocompletion=_profiles,
    ),
]
ProfileOption = Annotated[
    str | None,
    typer.Option("--profile", help="As WORDS, for scripts of older versions.", hidden=True, autocompletion=_profiles),
]
Delay = Annotated[str | None, typer.Option(help="Delay, such as 40ms.")]
Jitter = Annotated[str | None, typer.Option(help="Jitter [correlation], such as 10ms or '10ms 25%'.")]
LossOption = Annotated[str | None, typer.Option("--loss", help="Loss, such as 2% or 'gemodel 1% 20%'.")]
Reorder = Annotated[str | None, typer.Option(help="Reordering, such as 5% or '25% 50% gap 5'.")]
Rate = Annotated[str | None, typer.Option(help="Rate, such as 1mbit.")]
Resend = Annotated[
    str | None,
    typer.Option(metavar="N TIME", help="Resends of lost messages, such as '3 8ms' or '3 8ms unordered'; 0: none."),
]
JsonTo = Annotated[str | None, typer.Option("--json", metavar="FILE|-", help="Write the result as JSON; - is stdout.")]

# options of the relays
_TIMELINE = "Changes while it runs: 'at 5s: delay 200ms; at 8s: down; at 9s: up', or a file of such lines"
Up = Annotated[
    str | None,
    typer.Option(metavar="WORDS", help="Profile of the uplink, from the --listen side.", autocompletion=_profiles),
]
Down = Annotated[str | None, typer.Option(metavar="WORDS", help="Profile of the downlink.", autocompletion=_profiles)]
TimelineOption = Annotated[str | None, typer.Option("--timeline", metavar="TEXT|FILE", help=f"{_TIMELINE}.")]
UpTimeline = Annotated[str | None, typer.Option(metavar="TEXT|FILE", help="The same for the uplink alone.")]
DownTimeline = Annotated[str | None, typer.Option(metavar="TEXT|FILE", help="The same for the downlink alone.")]
Seed = Annotated[int, typer.Option(min=0, max=2**63 - 1, help="Seed of the draws; each direction has its own streams.")]
Duration = Annotated[str | None, typer.Option(metavar="S", help="Stop after this time, as 10 or 500ms; else Ctrl-C.")]


@dataclass(frozen=True)
class Effects:
    """The options for the effects of a link."""

    profile: ProfileOption = None
    delay: Delay = None
    jitter: Jitter = None
    loss: LossOption = None
    reorder: Reorder = None
    rate: Rate = None
    resend: Resend = None

    def compose(self, words: list[str] | None) -> LinkProfile:
        """Return the profile of these options and the words, which may be a profile's name.

        Raises NetemError: an option is not valid, or a setting is given twice.
        """
        text, profile, *effects = " ".join(words) if words else None, *astuple(self)
        if text is not None and (text in PRESETS or text in ALIASES) and profile is None:
            text, profile = None, text
        link = compose(text, profile, *effects)
        _print_notes(text)
        return link


@dataclass(frozen=True)
class Relaying:
    """Both directions of a relay, how they change, and how long it runs."""

    up: Up = None
    down: Down = None
    timeline: TimelineOption = None
    up_timeline: UpTimeline = None
    down_timeline: DownTimeline = None
    seed: Seed = 0
    duration: Duration = None
    json_to: JsonTo = None

    def directions(self, both: LinkProfile) -> tuple[LinkProfile, LinkProfile]:
        """Return the profiles of uplink and downlink. Raises NetemError: a profile is not valid."""
        return _direction("up", self.up, both), _direction("down", self.down, both)


class Mode(StrEnum):
    """The role of a Zenoh session in its network."""

    PEER = "peer"
    CLIENT = "client"


class Benchmark(StrEnum):
    """The parts of `netem bench`."""

    LATENESS = "lateness"
    CORE = "core"
    UDP = "udp"


@app.callback()
def before_any_command(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print versions for a bug report.", callback=versions("netem"), is_eager=True),
    ] = False,
) -> None:
    """Options before a command's name."""


@app.command()
def profiles(json_to: JsonTo = None) -> None:
    """List the named profiles. Their figures are for one direction."""
    if json_to is not None:
        output.write_json(dict(PRESETS), json_to)
    if json_to != "-":
        width = max(map(len, PRESETS))
        print(f"{'name':<{width}}  one direction, in tc-netem's syntax")
        for name, words in PRESETS.items():
            print(f"{name:<{width}}  {words or '(nothing)'}")


@app.command()
@grouped
def show(
    *,
    words: Words = None,
    effects: Effects,
    seed: Annotated[int, typer.Option(min=0, max=2**63 - 1, help="Seed of the link's draws.")] = 0,
    count: Annotated[int, typer.Option(min=1, max=10_000_000, help="Number of messages to send.")] = 20_000,
    interval: Annotated[str, typer.Option(help="Time between two messages.")] = "1ms",
    size: Annotated[int, typer.Option(min=0, help="Size of a message in bytes.")] = 100,
    png: Annotated[
        str | None, typer.Option(metavar="FILE", help="Write a figure: delays over time, histogram.")
    ] = None,
    json_to: JsonTo = None,
) -> None:
    """Print a profile and its effect on messages.

    It prints the profile as netem reads it, statistics of a stream of messages, and a histogram of their delays.
    """
    link_profile = effects.compose(words)
    interval_ns = units.parse_time("interval", interval)
    output.check_writable("--png", png)
    output.check_writable("--json", json_to)
    from netem import survey

    with Progress(sys.stderr, f"sending {count:,} messages") as progress:
        result = survey.run(link_profile, seed, count, interval_ns, size, progress=progress.at)
    if png is not None:
        from netem import plot

        plot.save(result, interval_ns, png)
    if json_to is not None:
        output.write_json(result.as_dict(), json_to)
    if json_to != "-":
        print("\n".join(survey.lines(link_profile, result)))


def _relays(kind: str) -> Callable[..., None]:
    """The command that relays UDP or TCP."""

    def command(
        *,
        listen: Annotated[str, typer.Option(metavar="A:P", help="Address that clients use; [::1]:P for IPv6.")],
        to: Annotated[str, typer.Option(metavar="B:P", help="Address where the server listens.")],
        words: Words = None,
        effects: Effects,
        relaying: Relaying,
    ) -> None:
        directions = relaying.directions(effects.compose(words))

        async def run(session: _Session) -> RelayFigures:
            from netem.relay import UdpRelay, format_address
            from netem.tcp_relay import TcpRelay

            async with (UdpRelay if kind == "udp" else TcpRelay)(listen, to, *directions, relaying.seed) as relay:
                return await session.serve(relay, f"{format_address(relay.address)} <-> {to}")

        _Session(relaying, connections=kind == "tcp").run(run)

    return grouped(command)


_BOTH = (
    "The words apply to both directions, unless --up or --down gives others. All clients share the link. A rate counts"
)
app.command(
    "udp",
    help=f"""Relay a UDP program's datagrams through a link.

    {_BOTH} the payload's size: 'rate 1mbit 28' adds the headers of IPv4 and UDP.
    """,
)(_relays("udp"))
app.command(
    "tcp",
    help=f"""Relay a TCP program's connections through a link.

    No byte is lost: what the link loses is sent again, as TCP does, and comes later. {_BOTH}
    the payload's size: 'rate 1mbit 40' adds the headers of IPv4 and TCP. In a timeline, 'at 5s: reset' resets all
    connections and 'at 5s: end' ends them in order.
    """,
)(_relays("tcp"))


@app.command()
@grouped
def zenoh(
    *,
    listen: Annotated[str, typer.Option(metavar="ENDPOINT", help="Where one network dials, as tcp/127.0.0.1:17448.")],
    connect: Annotated[str, typer.Option(metavar="ENDPOINT", help="Where the other network listens.")],
    words: Words = None,
    key: Annotated[str, typer.Option("-k", "--key", metavar="EXPR", help="Key expression to relay.")] = "**",
    mode: Annotated[Mode, typer.Option(help="Mode of the dialling session: client for a router.")] = Mode.PEER,
    effects: Effects,
    relaying: Relaying,
) -> None:
    """Relay between two Zenoh networks through a link.

    It relays puts and deletes with all their attributes, and liveliness tokens (these at once and without loss), but no
    queries. The words apply to both directions, unless --up or --down gives others.
    """
    directions = relaying.directions(effects.compose(words))

    async def run(session: _Session) -> RelayFigures:
        from netem.zenoh_relay import ZenohRelay

        relay = ZenohRelay(listen, connect, *directions, relaying.seed, key=key, mode=mode.value)
        try:
            await relay.open()
            return await session.serve(relay, f"{listen} <-> {connect}")
        finally:
            if not await relay.close():
                print("netem: Zenoh did not close in time", file=sys.stderr)

    _Session(relaying).run(run)


@app.command()
def bench(
    what: Annotated[list[Benchmark] | None, typer.Argument(help="Default: all.")] = None,
    runs: Annotated[int, typer.Option(min=1, help="Alternating runs of each kind; prints medians.")] = 5,
    seconds: Annotated[float, typer.Option(min=0.1, help="Length of a UDP run; a lateness run takes a third.")] = 10.0,
    rate: Annotated[int, typer.Option(min=1, help="UDP packets per second in each direction.")] = 20_000,
    json_to: JsonTo = None,
) -> None:
    """Measure lateness and throughput on this machine.

    It measures how late a link releases, how many messages per second it handles, and how many the UDP relay forwards.
    """
    output.check_writable("--json", json_to)
    from netem import bench as benchmarks

    found: dict[str, object] = {}
    out = sys.stderr if json_to == "-" else sys.stdout
    for part in what or list(Benchmark):
        if part is Benchmark.LATENESS:
            with Progress(sys.stderr, "measuring lateness", runs * seconds):
                lateness = benchmarks.lateness(runs, seconds / 3)
            found[part.value], lines = lateness.as_dict(), lateness.lines()
        elif part is Benchmark.CORE:
            with Progress(sys.stderr, "measuring the core"):
                core = benchmarks.core(runs)
            found[part.value], lines = core.as_dict(), core.lines()
        else:
            with Progress(sys.stderr, "measuring the UDP relay", seconds + 1.0):
                forwarded = benchmarks.udp(rate, seconds)
            found[part.value], lines = forwarded.as_dict(), forwarded.lines()
        print("\n".join(lines), file=out, flush=True)
    if json_to is not None:
        output.write_json(found, json_to)


class _Session:
    """One run of a relay: its timelines, its duration, and where its figures go."""

    def __init__(self, relaying: Relaying, connections: bool = False) -> None:
        from netem.timeline import Timeline

        given = (relaying.up_timeline or relaying.timeline, relaying.down_timeline or relaying.timeline)
        self._timelines = [None if text is None else Timeline.read(text, connections=connections) for text in given]
        self._seed, self._json_to = relaying.seed, relaying.json_to
        self._duration_s = None if relaying.duration is None else _seconds("--duration", relaying.duration)
        self._elapsed_s = 0.0
        self._out: TextIO = sys.stderr if self._json_to == "-" else sys.stdout
        output.check_writable("--json", self._json_to)

    def run(self, relay: Callable[[_Session], Coroutine[None, None, RelayFigures]]) -> None:
        """Run a relay to its end, then print its figures."""
        import asyncio

        from netem import live

        figures = asyncio.run(relay(self))
        live.print_table(figures, self._elapsed_s, self._out)
        if self._json_to is not None:
            output.write_json(figures.as_dict() | {"seed": self._seed, "elapsed_s": self._elapsed_s}, self._json_to)

    async def serve(self, relay: UdpRelay | TcpRelay | ZenohRelay, where: str) -> RelayFigures:
        """Let the relay run until it is stopped. Returns its last figures."""
        import time

        from netem import live

        print(f"netem: relaying {where}; Ctrl-C stops", file=self._out, flush=True)
        if relay.up.timer.kind != "timerfd":
            print("netem: no timerfd here: delayed messages leave up to 1 ms late", file=self._out, flush=True)
        started = time.monotonic()
        for direction, timeline in zip((relay.up, relay.down), self._timelines, strict=True):
            if timeline is not None:
                direction.play(timeline)
        figures = await live.show_until_stopped(lambda: relay.stats, self._out, self._duration_s)
        self._elapsed_s = time.monotonic() - started
        return figures


def main(argv: list[str] | None = None) -> int:
    """Run the command. Returns exit code 0, or 2 after one line on standard error if the input is wrong."""
    args = sys.argv[1:] if argv is None else argv
    if "_NETEM_COMPLETE" in os.environ:
        return _complete()
    try:
        code = app(args=args or ["--help"], prog_name="netem", standalone_mode=False)
        sys.stdout.flush()
    except NetemError as error:
        return output.fail(str(error))
    except BrokenPipeError:
        return output.unread()
    except SystemExit as error:
        if isinstance(error.__context__, BrokenPipeError):  # click makes this of it
            return output.unread()
        raise
    except (typer.Abort, KeyboardInterrupt):
        return 130
    except Exception as error:
        # click's errors: the module that defines them depends on typer's version
        format_message = getattr(error, "format_message", None)
        if format_message is None:
            raise
        context = getattr(error, "ctx", None)
        command = "netem" if context is None else context.command_path
        return output.fail(f"{format_message().rstrip('.')}; see {command} --help")
    return code if isinstance(code, int) else 0


def _complete() -> int:
    """Print the completions or the script that a shell requests by the environment, and nothing else."""
    warnings.simplefilter("ignore")
    with suppress(Exception):
        app(args=[], prog_name="netem", standalone_mode=False)
    return 1


def _direction(name: str, text: str | None, both: LinkProfile) -> LinkProfile:
    try:
        link = both if text is None else LinkProfile.named(text)
    except NetemError as error:
        raise NetemError(f"--{name}: {error}") from error
    _print_notes(text)
    return link


def _print_notes(text: str | None) -> None:
    for note in notes(text or ""):
        print(f"netem: {note}", file=sys.stderr)


def _seconds(name: str, text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = units.parse_time(name, text) * 1e-9
    if not 0 < seconds <= 1e9:
        raise NetemError(f"{name}: {text!r} is not allowed; allowed: seconds above 0, or a time such as 500ms")
    return seconds
