"""The output of a running relay: a table on a terminal, one line per second in a pipe, and a table at the end."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Protocol, TextIO

if TYPE_CHECKING:
    from rich.table import Table

    from netem.stats import LinkStats

LINE_EVERY_S = 1.0
REDRAW_EVERY_S = 0.25


class RelayFigures(Protocol):
    """The common statistics of both relays."""

    @property
    def up(self) -> LinkStats: ...
    @property
    def down(self) -> LinkStats: ...
    def as_dict(self) -> dict[str, object]: ...


async def show_until_stopped(
    figures: Callable[[], RelayFigures], out: TextIO, duration_s: float | None = None
) -> RelayFigures:
    """Show the result of `figures` on `out` until SIGINT, SIGTERM or the end of `duration_s`. Returns the last result.

    Must be called on the main thread's loop.
    """
    loop = asyncio.get_running_loop()
    stopped = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stopped.set)
    started = time.monotonic()
    try:
        if out.isatty():
            await _redraw(figures, out, stopped, started, duration_s)
        else:
            while not await _wait(stopped, LINE_EVERY_S, started, duration_s):
                out.write(line(time.monotonic() - started, figures()) + "\n")
                out.flush()
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)
    return figures()


def print_table(figures: RelayFigures, elapsed_s: float, out: TextIO) -> None:
    """Print the final table."""
    from rich.console import Console

    Console(file=out, highlight=False, width=None if out.isatty() else 100).print(table(figures, elapsed_s))


def line(elapsed_s: float, figures: RelayFigures) -> str:
    """One line with the most important figures."""
    directions = (f"{name} {_direction(stats)}" for name, stats in (("up", figures.up), ("down", figures.down)))
    return (
        f"{elapsed_s:8.1f} s  " + "  |  ".join(directions) + "".join(f"  {k} {v}" for k, v in _alarms(figures).items())
    )


def table(figures: RelayFigures, elapsed_s: float) -> Table:
    """All figures, with one column per direction."""
    from rich import box
    from rich.table import Table

    out = Table(title=f"after {elapsed_s:.1f} s", title_justify="left", box=box.SIMPLE_HEAD)
    out.add_column("")
    out.add_column("up", justify="right", min_width=14)
    out.add_column("down", justify="right", min_width=14)
    for label, text in _ROWS.items():
        out.add_row(label, text(figures.up), text(figures.down))
    out.caption = "  ".join(f"{name} {value}" for name, value in _others(figures).items())
    out.caption_justify = "left"
    return out


def _share(part: int, stats: LinkStats) -> str:
    return f"{part} ({100 * part / stats.offered:.2f} %)" if stats.offered else str(part)


def _ms(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f} ms"


_ROWS: Mapping[str, Callable[[LinkStats], str]] = {
    "profile": lambda s: s.profile or "(nothing)",
    "offered": lambda s: str(s.offered),
    "delivered": lambda s: _share(s.delivered, s),
    "lost": lambda s: _share(s.lost, s),
    "resent": lambda s: str(s.resent),
    "recovered": lambda s: _share(s.recovered, s),
    "lost while down": lambda s: str(s.lost_down),
    "dropped over limit": lambda s: str(s.dropped_limit),
    "corrupted": lambda s: str(s.corrupted),
    "duplicated": lambda s: _share(s.duplicated, s),
    "reordered": lambda s: _share(s.reordered, s),
    "in flight": lambda s: str(s.in_flight),
    "delay mean": lambda s: _ms(s.delay_mean_ms),
    "delay std": lambda s: _ms(s.delay_std_ms),
    "delay p50": lambda s: _ms(s.delay_p50_ms),
    "delay p99": lambda s: _ms(s.delay_p99_ms),
}


def _direction(stats: LinkStats) -> str:
    not_delivered = stats.lost + stats.lost_down + stats.dropped_limit
    share = f"{100 * not_delivered / stats.offered:.2f} %" if stats.offered else "-"
    return f"in {stats.offered} out {stats.delivered} lost {share} p50 {_ms(stats.delay_p50_ms)}"


def _others(figures: RelayFigures) -> dict[str, object]:
    others = {name: value for name, value in figures.as_dict().items() if name not in ("up", "down")}
    return {name.replace("_", " "): value for name, value in others.items()}


def _alarms(figures: RelayFigures) -> dict[str, object]:
    """Messages that the relay itself dropped, if any."""
    return {name: value for name, value in _others(figures).items() if "drop" in name and value}


async def _redraw(
    figures: Callable[[], RelayFigures],
    out: TextIO,
    stopped: asyncio.Event,
    started: float,
    duration_s: float | None,
) -> None:
    from rich.console import Console
    from rich.live import Live

    with Live(console=Console(file=out), auto_refresh=False, transient=True) as live:
        while not await _wait(stopped, REDRAW_EVERY_S, started, duration_s):
            live.update(table(figures(), time.monotonic() - started), refresh=True)


async def _wait(stopped: asyncio.Event, seconds: float, started: float, duration_s: float | None) -> bool:
    """Wait `seconds`, or until the run ends if that is earlier. Returns whether it has ended."""
    if duration_s is not None:
        seconds = min(seconds, max(0.0, started + duration_s - time.monotonic()))
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(stopped.wait(), seconds)
    return stopped.is_set() or (duration_s is not None and time.monotonic() - started >= duration_s)
