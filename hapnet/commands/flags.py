"""The flags of `hapnet`, each declared once: types for fields of option groups and for commands' arguments."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from hapnet.commands import complete
from hapnet.errors import InvalidParameter
from hapnet.laws import BILATERAL_NAMES, COUPLING_NAMES
from hapnet.param_values import LARGEST_SEED
from netem.command_help import MORE

RECORDINGS = "One recording, or the device's and the world's."
_more = partial(typer.Option, rich_help_panel=f"Options{MORE}")
_model, _more_model = (partial(typer.Option, rich_help_panel=f"Parts of the run{more}") for more in ("", MORE))
_link, _more_link = (partial(typer.Option, rich_help_panel=f"Emulated link{more}") for more in ("", MORE))
_zenoh, _more_zenoh = (partial(typer.Option, rich_help_panel=f"Network (Zenoh){more}") for more in ("", MORE))
_security, _more_security = (partial(typer.Option, rich_help_panel=f"Security{more}") for more in ("", MORE))
_params, _more_params = (partial(typer.Option, rich_help_panel=f"Parameters{more}") for more in ("", MORE))

Scene = Annotated[
    str | None,
    _model(
        metavar="NAME",
        help="wall, box, paper, soft, sphere, mujoco:FILE.xml, ..."
        "\n\nAlso free, moving, joints; the solids cuboid, cylinder, plane, 'mesh:FILE?unit=mm', sdf:module:function "
        "(several joined by ' + '), with a tool that turns in front: 'tool:box + plane'; or your own as module:name.",
        autocompletion=complete.scenes,
    ),
]
Operator = Annotated[
    str | None,
    _model(
        metavar="NAME|FILE",
        help="The operator: rest, sine, press, hand-1, a recording."
        "\n\nhand-N, strokes-N (0.3 to 0.9 m/s) and writing-N are generated from the number N. "
        "A recording is a .csv or .mcap file.",
        autocompletion=complete.operators,
    ),
]
Hardware = Annotated[
    str | None,
    _model(
        "--device",
        metavar="NAME",
        help="A device of `hapnet devices`, or MODULE:CLASS."
        "\n\nWith options as in serial:port=/dev/ttyACM0; or a simulated arm: omni, arm:FILE.urdf. By default a "
        "simulated mass.",
        autocompletion=complete.devices,
    ),
]
Follower = Annotated[
    str | None,
    _model(
        metavar="NAME",
        help="A robot that follows: simulated, or a driver."
        "\n\nIt takes the virtual mass's place. A simulated robot touches the scene.",
        autocompletion=complete.devices,
    ),
]
Coupling = Annotated[
    str | None,
    _model(
        metavar="NAME",
        help=f"pspm; to compare: {', '.join(COUPLING_NAMES[1:])}."
        f"\n\nzoh is a plain virtual coupling. With --follower also {', '.join(BILATERAL_NAMES)}. "
        "Your own: MODULE:NAME.",
        autocompletion=complete.couplings,
    ),
]
Rendering = Annotated[
    str | None,
    _more_model(
        "--rendering",
        "--feel",
        metavar="NAME",
        help="hapnet (a local contact model and prediction before the coupling), paper (as published), or auto: hapnet "
        "for pspm and zoh, and the rendering that its authors allow for each other coupling.",
        autocompletion=complete.choices("rendering"),
    ),
]
ServoKind = Annotated[
    str | None,
    _more_model(
        "--servo",
        metavar="KIND",
        help="sampled (as on hardware) or continuous (as in theory).",
        autocompletion=complete.choices("device.servo"),
    ),
]
ServoRate = Annotated[float | None, _more_model("--servo-hz", metavar="HZ", help="Rate of the servo; 1000 by default.")]
Duration = Annotated[
    float | None,
    _model(
        metavar="S",
        help="Seconds from pairing; 0: until Ctrl-C.\n\nIn virtual time it must be above 0.",
    ),
]
Dof = Annotated[int | None, _model("--dof", metavar="N", help="Number of axes, 1 to 3; the scene's own by default.")]
Seed = Annotated[int, typer.Option(metavar="N", min=0, max=LARGEST_SEED, help="Seed of everything random.")]
Trust = Annotated[
    bool,
    typer.Option(
        "--trust",
        help="Import the modules that the recording names.\n\nThey can run any code. Without this flag you are asked.",
    ),
]
ReplaySeed = Annotated[
    int | None,
    typer.Option(
        "--seed",
        metavar="N",
        min=0,
        max=LARGEST_SEED,
        help="Seed of everything random.",
        show_default="the recording's",
    ),
]
SideSeed = Annotated[
    int | None,
    typer.Option(
        "--seed", metavar="N", min=0, max=LARGEST_SEED, help="Seed of this side's link and steps; random by default."
    ),
]
ParamsFile = Annotated[Path | None, _params("--params", metavar="FILE", help="TOML file, as --show-params prints it.")]
Assign = Annotated[
    list[str] | None,
    _params(
        "--set",
        metavar="NAME=VALUE",
        help="Set a parameter, such as world.wall.stiffness=30000.",
        autocompletion=complete.assignments,
    ),
]
Show = Annotated[bool, _params("--show-params", help="Print all parameters and exit.")]
Schema = Annotated[bool, _more_params("--schema", help="With --show-params: print a JSON schema for editors.")]


def _writable(target: str | None) -> str | None:
    """The target of `--json`, checked before the command runs."""
    if target not in (None, "-"):
        path = Path(target)
        if path.is_dir() or not os.access(path if path.exists() else path.absolute().parent, os.W_OK):
            raise InvalidParameter("--json", target, "- or a file that can be written, in a directory that exists")
    return target


Json = Annotated[
    str | None,
    typer.Option(
        "--json", metavar="FILE|-", help="Write the result as JSON; with -, to stdout only.", callback=_writable
    ),
]


def out_in(default: str) -> Any:
    """The flag `--out` of a command that otherwise writes into `default`."""
    return typer.Option(metavar="DIR", help="Directory for all output files.", show_default=default)


Out = Annotated[Path | None, out_in("runs/<UTC time>-<seed>")]
Recorded = Annotated[
    list[Path],
    typer.Argument(metavar="FILE", help="One recording, or the device's and the world's; or a run's directory."),
]
SideOut = Annotated[Path | None, out_in("runs/<UTC time>-<device or world>")]
Graph = Annotated[
    Path | None,
    _more("--graph", metavar="FILE.toml", help="Several hands and worlds: a graph (see `hapnet graph`)."),
]
Node = Annotated[
    str | None, _more("--node", metavar="NAME", help="With --graph: the node that runs here; if it has several.")
]
Files = Annotated[bool, typer.Option("--files/--no-files", help="Write output files, or none.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Show all figures, notices and files.")]
Realtime = Annotated[
    bool,
    _more("--realtime", help="Run the servo in its own process, with SCHED_FIFO and locked memory where allowed."),
]


Link = Annotated[
    str | None,
    _link(
        "--link",
        metavar="NAME|TEXT",
        help="A profile (4g, wifi, ...), tc-netem's syntax, or the file of a recorded link.",
        autocompletion=complete.profiles,
    ),
]
Profile = Annotated[
    str | None,
    typer.Option(help="As --link, for scripts of older versions.", hidden=True, autocompletion=complete.profiles),
]
Delay = Annotated[str | None, _link(metavar="TIME", help="Delay, such as 40ms.")]
Jitter = Annotated[str | None, _link(metavar="TIME", help="Jitter, such as 10ms.")]
Loss = Annotated[str | None, _link(metavar="SHARE", help="Loss, such as 2% or 'gemodel 1% 20%'.")]
Reorder = Annotated[str | None, _more_link(metavar="SHARE", help="Reordering, such as 5%.")]
Rate = Annotated[str | None, _more_link(metavar="RATE", help="Rate, such as 1mbit.")]
Resend = Annotated[
    str | None,
    _more_link(metavar="N TIME", help="The link resends lost packets, such as '3 8ms' or '3 8ms unordered'; 0: never."),
]
Uplink = Annotated[
    str | None,
    _more_link(metavar="NAME|TEXT", help="From the device only, as --link.", autocompletion=complete.profiles),
]
Downlink = Annotated[
    str | None,
    _more_link(metavar="NAME|TEXT", help="From the world only, as --link.", autocompletion=complete.profiles),
]

_TIMELINE = "Changes from pairing on: 'at 5s: down; at 9s: up', or a file"
TimelineText = Annotated[str | None, _more_link("--timeline", metavar="TEXT|FILE", help=f"{_TIMELINE}.")]
UpTimeline = Annotated[str | None, _more_link(metavar="TEXT|FILE", help="As --timeline, from the device only.")]
DownTimeline = Annotated[str | None, _more_link(metavar="TEXT|FILE", help="As --timeline, from the world only.")]

Mode = Annotated[
    str | None,
    _more_zenoh(
        "-m", "--mode", metavar="NAME", help="peer, client or router.", autocompletion=complete.words(*complete.MODES)
    ),
]
Connect = Annotated[
    list[str] | None, _zenoh("-e", "--connect", metavar="ENDPOINT", help="Dial this address: tcp/192.168.0.2:17447.")
]
Listen = Annotated[
    list[str] | None, _zenoh("-l", "--listen", metavar="ENDPOINT", help="Listen here: tcp/0.0.0.0:17447.")
]
Config = Annotated[str | None, _more_zenoh("-c", "--config", metavar="FILE", help="Zenoh configuration file.")]
NoScouting = Annotated[bool, _more_zenoh("--no-multicast-scouting", help="Do not look for peers by multicast.")]
Cfg = Annotated[
    list[str] | None, _more_zenoh("--cfg", metavar="KEY:JSON5", help="Override a key of Zenoh's configuration.")
]
TlsCa = Annotated[
    Path | None,
    _more_security(
        "--tls-ca", metavar="FILE", help="Certificate of the authority that signs the other side's certificate."
    ),
]
TlsCert = Annotated[Path | None, _more_security("--tls-cert", metavar="FILE", help="This side's certificate.")]
TlsKey = Annotated[
    Path | None, _more_security("--tls-key", metavar="FILE", help="This side's private key, without a passphrase.")
]
MutualTls = Annotated[
    bool, _more_security("--mutual-tls", help="The dialling side needs a certificate too, signed by --tls-ca.")
]
User = Annotated[
    str | None, _more_security("--user", metavar="NAME", help="User name for dialling; it needs a password.")
]
PasswordFile = Annotated[
    Path | None,
    _more_security(
        "--password-file", metavar="FILE", help="File with the password; or set HAPNET_PASSWORD in the environment."
    ),
]
Users = Annotated[
    Path | None, _more_security("--users", metavar="FILE", help="Who may dial here: lines user:password.")
]
SecretFile = Annotated[
    Path | None,
    _security(
        "--secret-file",
        metavar="FILE",
        help="A shared secret, in the first line; only its owners can pair.",
    ),
]

Encrypt = Annotated[
    bool,
    _security(
        "--encrypt",
        help="Pair only with a side that encrypts.\n\nTelemetry is encrypted too. Best with --secret-file.",
    ),
]

Session = Annotated[str, typer.Option(metavar="NAME", help="Name of the session, the same on both sides.")]
Name = Annotated[str, typer.Option(metavar="NAME", help="Name of the device, the same on both sides.")]
Record = Annotated[
    Path | None,
    _more(metavar="FILE", help="Record this side to this MCAP file, and write no other without --out."),
]
Log = Annotated[
    str | None,
    typer.Option("--log", metavar="FILE|-", help="Log events as lines of JSON; with -, to stdout only."),
]
Once = Annotated[
    bool, typer.Option("--once", help="End when the other side has left.\n\nAlso when it was silent for 10 s.")
]
Progress = Annotated[bool, typer.Option("--progress", hidden=True)]
OnSilence = Annotated[
    str | None,
    _more_model(
        "--on-silence",
        metavar="hold|release",
        help="While nothing arrives: hold the set-position, or release the spring.",
        autocompletion=complete.choices("device.on_silence"),
    ),
]
SilenceAfter = Annotated[
    float | None,
    _more_model(
        "--silence-after", metavar="S", help="A silence begins after so many seconds without messages; 0.5 by default."
    ),
]
Deadband = Annotated[
    float | None,
    _more_model(
        "--deadband", metavar="FRACTION", help="Send only changes of the force above this fraction; 0.1 is hardly felt."
    ),
]
