"""The flags of `hapnet`, each declared once: types for fields of option groups and for commands' arguments."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from hapnet.commands import complete
from hapnet.errors import InvalidParameter
from hapnet.laws import COUPLING_NAMES
from hapnet.param_values import LARGEST_SEED

RECORDINGS = "One recording, or the device's and the world's."
_link = partial(typer.Option, rich_help_panel="Link, emulated")
_zenoh = partial(typer.Option, rich_help_panel="Zenoh")
_security = partial(typer.Option, rich_help_panel="Security")
_params = partial(typer.Option, rich_help_panel="Parameters")

Scene = Annotated[
    str | None,
    typer.Option(
        help="free, wall, box, paper, moving, joints; solids: sphere, cuboid, cylinder, plane, 'mesh:FILE?unit=mm', "
        "sdf:module:function (several joined by ' + '), also with a tool that turns in front: 'tool:box + plane'; "
        "soft; mujoco:FILE.xml; or module:name.",
        autocompletion=complete.scenes,
    ),
]
Operator = Annotated[
    str | None,
    typer.Option(
        help="The hand: rest, sine, press, hand-N (generated), or a recording's path (.csv, .mcap).",
        autocompletion=complete.operators,
    ),
]
Hardware = Annotated[
    str | None,
    typer.Option(
        "--device",
        metavar="NAME[:OPTIONS]|MODULE:CLASS",
        help="A real device (`hapnet devices`), your own, or an arm (omni, arm:FILE.urdf); not a simulated mass.",
        autocompletion=complete.devices,
    ),
]
Follower = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="A robot that follows the device, in place of the virtual mass: simulated (among the scene's contacts), "
        "or the name of a driver.",
        autocompletion=complete.devices,
    ),
]
Coupling = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help=f"pspm; for comparison zoh (a plain virtual coupling), {', '.join(COUPLING_NAMES[2:])}; or your own as "
        "MODULE:NAME.",
        autocompletion=complete.couplings,
    ),
]
Rendering = Annotated[
    str | None,
    typer.Option(
        "--rendering",
        "--feel",
        help="hapnet (a local contact model and prediction before the coupling), paper (as published), or auto: hapnet "
        "for pspm and zoh, and the rendering that its authors allow for each other coupling.",
        autocompletion=complete.choices("rendering"),
    ),
]
ServoKind = Annotated[
    str | None,
    typer.Option(
        "--servo",
        help="sampled (as on hardware) or continuous (as in theory).",
        autocompletion=complete.choices("device.servo"),
    ),
]
ServoRate = Annotated[float | None, typer.Option("--servo-hz", help="Rate of the servo [Hz]; 1000 by default.")]
Duration = Annotated[float | None, typer.Option(help="Seconds from pairing; 0: until Ctrl-C (not in virtual time).")]
Dof = Annotated[int | None, typer.Option(help="Degrees of freedom, 1 to 3; the scene's own by default.")]
Seed = Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Seed of everything random.")]
Trust = Annotated[
    bool,
    typer.Option("--trust", help="Import the modules that the recording names (they can run any code) without asking."),
]
ReplaySeed = Annotated[
    int | None,
    typer.Option("--seed", min=0, max=LARGEST_SEED, help="Seed of everything random.", show_default="the recording's"),
]
SideSeed = Annotated[
    int | None,
    typer.Option("--seed", min=0, max=LARGEST_SEED, help="Seed of this side's link and steps; random by default."),
]
ParamsFile = Annotated[Path | None, _params("--params", help="TOML file of parameters, as --show-params prints.")]
Assign = Annotated[
    list[str] | None,
    _params(
        "--set",
        metavar="NAME=VALUE",
        help="Set one parameter: world.wall.stiffness=30000.",
        autocompletion=complete.assignments,
    ),
]
Show = Annotated[bool, _params("--show-params", help="Print all parameters and exit.")]
Schema = Annotated[bool, _params("--schema", help="With --show-params: print a JSON schema for editors.")]


def _writable(target: str | None) -> str | None:
    """The target of `--json`, checked before the command runs."""
    if target not in (None, "-"):
        path = Path(target)
        if path.is_dir() or not os.access(path if path.exists() else path.absolute().parent, os.W_OK):
            raise InvalidParameter("--json", target, "- or a file that can be written, in a directory that exists")
    return target


Json = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE|-", help="Write the result as JSON; -: alone on stdout.", callback=_writable),
]


def out_in(default: str) -> Any:
    """The flag `--out` of a command that otherwise writes into `default`."""
    return typer.Option(help="Directory for all output files.", show_default=default)


Out = Annotated[Path | None, out_in("runs/<UTC time>-<seed>")]
Recorded = Annotated[
    list[Path],
    typer.Argument(metavar="FILE", help="One recording, or the device's and the world's; or a run's directory."),
]
SideOut = Annotated[Path | None, out_in("runs/<UTC time>-<device or world>")]
Files = Annotated[bool, typer.Option("--files/--no-files", help="Write recording, figure and summary.")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Show every figure, notice and file, not only two lines.")
]
Realtime = Annotated[
    bool,
    typer.Option(
        "--realtime", help="Run the servo in its own process, with SCHED_FIFO and locked memory where allowed."
    ),
]


Link = Annotated[
    str | None,
    _link(
        "--link",
        metavar="NAME|'TC WORDS'",
        help="The link: a profile's name (`netem profiles`), or tc-netem's syntax.",
        autocompletion=complete.profiles,
    ),
]
Profile = Annotated[
    str | None,
    typer.Option(help="As --link, for scripts of older versions.", hidden=True, autocompletion=complete.profiles),
]
Delay = Annotated[str | None, _link(help="Delay, such as 40ms.")]
Jitter = Annotated[str | None, _link(help="Jitter, such as 10ms.")]
Loss = Annotated[str | None, _link(help="Loss, such as 2% or 'gemodel 1% 20%'.")]
Reorder = Annotated[str | None, _link(help="Reordering, such as 5%.")]
Rate = Annotated[str | None, _link(help="Rate, such as 1mbit.")]
Resend = Annotated[
    str | None,
    _link(metavar="N TIME", help="The link resends lost packets, such as '3 8ms' or '3 8ms unordered'; 0: never."),
]
Uplink = Annotated[str | None, _link(help="From the device only, as --link.", autocompletion=complete.profiles)]
Downlink = Annotated[str | None, _link(help="From the world only, as --link.", autocompletion=complete.profiles)]

_TIMELINE = "Changes from pairing on: 'at 5s: down; at 9s: up', or a file"
TimelineText = Annotated[str | None, _link("--timeline", metavar="TEXT|FILE", help=f"{_TIMELINE}.")]
UpTimeline = Annotated[str | None, _link(metavar="TEXT|FILE", help="From the device only.")]
DownTimeline = Annotated[str | None, _link(metavar="TEXT|FILE", help="From the world only.")]

Mode = Annotated[
    str | None, _zenoh("-m", "--mode", help="peer, client or router.", autocompletion=complete.words(*complete.MODES))
]
Connect = Annotated[
    list[str] | None, _zenoh("-e", "--connect", metavar="ENDPOINT", help="Address to dial: tcp/192.168.0.2:17447.")
]
Listen = Annotated[
    list[str] | None, _zenoh("-l", "--listen", metavar="ENDPOINT", help="Address to listen on: tcp/0.0.0.0:17447.")
]
Config = Annotated[str | None, _zenoh("-c", "--config", help="Zenoh configuration file.")]
NoScouting = Annotated[bool, _zenoh("--no-multicast-scouting", help="Do not look for peers by multicast.")]
Cfg = Annotated[list[str] | None, _zenoh("--cfg", metavar="KEY:JSON5", help="Override a key of Zenoh's configuration.")]
TlsCa = Annotated[
    Path | None,
    _security("--tls-ca", metavar="FILE", help="Certificate of the authority that signs the other side's certificate."),
]
TlsCert = Annotated[Path | None, _security("--tls-cert", metavar="FILE", help="This side's certificate.")]
TlsKey = Annotated[
    Path | None, _security("--tls-key", metavar="FILE", help="This side's private key, without a passphrase.")
]
MutualTls = Annotated[
    bool, _security("--mutual-tls", help="The dialling side needs a certificate too, signed by --tls-ca.")
]
User = Annotated[str | None, _security("--user", metavar="NAME", help="User name for dialling; it needs a password.")]
PasswordFile = Annotated[
    Path | None,
    _security(
        "--password-file", metavar="FILE", help="File with the password; or set HAPNET_PASSWORD in the environment."
    ),
]
Users = Annotated[Path | None, _security("--users", metavar="FILE", help="Who may dial here: lines user:password.")]
SecretFile = Annotated[
    Path | None,
    _security(
        "--secret-file",
        metavar="FILE",
        help="A file whose first line is a secret of the two sides: nobody else can take part.",
    ),
]

Encrypt = Annotated[
    bool,
    _security(
        "--encrypt",
        help="Pair only with a side that encrypts; telemetry is encrypted too. Best with --secret-file.",
    ),
]

Session = Annotated[str, typer.Option(help="Name of the session, the same on both sides.")]
Name = Annotated[str, typer.Option(help="Name of the device, the same on both sides.")]
Record = Annotated[
    Path | None, typer.Option(help="Record this side to this MCAP file, and write no other without --out.")
]
Log = Annotated[
    str | None,
    typer.Option("--log", metavar="FILE|-", help="Log events, one JSON object per line; -: to stdout, without text."),
]
Once = Annotated[bool, typer.Option("--once", help="End when the other side has left, or was silent for 10 s.")]
Progress = Annotated[bool, typer.Option("--progress", hidden=True)]
OnSilence = Annotated[
    str | None,
    typer.Option(
        "--on-silence",
        help="While nothing arrives: hold the set-position, or release the spring.",
        autocompletion=complete.choices("device.on_silence"),
    ),
]
SilenceAfter = Annotated[
    float | None,
    typer.Option("--silence-after", help="A silence begins after so many seconds without messages; 0.5 by default."),
]
Deadband = Annotated[
    float | None,
    typer.Option(
        "--deadband", metavar="FRACTION", help="Send only changes of the force above this fraction; 0.1 is hardly felt."
    ),
]
