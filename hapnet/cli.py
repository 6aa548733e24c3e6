"""The `hapnet` command: declarations only. What a command does is in `hapnet.commands`, imported when it runs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from hapnet.commands.options import NO_LINK, LinkOptions, json_target, parameters
from hapnet.errors import HapnetError
from hapnet.params import Params
from netem.errors import NetemError

app = typer.Typer(
    name="hapnet",
    help="Passive haptics over bad networks: a haptic device and a virtual world, coupled by passive set-position "
    "modulation (PSPM) over Zenoh through an emulated lossy link. `hapnet run` shows it.",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

_LINK = "Link, emulated"
_ZENOH = "Zenoh"
_PARAMS = "Parameters"

Scene = Annotated[str | None, typer.Option(help="free, wall, box, paper, or module:Class.")]
Operator = Annotated[str | None, typer.Option(help="The hand: rest, sine, press, or a recorded motion's path (.csv).")]
Hardware = Annotated[
    str | None,
    typer.Option("--device", metavar="MODULE:CLASS", help="A device of your own instead of the simulated one."),
]
Coupling = Annotated[str | None, typer.Option(help="pspm, or zoh: a plain virtual coupling, not passive.")]
ServoKind = Annotated[
    str | None, typer.Option("--servo", help="sampled (as on hardware) or continuous (as in theory).")
]
ServoRate = Annotated[float | None, typer.Option("--servo-hz", help="Rate of the servo; 1000 by default.")]
Duration = Annotated[float | None, typer.Option(help="Seconds from pairing; 0: until Ctrl-C.")]
Dof = Annotated[int | None, typer.Option(help="Degrees of freedom, 1 to 3; the scene's own by default.")]
Seed = Annotated[int, typer.Option(min=0, help="Of everything random.")]
OwnSeed = Annotated[int | None, typer.Option("--seed", min=0, help="Of this side's link and steps; drawn by default.")]
ParamsFile = Annotated[
    Path | None,
    typer.Option("--params", help="TOML file of parameters, as --show-params prints.", rich_help_panel=_PARAMS),
]
Assign = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Set one: world.wall.stiffness=30000.", rich_help_panel=_PARAMS),
]
Show = Annotated[bool, typer.Option("--show-params", help="Print all parameters and end.", rich_help_panel=_PARAMS)]
Json = Annotated[str | None, typer.Option("--json", metavar="FILE|-", help="Summary as JSON; -: alone on stdout.")]
Out = Annotated[
    Path | None, typer.Option(help="Directory for all that is written.", show_default="runs/<UTC time>-<seed>")
]
Realtime = Annotated[
    bool,
    typer.Option(
        "--realtime", help="The servo in a process of its own, under SCHED_FIFO and in locked memory where allowed."
    ),
]

Link = Annotated[
    str | None,
    typer.Option("--link", metavar="'TC WORDS'", help="tc-netem's words, or a profile.", rich_help_panel=_LINK),
]
Profile = Annotated[str | None, typer.Option(help="A named profile (`netem profiles`).", rich_help_panel=_LINK)]
Delay = Annotated[str | None, typer.Option(help="Delay, such as 40ms.", rich_help_panel=_LINK)]
Jitter = Annotated[str | None, typer.Option(help="Jitter, such as 10ms.", rich_help_panel=_LINK)]
Loss = Annotated[str | None, typer.Option(help="Loss, such as 2% or 'gemodel 1% 20%'.", rich_help_panel=_LINK)]
Reorder = Annotated[str | None, typer.Option(help="Reordering, such as 5%.", rich_help_panel=_LINK)]
Rate = Annotated[str | None, typer.Option(help="Rate, such as 1mbit.", rich_help_panel=_LINK)]
Uplink = Annotated[str | None, typer.Option(help="From the device only: tc words or a profile.", rich_help_panel=_LINK)]
Downlink = Annotated[
    str | None, typer.Option(help="From the world only: tc words or a profile.", rich_help_panel=_LINK)
]

Mode = Annotated[str | None, typer.Option("-m", "--mode", help="peer, client or router.", rich_help_panel=_ZENOH)]
Connect = Annotated[
    list[str] | None,
    typer.Option(
        "-e", "--connect", metavar="ENDPOINT", help="Dial, such as tcp/192.168.0.2:17447.", rich_help_panel=_ZENOH
    ),
]
Listen = Annotated[
    list[str] | None,
    typer.Option(
        "-l", "--listen", metavar="ENDPOINT", help="Listen, such as tcp/0.0.0.0:17447.", rich_help_panel=_ZENOH
    ),
]
Config = Annotated[str | None, typer.Option("-c", "--config", help="Zenoh configuration file.", rich_help_panel=_ZENOH)]
NoScouting = Annotated[
    bool, typer.Option("--no-multicast-scouting", help="Do not look for peers by multicast.", rich_help_panel=_ZENOH)
]
Cfg = Annotated[
    list[str] | None, typer.Option("--cfg", metavar="KEY:JSON5", help="Override one key.", rich_help_panel=_ZENOH)
]
Session = Annotated[str, typer.Option(help="Name of the session, the same on both sides.")]
Name = Annotated[str, typer.Option(help="Name of the device, the same on both sides.")]
Record = Annotated[Path | None, typer.Option(help="Record this side to an MCAP file.")]
Events = Annotated[bool, typer.Option("--events", hidden=True)]


@app.command()
def run(
    scene: Scene = None,
    operator: Operator = None,
    hardware: Hardware = None,
    coupling: Coupling = None,
    servo: ServoKind = None,
    servo_hz: ServoRate = None,
    dof: Dof = None,
    duration: Duration = None,
    seed: Seed = 0,
    link: Link = None,
    profile: Profile = None,
    delay: Delay = None,
    jitter: Jitter = None,
    loss: Loss = None,
    reorder: Reorder = None,
    rate: Rate = None,
    uplink: Uplink = None,
    downlink: Downlink = None,
    params_file: ParamsFile = None,
    assign: Assign = None,
    show_params: Show = False,
    json_to: Json = None,
    out: Out = None,
    realtime: Realtime = False,
) -> int:
    """Both processes on this machine, over Zenoh: a hand presses a virtual wall over a link that delays and loses.

    Default: 10 s, a link with 40 ms delay, 10 ms jitter and 2 % loss each way.

    Writes two recordings, a figure and a summary.
    """
    links = LinkOptions(link, profile, delay, jitter, loss, reorder, rate, uplink, downlink)
    params = parameters(
        Params(), file=params_file, assignments=assign or (), links=links, hardware=hardware, scene=scene,
        operator=operator, coupling=coupling, device__servo=servo, device__servo_hz=servo_hz, dof=dof,
        duration_s=duration,
    )  # fmt: skip
    if show_params:
        return _show(params)
    json_target(json_to)
    from hapnet.commands import run as command

    return command.main(params, seed, json_to, out, realtime=realtime)


@app.command()
def simulate(
    scene: Scene = None,
    operator: Operator = None,
    coupling: Coupling = None,
    servo: ServoKind = None,
    servo_hz: ServoRate = None,
    dof: Dof = None,
    duration: Duration = None,
    seed: Seed = 0,
    link: Link = None,
    profile: Profile = None,
    delay: Delay = None,
    jitter: Jitter = None,
    loss: Loss = None,
    reorder: Reorder = None,
    rate: Rate = None,
    uplink: Uplink = None,
    downlink: Downlink = None,
    params_file: ParamsFile = None,
    assign: Assign = None,
    show_params: Show = False,
    json_to: Json = None,
    out: Out = None,
    files: Annotated[bool, typer.Option("--files/--no-files", help="Write recording, figure and summary.")] = True,
    seeds: Annotated[str | None, typer.Option(metavar="A:B", help="Many seeds, A to B - 1: a table, no files.")] = None,
    workers: Annotated[int, typer.Option(min=0, help="Processes for many seeds; 0: one a core.")] = 0,
) -> int:
    """The same in virtual time: one process, deterministic under a seed, much faster than real time."""
    links = LinkOptions(link, profile, delay, jitter, loss, reorder, rate, uplink, downlink)
    params = parameters(
        Params(), file=params_file, assignments=assign or (), links=links, scene=scene, operator=operator,
        coupling=coupling, device__servo=servo, device__servo_hz=servo_hz, dof=dof, duration_s=duration,
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
    scene: Scene = None,
    operator: Operator = None,
    hardware: Hardware = None,
    coupling: Coupling = None,
    servo: ServoKind = None,
    servo_hz: ServoRate = None,
    dof: Dof = None,
    duration: Duration = None,
    seed: OwnSeed = None,
    session: Session = "default",
    name: Name = "device",
    record: Record = None,
    mode: Mode = None,
    connect: Connect = None,
    listen: Listen = None,
    config: Config = None,
    no_multicast_scouting: NoScouting = False,
    cfg: Cfg = None,
    link: Link = None,
    profile: Profile = None,
    delay: Delay = None,
    jitter: Jitter = None,
    loss: Loss = None,
    reorder: Reorder = None,
    rate: Rate = None,
    params_file: ParamsFile = None,
    assign: Assign = None,
    show_params: Show = False,
    json_to: Json = None,
    realtime: Realtime = False,
    events: Events = False,
) -> int:
    """The device's side only: a simulated device and hand, for two hosts. Start it before or after `hapnet world`."""
    links = LinkOptions(link, profile, delay, jitter, loss, reorder, rate)
    params = parameters(
        Params(link=NO_LINK, duration_s=0.0), file=params_file, assignments=assign or (), links=links,
        hardware=hardware, scene=scene, operator=operator, coupling=coupling, device__servo=servo,
        device__servo_hz=servo_hz, dof=dof, duration_s=duration,
    )  # fmt: skip
    zenoh = (mode, connect, listen, config, no_multicast_scouting, cfg)
    return _side("device", params, zenoh, session, name, seed, record, json_to, show_params, realtime, events)


@app.command()
def world(
    scene: Scene = None,
    coupling: Coupling = None,
    dof: Dof = None,
    duration: Duration = None,
    seed: OwnSeed = None,
    session: Session = "default",
    name: Name = "device",
    record: Record = None,
    mode: Mode = None,
    connect: Connect = None,
    listen: Listen = None,
    config: Config = None,
    no_multicast_scouting: NoScouting = False,
    cfg: Cfg = None,
    link: Link = None,
    profile: Profile = None,
    delay: Delay = None,
    jitter: Jitter = None,
    loss: Loss = None,
    reorder: Reorder = None,
    rate: Rate = None,
    params_file: ParamsFile = None,
    assign: Assign = None,
    show_params: Show = False,
    json_to: Json = None,
    events: Events = False,
) -> int:
    """The virtual world's side only, for two hosts. Start it before or after `hapnet device`."""
    links = LinkOptions(link, profile, delay, jitter, loss, reorder, rate)
    params = parameters(
        Params(link=NO_LINK, duration_s=0.0), file=params_file, assignments=assign or (), links=links, scene=scene,
        coupling=coupling, dof=dof, duration_s=duration,
    )  # fmt: skip
    zenoh = (mode, connect, listen, config, no_multicast_scouting, cfg)
    return _side("world", params, zenoh, session, name, seed, record, json_to, show_params, False, events)


@app.command()
def reproduce(
    figure: Annotated[str, typer.Argument(help="fig4, fig5 or fig6.")],
    duration: Duration = None,
    seed: Seed = 0,
    params_file: ParamsFile = None,
    assign: Assign = None,
    show_params: Show = False,
    json_to: Json = None,
    out: Out = None,
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
    json_to: Json = None,
    out: Annotated[Path | None, typer.Option(help="Directory for the figure.", show_default="beside FILE")] = None,
) -> int:
    """Summary and figure of one or two recordings; a torn one is repaired into a copy beside it."""
    json_target(json_to)
    from hapnet.commands import report as command

    return command.main(files, json_to, out)


@app.command()
def bench(
    only: Annotated[
        str | None, typer.Option(metavar="NAME[,NAME]", help="Rows to measure, patterns too: servo_*,device_tick.")
    ] = None,
    seconds: Annotated[float, typer.Option(help="Length of a round [s].")] = 3.0,
    rounds: Annotated[int, typer.Option(help="Figures are medians over so many rounds.")] = 3,
    realtime: Realtime = False,
    beside: Annotated[int, typer.Option(help="Busy processes beside servo_traffic.")] = 0,
    json_to: Json = None,
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
def doctor(connect: Connect = None, json_to: Json = None) -> int:
    """What this machine allows a servo to do, and what to do about what it does not; with -e, whether Zenoh answers."""
    json_target(json_to)
    from hapnet.commands import doctor as command

    return command.main(connect or [], json_to)


def main(argv: list[str] | None = None) -> int:
    """Run the command: 0, or 2 after one line on standard error where something given is wrong, or its own code."""
    args = sys.argv[1:] if argv is None else argv
    if "" not in sys.path:
        sys.path.append("")  # module:Class is looked up from the current directory too
    try:
        code = app(args=args or ["--help"], prog_name="hapnet", standalone_mode=False)
    except (HapnetError, NetemError) as error:
        return _fail(str(error))
    except typer.Abort:
        return 130
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        sys.stderr.close()  # who read our output has gone
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
    zenoh: tuple[str | None, list[str] | None, list[str] | None, str | None, bool, list[str] | None],
    session: str,
    name: str,
    seed: int | None,
    record: Path | None,
    json_to: str | None,
    show_params: bool,
    realtime: bool,
    events: bool,
) -> int:
    if show_params:
        return _show(params)
    json_target(json_to)
    from hapnet.commands import side

    return side.main(
        params,
        side.SideOptions(
            role="device" if role == "device" else "world",
            zenoh=side.zenoh_settings(*zenoh),
            session=session,
            name=name,
            seed=seed,
            record=record,
            realtime=realtime,
            json_to=json_to,
            events=events,
        ),
    )


def _show(params: Params) -> int:
    print(params.toml(), end="")
    return 0


def _fail(line: str) -> int:
    print(f"hapnet: {line}", file=sys.stderr)
    return 2
