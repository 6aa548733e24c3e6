"""The `hapnet` command: declarations only. `hapnet.commands` does the work; each part is imported when it runs."""

from __future__ import annotations

import io
import os
import sys
import warnings
from contextlib import redirect_stdout, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapnet.commands import compare as compare_command
from hapnet.commands import compare_plan, complete, devices, export, flags, output, overview, sweep, transparency, tune
from hapnet.commands.groups import Without, grouped
from hapnet.commands.options import (
    NO_LINK,
    Dialling,
    LinkOptions,
    ModelOptions,
    OneWay,
    PageOptions,
    ParamsOptions,
    SideFlags,
    ZenohOptions,
    json_target,
)
from hapnet.errors import HapnetError, InvalidParameter, OutputError
from hapnet.params import Params
from netem.errors import NetemError

if TYPE_CHECKING:
    from hapnet.wire.messages import Role

app: typer.Typer = overview.program()
app.add_typer(sweep.app, name="sweep")


@app.command()
@grouped
def run(
    *,
    model: ModelOptions,
    seed: flags.Seed = 0,
    links: LinkOptions,
    params: ParamsOptions,
    json_to: flags.Json = None,
    out: flags.Out = None,
    verbose: flags.Verbose = False,
    files: flags.Files = True,
    log_to: flags.Log = None,
    realtime: flags.Realtime = False,
) -> int:
    """Run both processes on this machine, over Zenoh: a hand presses a virtual wall over a link with delay and loss.

    By default for 10 s, with 40 ms delay, 10 ms jitter and 2 % loss each way.

    Writes two recordings, a report, its figure and a summary.
    """
    chosen = params.over(Params(), model.named("device", "world"), links)
    if params.show_params:
        return _show(params.shown(chosen))
    json_target(json_to)
    from hapnet.commands import run as command

    options = command.RunOptions(seed, json_to, _directory(out, files), files, log_to, realtime, verbose)
    return command.main(chosen, options)


@app.command()
@grouped
def simulate(
    *,
    model: Annotated[ModelOptions, Without("hardware")],
    seed: flags.Seed = 0,
    links: LinkOptions,
    params: ParamsOptions,
    json_to: flags.Json = None,
    out: flags.Out = None,
    verbose: flags.Verbose = False,
    files: flags.Files = True,
    seeds: Annotated[str | None, typer.Option(metavar="A:B", help="Many seeds, A to B - 1: a table, no files.")] = None,
    workers: Annotated[int, typer.Option(min=0, help="Processes for many seeds; 0: one per core.")] = 0,
) -> int:
    """Simulate both sides in virtual time: in one process, deterministic for a seed, much faster than real time."""
    chosen = params.over(Params(), model.named("device", "world"), links)
    if params.show_params:
        return _show(params.shown(chosen))
    json_target(json_to)
    from hapnet.commands import batch
    from hapnet.commands import simulate as command

    if seeds is not None:
        if out is not None:
            raise InvalidParameter("--out", str(out), "no --out with --seeds, which writes no files but --json FILE")
        return batch.main(chosen, batch.seed_range(seeds), json_to, workers)
    return command.main(chosen, seed, json_to, _directory(out, files), files=files, verbose=verbose)


@app.command()
@grouped
def play(
    *,
    model: Annotated[ModelOptions, Without("operator", "hardware", "duration")],
    seed: flags.Seed = 0,
    links: LinkOptions,
    params: ParamsOptions,
    out: Annotated[
        Path | None, typer.Option(help="Directory for recordings.", show_default="runs/<UTC time>-<seed>")
    ] = None,
    realtime: flags.Realtime = False,
    page: PageOptions,
) -> int:
    """Feel it on a live page, with the mouse as the hand. Both processes run on this machine, as in `hapnet run`.

    Drag the handle into the wall, make the link worse, or choose another coupling and see it shake: `zoh` has no PSPM.
    Each coupling is a new pair, with a verdict of its own. The page says what the force is made of, and can also pause,
    restart and record. The hand is a relaxed one unless `operator_hand` is set.
    """
    chosen = params.over(Params(), model.named("device", "world"), links)
    from hapnet.commands import play as command

    chosen = command.led(chosen)
    if params.show_params:
        return _show(params.shown(chosen))
    return command.main(chosen, seed, out, page, realtime=realtime)


@app.command()
@grouped
def view(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FILE]", help="A recording to play back, or the device's and the world's."),
    ] = None,
    *,
    session: Annotated[str | None, typer.Option(help="Name of the session.", show_default="the first heard")] = None,
    name: Annotated[str | None, typer.Option(help="Name of the device.", show_default="the first heard")] = None,
    zenoh: Annotated[ZenohOptions, Without("users", "mutual_tls", "encrypt")],
    page: PageOptions,
) -> int:
    """Watch a pair that runs elsewhere on a live page, without disturbing it: `hapnet view -e tcp/HOST:17447`.

    Dial the side that listens. Its access control decides what others may see. With a recording
    (`hapnet view run.mcap`) the page plays it back, again and again.
    """
    from hapnet.commands import view as command

    if files:
        if session or name or zenoh.connect or zenoh.listen or zenoh.config:
            raise InvalidParameter("FILE", [str(file) for file in files], "left out where a running pair is watched")
        return command.play_back(files, page)
    return command.main(zenoh, session, name, page)


@app.command()
@grouped
def device(*, model: ModelOptions, side: SideFlags, zenoh: ZenohOptions, links: OneWay, params: ParamsOptions) -> int:
    """Run the device's side only, for two hosts: simulated device and hand. Start it before or after `hapnet world`."""
    return _side("device", model, side, zenoh, links, params)


@app.command()
@grouped
def world(
    *,
    model: Annotated[ModelOptions, Without("operator", "hardware", "servo", "servo_hz")],
    side: Annotated[SideFlags, Without("realtime")],
    zenoh: ZenohOptions,
    links: OneWay,
    params: ParamsOptions,
) -> int:
    """Run the virtual world's side only, for two hosts. Start it before or after `hapnet device`."""
    return _side("world", model, side, zenoh, links, params)


@app.command()
@grouped
def reproduce(
    *,
    figure: flags.Figure,
    duration: flags.Duration = None,
    seed: flags.Seed = 0,
    params: ParamsOptions,
    json_to: flags.Json = None,
    out: flags.Out = None,
    verbose: flags.Verbose = False,
) -> int:
    """Simulate the paper's Figures 4, 5 and 6, with the numbers of its Section 4 (lost digits reconstructed)."""
    from hapnet.commands import reproduce as command

    base = Params().set(command.SECTION_4)
    if figure == "fig6":
        base = base.set({"device.smoothing_s": command.SMOOTHING_S})
    chosen = params.over(base, {"duration_s": duration})
    if params.show_params:
        return _show(params.shown(chosen))
    json_target(json_to)
    return command.main(figure, chosen, seed, json_to, out, verbose=verbose)


@app.command()
@grouped
def replay(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE", help="One recording, or the device's and the world's.")
    ],
    *,
    model: Annotated[
        ModelOptions,
        Without("operator", "hardware", "servo", "servo_hz", "dof", "on_silence", "silence_after"),
    ],
    seed: flags.ReplaySeed = None,
    links: LinkOptions,
    params: Annotated[ParamsOptions, Without("show_params", "schema")],
    json_to: flags.Json = None,
    out: flags.Out = None,
    verbose: flags.Verbose = False,
) -> int:
    """Repeat a recorded run in virtual time: as it was, or with the same hand and another link or coupling.

    Parameters and seed are the recording's, except those given here. Writes recording, figures and summary.
    """
    json_target(json_to)
    from hapnet.commands import replay as command

    def chosen(base: Params) -> Params:
        return params.over(links.for_all_of(base), model.named(), links)

    return command.main(files, chosen, seed, json_to, out, verbose=verbose)


@app.command()
def report(
    files: flags.Recorded,
    json_to: flags.Json = None,
    out: Annotated[Path | None, typer.Option(help="Directory for output files.", show_default="beside FILE")] = None,
    verbose: flags.Verbose = False,
) -> int:
    """Turn one or two recordings into a page (HTML), figures and a summary. A torn one gets a repaired copy."""
    json_target(json_to)
    from hapnet.commands import report as command

    return command.main(files, json_to, out, verbose=verbose)


@app.command()
@grouped
def compare(
    *,
    options: compare_command.CompareOptions,
    model: Annotated[
        ModelOptions,
        Without("operator", "hardware", "coupling", "deadband", "servo", "servo_hz", "on_silence", "silence_after"),
    ],
    params: ParamsOptions,
    json_to: flags.Json = None,
    out: Annotated[
        Path | None, typer.Option(help="Directory for all output files.", show_default="runs/<UTC time>-compare")
    ] = None,
) -> int:
    """Compare couplings over the same links, hands and seeds, in virtual time: which are passive, how transparent.

    Prints one table per link. Writes all cases as JSON, the traces of one case and a figure of all cases.
    """
    chosen = params.over(compare_plan.BASE, model.named())
    if params.show_params:
        return _show(params.shown(chosen))
    json_target(json_to)
    return compare_command.main(chosen, options, json_to, out)


app.command()(export.export)
app.command()(transparency.transparency)
app.command()(tune.tune)
app.command()(devices.devices)
app.command()(devices.emulate)


@app.command()
def bench(
    only: flags.Only = None,
    seconds: Annotated[float, typer.Option(help="Length of a round, in seconds.")] = 3.0,
    rounds: Annotated[int, typer.Option(help="Number of rounds; figures are medians over them.")] = 3,
    realtime: flags.Realtime = False,
    beside: Annotated[int, typer.Option(help="Number of busy processes during servo_traffic.")] = 0,
    json_to: flags.Json = None,
    out: Annotated[
        Path | None, typer.Option(help="Directory for all output files.", show_default="runs/<UTC time>-bench")
    ] = None,
) -> int:
    """Measure what the servo, the message path and the simulation cost here, each beside a bare reference.

    Prints a table; writes bench.json and a figure of the histograms. The default takes three minutes; use
    --seconds 60 --rounds 5 for figures to publish.
    """
    json_target(json_to)
    from hapnet.commands import bench as command

    return command.main(only, seconds, rounds, realtime, beside, json_to, out)


@app.command()
@grouped
def doctor(
    *,
    zenoh: Dialling,
    session: flags.Session = "default",
    name: flags.Name = "device",
    hardware: flags.Hardware = None,
    dof: flags.Dof = None,
    ramp: Annotated[float, typer.Option(metavar="N", help="With --device: press the hand on it by up to N.")] = 0.0,
    damping: Annotated[
        float, typer.Option(metavar="N", help="With --device: push its free handle by N, to measure its own damping.")
    ] = 0.0,
    json_to: flags.Json = None,
) -> int:
    """Check what this machine allows a servo to do, and say how to allow the rest.

    With -e, also check whether Zenoh answers there, and measure the network: a side that listens there answers probes.
    With --device, measure that device instead: rate, latency, noise and resolution; --ramp and --damping use a force.
    """
    json_target(json_to)
    from hapnet.commands import doctor as command

    if hardware is not None:
        return command.examine_device(hardware, dof or 1, ramp, damping, json_to)
    if force := ramp or damping:
        raise InvalidParameter("--ramp" if ramp else "--damping", force, "given together with --device")
    return command.main(zenoh.connect or [], json_to, zenoh.security, session, name)


def main(argv: list[str] | None = None) -> int:
    """Run the command; returns its exit code, and prints one line on standard error if that is 2, 3 or 4."""
    args = sys.argv[1:] if argv is None else argv
    if "" not in sys.path:
        sys.path.append("")  # module:Class is looked up from the current directory too
    if "_HAPNET_COMPLETE" in os.environ:
        return _complete()
    try:
        code = app(args=args or ["--help"], prog_name="hapnet", standalone_mode=False)
    except OutputError as error:
        return _fail(str(error), 3)
    except (HapnetError, NetemError) as error:
        return _fail(str(error))
    except typer.Abort:
        return 130
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        raise  # `output.unless_closed` has it
    except OSError as error:
        if error.filename is None:
            raise
        return _fail(f"{error.filename}: {error.strerror}")
    except Exception as error:
        # click's own errors: which module defines them depends on typer's version
        format_message = getattr(error, "format_message", None)
        if format_message is None:
            raise
        context = getattr(error, "ctx", None)
        asked = "hapnet" if context is None else context.command_path
        return _fail(f"{format_message().rstrip('.')}; see {asked} --help")
    finally:
        output.remove_empty()
    return code if isinstance(code, int) else 0


def _complete() -> int:
    """Answer a shell's question, after TAB or for its script: the environment holds it. Print nothing else."""
    warnings.simplefilter("ignore")
    offered = io.StringIO()
    code, glued = 1, False
    with suppress(Exception):
        glued = os.environ["_HAPNET_COMPLETE"] == "complete_bash" and complete.glue()
        try:
            with redirect_stdout(offered):
                app(args=[], prog_name="hapnet", standalone_mode=False)
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 0
    print(complete.behind(offered.getvalue()) if glued else offered.getvalue(), end="")
    return code


def _side(
    role: Role, model: ModelOptions, given: SideFlags, zenoh: ZenohOptions, links: LinkOptions, params: ParamsOptions
) -> int:
    chosen = params.over(Params(link=NO_LINK, duration_s=0.0), model.named(role), links)
    if params.show_params:
        return _show(params.shown(chosen))
    json_target(given.json_to)
    _directory(given.out, given.files)
    from hapnet.commands import side

    return side.main(chosen, side.SideOptions(role=role, zenoh=side.zenoh_settings(zenoh), **vars(given)))


def _directory(out: Path | None, files: bool) -> Path | None:
    if out is not None and not files:
        raise InvalidParameter("--out", str(out), "no --out with --no-files")
    return out


def _show(text: str) -> int:
    try:
        print(text, end="", flush=True)
    except BrokenPipeError:
        raise
    except OSError as error:  # a full disk
        output.silence(sys.stdout)
        raise OutputError(f"cannot write standard output: {error.strerror or error}") from None
    return 0


def _fail(line: str, code: int = 2) -> int:
    with suppress(OSError):  # a closed terminal
        print(f"hapnet: {line}", file=sys.stderr)
    return code
