"""The `netem` command."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from netem.errors import NetemError
from netem.profile import PRESETS, LinkProfile, compose

if TYPE_CHECKING:
    from netem.survey import Survey

app = typer.Typer(
    name="netem",
    help="A link emulator with the words of Linux's tc-netem: no root, no kernel module, the same seed the same link.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

Words = Annotated[str | None, typer.Argument(help="tc-netem's words, such as 'delay 40ms 10ms loss gemodel 1% 20%'.")]
Profile = Annotated[str | None, typer.Option(help="A named profile instead; `netem profiles` lists them.")]
Delay = Annotated[str | None, typer.Option(help="Delay, such as 40ms.")]
Jitter = Annotated[str | None, typer.Option(help="Jitter [correlation], such as 10ms or '10ms 25%'.")]
LossOption = Annotated[str | None, typer.Option(help="Loss, such as 2% or 'gemodel 1% 20%'.")]
Reorder = Annotated[str | None, typer.Option(help="Reordering, such as 5% or '25% 50% gap 5'.")]
Rate = Annotated[str | None, typer.Option(help="Rate, such as 1mbit.")]
JsonTo = Annotated[str | None, typer.Option("--json", metavar="FILE|-", help="Write the result as JSON; - is stdout.")]


@app.command()
def profiles(json_to: JsonTo = None) -> None:
    """List the named profiles. Their figures are for one direction."""
    if json_to is not None:
        _write_json(dict(PRESETS), json_to)
    if json_to != "-":
        width = max(map(len, PRESETS))
        print(f"{'name':<{width}}  one direction, in tc-netem's words")
        for name, words in PRESETS.items():
            print(f"{name:<{width}}  {words or '(nothing)'}")


@app.command()
def show(
    words: Words = None,
    profile: Profile = None,
    delay: Delay = None,
    jitter: Jitter = None,
    loss: LossOption = None,
    reorder: Reorder = None,
    rate: Rate = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the link's draws.")] = 0,
    count: Annotated[int, typer.Option(min=1, max=10_000_000, help="Messages to send through it.")] = 20_000,
    interval: Annotated[str, typer.Option(help="Time between two messages.")] = "1ms",
    size: Annotated[int, typer.Option(min=0, help="Size of a message in bytes.")] = 100,
    json_to: JsonTo = None,
) -> None:
    """Print a profile as understood, and what it does to a stream of messages: statistics and a histogram of delays."""
    link_profile = compose(words, profile, delay, jitter, loss, reorder, rate)
    from netem import survey, units

    result = survey.run(link_profile, seed, count, units.parse_time("interval", interval), size)
    if json_to is not None:
        _write_json(result.as_dict(), json_to)
    if json_to != "-":
        _print_survey(link_profile, result)


def main(argv: list[str] | None = None) -> int:
    """Run the command; the exit code is 0, or 2 after one line on standard error where the input is wrong."""
    args = sys.argv[1:] if argv is None else argv
    try:
        code = app(args=args or ["--help"], prog_name="netem", standalone_mode=False)
    except NetemError as error:
        return _fail(str(error))
    except typer.Abort:
        return 130
    except Exception as error:
        # click's own errors: which module defines them depends on typer's version
        format_message = getattr(error, "format_message", None)
        if format_message is None:
            raise
        return _fail(format_message())
    return code if isinstance(code, int) else 0


def _fail(message: str) -> int:
    print(f"netem: {' '.join(message.split())}", file=sys.stderr)
    return 2


def _write_json(result: object, target: str) -> None:
    text = json.dumps(result, indent=2)
    if target == "-":
        print(text)
        return
    try:
        Path(target).write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise NetemError(f"--json: cannot write {target}: {error.strerror}") from error


def _print_survey(profile: LinkProfile, result: Survey) -> None:
    stats = result.stats
    print(f"profile    {stats.profile or '(nothing)'}")
    print(f"offered    {stats.offered}")
    share = 100.0 / stats.offered
    print(f"delivered  {stats.delivered} ({stats.delivered * share:.2f} %)")
    print(f"lost       {stats.lost} ({stats.lost * share:.2f} %), longest burst {result.longest_loss}")
    if stats.dropped_limit:
        print(f"dropped    {stats.dropped_limit} ({stats.dropped_limit * share:.2f} %): over limit {profile.limit}")
    ahead = f", {stats.sent_ahead} sent ahead" if profile.reorder else ""
    print(f"reordered  {stats.reordered} ({stats.reordered * share:.2f} %){ahead}")
    if stats.delivered:
        print(
            f"delay      mean {stats.delay_mean_ms:.3f} ms, standard deviation {result.delay_std_ms or 0.0:.3f} ms, "
            f"p50 {stats.delay_p50_ms:.3f} ms, p99 {stats.delay_p99_ms:.3f} ms"
        )
        print(f"           lag-1 correlation {result.delay_correlation or 0.0:.3f}")
    if len(result.edges_ms) > 2:
        most = max(result.counts)
        for low, number in zip(result.edges_ms, result.counts, strict=False):
            print(f"{low:10.3f} ms {'#' * round(50 * number / most):<50} {number}")
