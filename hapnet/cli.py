"""The `hapnet` command: declarations only. What a command does is in `hapnet.commands`, imported when it runs."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from hapnet.commands import flags, output
from hapnet.commands.options import NO_LINK, LinkOptions, ZenohOptions, json_target, parameters, security
from hapnet.commands.replay import replay
from hapnet.errors import HapnetError, OutputError
from hapnet.params import Params
from netem.errors import NetemError

app = typer.Typer(
    name="hapnet",
    help="Passive haptics over bad networks: a haptic device and a virtual world, coupled by passive set-position "
    "modulation (PSPM) over Zenoh through an emulated lossy link. `hapnet run` shows it.",
    epilog="Exit codes: 0 all is well; 2 something given is wrong, or the run failed: one line says what; 3 the run "
    "went well, but what it was to write is not complete; 128 + N told to stop by signal N (Ctrl-C: 130).",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command()
def run(
    scene: flags.Scene = None,
    operator: flags.Operator = None,
    hardware: flags.Hardware = None,
    coupling: flags.Coupling = None,
    servo: flags.ServoKind = None,
    servo_hz: flags.ServoRate = None,
    dof: flags.Dof = None,
    duration: flags.Duration = None,
    on_silence: flags.OnSilence = None,
    silence_after: flags.SilenceAfter = None,
    seed: flags.Seed = 0,
    link: flags.Link = None,
    profile: flags.Profile = None,
    delay: flags.Delay = None,
    jitter: flags.Jitter = None,
    loss: flags.Loss = None,
    reorder: flags.Reorder = None,
    rate: flags.Rate = None,
    uplink: flags.Uplink = None,
    downlink: flags.Downlink = None,
    timeline: flags.TimelineText = None,
    up_timeline: flags.UpTimeline = None,
    down_timeline: flags.DownTimeline = None,
    params_file: flags.ParamsFile = None,
    assign: flags.Assign = None,
    show_params: flags.Show = False,
    json_to: flags.Json = None,
    out: flags.Out = None,
    realtime: flags.Realtime = False,
) -> int:
    """Both processes on this machine, over Zenoh: a hand presses a virtual wall over a link that delays and loses.

    Default: 10 s, a link with 40 ms delay, 10 ms jitter and 2 % loss each way.

    Writes two recordings, a report, its figure and a summary.
    """
    links = LinkOptions(
        link, profile, delay, jitter, loss, reorder, rate, uplink, downlink, timeline, up_timeline, down_timeline
    )
    params = parameters(
        Params(), file=params_file, assignments=assign or (), links=links, hardware=hardware, scene=scene,
        operator=operator, coupling=coupling, device__servo=servo, device__servo_hz=servo_hz, dof=dof,
        duration_s=duration, device__on_silence=on_silence, world__on_silence=on_silence,
        device__silence_after_s=silence_after, world__silence_after_s=silence_after,
    )  # fmt: skip
    if show_params:
        return _show(params)
    json_target(json_to)
    from hapnet.commands import run as command

    return command.main(params, seed, json_to, out, realtime=realtime)


@app.command()
def simulate(
    scene: flags.Scene = None,
    operator: flags.Operator = None,
    coupling: flags.Coupling = None,
    servo: flags.ServoKind = None,
    servo_hz: flags.ServoRate = None,
    dof: flags.Dof = None,
    duration: flags.Duration = None,
    on_silence: flags.OnSilence = None,
    silence_after: flags.SilenceAfter = None,
    seed: flags.Seed = 0,
    link: flags.Link = None,
    profile: flags.Profile = None,
    delay: flags.Delay = None,
    jitter: flags.Jitter = None,
    loss: flags.Loss = None,
    reorder: flags.Reorder = None,
    rate: flags.Rate = None,
    uplink: flags.Uplink = None,
    downlink: flags.Downlink = None,
    timeline: flags.TimelineText = None,
    up_timeline: flags.UpTimeline = None,
    down_timeline: flags.DownTimeline = None,
    params_file: flags.ParamsFile = None,
    assign: flags.Assign = None,
    show_params: flags.Show = False,
    json_to: flags.Json = None,
    out: flags.Out = None,
    files: Annotated[bool, typer.Option("--files/--no-files", help="Write recording, figure and summary.")] = True,
    seeds: Annotated[str | None, typer.Option(metavar="A:B", help="Many seeds, A to B - 1: a table, no files.")] = None,
    workers: Annotated[int, typer.Option(min=0, help="Processes for many seeds; 0: one a core.")] = 0,
) -> int:
    """The same in virtual time: one process, deterministic under a seed, much faster than real time."""
    links = LinkOptions(
        link, profile, delay, jitter, loss, reorder, rate, uplink, downlink, timeline, up_timeline, down_timeline
    )
    params = parameters(
        Params(), file=params_file, assignments=assign or (), links=links, scene=scene, operator=operator,
        coupling=coupling, device__servo=servo, device__servo_hz=servo_hz, dof=dof, duration_s=duration,
        device__on_silence=on_silence, world__on_silence=on_silence,
        device__silence_after_s=silence_after, world__silence_after_s=silence_after,
    )  # fmt: skip
    if show_params:
        return _show(params)
    json_target(json_to)
    from hapnet.commands import batch
    from hapnet.commands import simulate as command

    if seeds is not None:
        return batch.main(params, batch.seed_range(seeds), json_to, workers)
    return command.main(params, seed, json_to, out, files=files)


@app.command()
def device(
    scene: flags.Scene = None,
    operator: flags.Operator = None,
    hardware: flags.Hardware = None,
    coupling: flags.Coupling = None,
    servo: flags.ServoKind = None,
    servo_hz: flags.ServoRate = None,
    dof: flags.Dof = None,
    duration: flags.Duration = None,
    on_silence: flags.OnSilence = None,
    silence_after: flags.SilenceAfter = None,
    seed: flags.OwnSeed = None,
    session: flags.Session = "default",
    name: flags.Name = "device",
    record: flags.Record = None,
    mode: flags.Mode = None,
    connect: flags.Connect = None,
    listen: flags.Listen = None,
    config: flags.Config = None,
    no_multicast_scouting: flags.NoScouting = False,
    cfg: flags.Cfg = None,
    tls_ca: flags.TlsCa = None,
    tls_cert: flags.TlsCert = None,
    tls_key: flags.TlsKey = None,
    mutual_tls: flags.MutualTls = False,
    user: flags.User = None,
    password_file: flags.PasswordFile = None,
    users: flags.Users = None,
    link: flags.Link = None,
    profile: flags.Profile = None,
    delay: flags.Delay = None,
    jitter: flags.Jitter = None,
    loss: flags.Loss = None,
    reorder: flags.Reorder = None,
    rate: flags.Rate = None,
    timeline: flags.TimelineText = None,
    params_file: flags.ParamsFile = None,
    assign: flags.Assign = None,
    show_params: flags.Show = False,
    json_to: flags.Json = None,
    realtime: flags.Realtime = False,
    log_to: flags.Log = None,
    progress: flags.Progress = False,
) -> int:
    """The device's side only: a simulated device and hand, for two hosts. Start it before or after `hapnet world`."""
    links = LinkOptions(link, profile, delay, jitter, loss, reorder, rate, timeline=timeline)
    params = parameters(
        Params(link=NO_LINK, duration_s=0.0), file=params_file, assignments=assign or (), links=links,
        hardware=hardware, scene=scene, operator=operator, coupling=coupling, device__servo=servo,
        device__servo_hz=servo_hz, dof=dof, duration_s=duration, device__on_silence=on_silence,
        device__silence_after_s=silence_after,
    )  # fmt: skip
    who = security(tls_ca, tls_cert, tls_key, mutual_tls, user, password_file, users)
    zenoh = ZenohOptions(mode, connect, listen, config, no_multicast_scouting, cfg, who)
    return _side("device", params, zenoh, session, name, seed, record, json_to, show_params, realtime, log_to, progress)


@app.command()
def world(
    scene: flags.Scene = None,
    coupling: flags.Coupling = None,
    dof: flags.Dof = None,
    duration: flags.Duration = None,
    on_silence: flags.OnSilence = None,
    silence_after: flags.SilenceAfter = None,
    seed: flags.OwnSeed = None,
    session: flags.Session = "default",
    name: flags.Name = "device",
    record: flags.Record = None,
    mode: flags.Mode = None,
    connect: flags.Connect = None,
    listen: flags.Listen = None,
    config: flags.Config = None,
    no_multicast_scouting: flags.NoScouting = False,
    cfg: flags.Cfg = None,
    tls_ca: flags.TlsCa = None,
    tls_cert: flags.TlsCert = None,
    tls_key: flags.TlsKey = None,
    mutual_tls: flags.MutualTls = False,
    user: flags.User = None,
    password_file: flags.PasswordFile = None,
    users: flags.Users = None,
    link: flags.Link = None,
    profile: flags.Profile = None,
    delay: flags.Delay = None,
    jitter: flags.Jitter = None,
    loss: flags.Loss = None,
    reorder: flags.Reorder = None,
    rate: flags.Rate = None,
    timeline: flags.TimelineText = None,
    params_file: flags.ParamsFile = None,
    assign: flags.Assign = None,
    show_params: flags.Show = False,
    json_to: flags.Json = None,
    log_to: flags.Log = None,
    progress: flags.Progress = False,
) -> int:
    """The virtual world's side only, for two hosts. Start it before or after `hapnet device`."""
    links = LinkOptions(link, profile, delay, jitter, loss, reorder, rate, timeline=timeline)
    params = parameters(
        Params(link=NO_LINK, duration_s=0.0), file=params_file, assignments=assign or (), links=links, scene=scene,
        coupling=coupling, dof=dof, duration_s=duration, world__on_silence=on_silence,
        world__silence_after_s=silence_after,
    )  # fmt: skip
    who = security(tls_ca, tls_cert, tls_key, mutual_tls, user, password_file, users)
    zenoh = ZenohOptions(mode, connect, listen, config, no_multicast_scouting, cfg, who)
    return _side("world", params, zenoh, session, name, seed, record, json_to, show_params, False, log_to, progress)


@app.command()
def reproduce(
    figure: Annotated[str, typer.Argument(help="fig4, fig5 or fig6.")],
    duration: flags.Duration = None,
    seed: flags.Seed = 0,
    params_file: flags.ParamsFile = None,
    assign: flags.Assign = None,
    show_params: flags.Show = False,
    json_to: flags.Json = None,
    out: flags.Out = None,
) -> int:
    """The paper's Figures 4, 5 and 6, simulated with Section 4's numbers (its lost digits reconstructed)."""
    from hapnet.commands import reproduce as command

    base = Params().set(command.SECTION_4)
    if figure == "fig6":
        base = base.set({"device.smoothing_s": command.SMOOTHING_S})
    params = parameters(base, file=params_file, assignments=assign or (), duration_s=duration)
    if show_params:
        return _show(params)
    json_target(json_to)
    return command.main(figure, params, seed, json_to, out)


@app.command()
def report(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="One recording, or the device's and the world's.")
    ],
    json_to: flags.Json = None,
    out: Annotated[Path | None, typer.Option(help="Directory for what is written.", show_default="beside FILE")] = None,
) -> int:
    """One or two recordings as a page (HTML), figures and a summary; a torn one is repaired into a copy beside it."""
    json_target(json_to)
    from hapnet.commands import report as command

    return command.main(files, json_to, out)


app.command()(replay)


@app.command()
def bench(
    only: Annotated[
        str | None, typer.Option(metavar="NAME[,NAME]", help="Rows to measure, patterns too: servo_*,device_tick.")
    ] = None,
    seconds: Annotated[float, typer.Option(help="Length of a round [s].")] = 3.0,
    rounds: Annotated[int, typer.Option(help="Figures are medians over so many rounds.")] = 3,
    realtime: flags.Realtime = False,
    beside: Annotated[int, typer.Option(help="Busy processes beside servo_traffic.")] = 0,
    json_to: flags.Json = None,
    out: Annotated[
        Path | None, typer.Option(help="Directory for all that is written.", show_default="runs/<UTC time>-bench")
    ] = None,
) -> int:
    """What the servo, the message path and the simulation cost on this machine, each beside a bare reference.

    Writes a table, bench.json and a figure of the histograms. The default takes two minutes; --seconds 60 --rounds 5 is
    for figures to publish.
    """
    json_target(json_to)
    from hapnet.commands import bench as command

    return command.main(only, seconds, rounds, realtime, beside, json_to, out)


@app.command()
def doctor(
    connect: flags.Connect = None,
    tls_ca: flags.TlsCa = None,
    tls_cert: flags.TlsCert = None,
    tls_key: flags.TlsKey = None,
    mutual_tls: flags.MutualTls = False,
    user: flags.User = None,
    password_file: flags.PasswordFile = None,
    json_to: flags.Json = None,
) -> int:
    """What this machine allows a servo to do, and what to do about what it does not; with -e, whether Zenoh answers."""
    json_target(json_to)
    from hapnet.commands import doctor as command

    who = security(tls_ca, tls_cert, tls_key, mutual_tls, user, password_file)
    return command.main(connect or [], json_to, who)


def main(argv: list[str] | None = None) -> int:
    """Run the command; its exit code, with one line on standard error where that is 2 or 3."""
    args = sys.argv[1:] if argv is None else argv
    if "" not in sys.path:
        sys.path.append("")  # module:Class is looked up from the current directory too
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
        output.silence(sys.stdout)  # who read our output has gone
        return 141
    except Exception as error:
        # click's own errors: which module defines them depends on typer's version
        format_message = getattr(error, "format_message", None)
        if format_message is None:
            raise
        return _fail(format_message())
    return code if isinstance(code, int) else 0


def _side(
    role: str,
    params: Params,
    zenoh: ZenohOptions,
    session: str,
    name: str,
    seed: int | None,
    record: Path | None,
    json_to: str | None,
    show_params: bool,
    realtime: bool,
    log_to: str | None,
    progress: bool,
) -> int:
    if show_params:
        return _show(params)
    json_target(json_to)
    from hapnet.commands import side

    return side.main(
        params,
        side.SideOptions(
            role="device" if role == "device" else "world",
            zenoh=side.zenoh_settings(zenoh),
            session=session,
            name=name,
            seed=seed,
            record=record,
            realtime=realtime,
            json_to=json_to,
            log_to=log_to,
            progress=progress,
        ),
    )


def _show(params: Params) -> int:
    print(params.toml(), end="")
    return 0


def _fail(line: str, code: int = 2) -> int:
    with suppress(OSError):  # a closed terminal
        print(f"hapnet: {line}", file=sys.stderr)
    return code
