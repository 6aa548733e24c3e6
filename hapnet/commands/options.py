"""The groups of options that commands share, and the values made of them: parameters, Zenoh's settings, outputs."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from hapnet.commands import flags, output
from hapnet.errors import HapnetError, InvalidParameter, OutputError
from hapnet.param_sources import FLAG
from hapnet.params import Params
from netem.errors import NetemError
from netem.groups import Without
from netem.notes import notes
from netem.presets import ALIASES, PRESETS
from netem.profile import LinkProfile, compose

if TYPE_CHECKING:
    from hapnet.transport.security import Security

SECURITY = ("tls_ca", "tls_cert", "tls_key", "mutual_tls", "user", "password_file", "users", "secret_file", "encrypt")

NO_LINK: Mapping[str, object] = {"link.up": "", "link.down": ""}
"""The default for two hosts on a real network: no emulated link unless the user gives one."""


@dataclass(frozen=True)
class ModelOptions:
    """The parts of a run (scene, operator, device or robots), and the coupling between them."""

    scene: flags.Scene = None
    operator: flags.Operator = None
    hardware: flags.Hardware = None
    follower: flags.Follower = None
    coupling: flags.Coupling = None
    rendering: flags.Rendering = None
    servo: flags.ServoKind = None
    servo_hz: flags.ServoRate = None
    dof: flags.Dof = None
    duration: flags.Duration = None
    on_silence: flags.OnSilence = None
    silence_after: flags.SilenceAfter = None
    deadband: flags.Deadband = None

    def named(self, *sides: str) -> dict[str, object]:
        """The given parameters by their dotted names; the parameters for silence are set for each of `sides`."""
        found: dict[str, object] = {
            "hardware": self.hardware,
            "follower.robot": self.follower,
            "scene": self.scene,
            "operator": self.operator,
            "coupling": self.coupling,
            "rendering": self.rendering,
            "device.servo": self.servo,
            "device.servo_hz": self.servo_hz,
            "dof": self.dof,
            "duration_s": self.duration,
            "wire.deadband": self.deadband,
        }
        found |= {f"{side}.on_silence": self.on_silence for side in sides}
        found |= {f"{side}.silence_after_s": self.silence_after for side in sides}
        return found


@dataclass(frozen=True)
class LinkOptions:
    """The emulated link."""

    link: flags.Link = None
    profile: flags.Profile = None
    delay: flags.Delay = None
    jitter: flags.Jitter = None
    loss: flags.Loss = None
    resend: flags.Resend = None
    reorder: flags.Reorder = None
    rate: flags.Rate = None
    uplink: flags.Uplink = None
    downlink: flags.Downlink = None
    timeline: flags.TimelineText = None
    up_timeline: flags.UpTimeline = None
    down_timeline: flags.DownTimeline = None

    def over(self, params: Params) -> Params:
        """`params` with the link that these flags describe.

        Raises HapnetError: the text is not tc-netem's syntax, or its parts do not go together.
        """
        both = self._both
        changes = {}
        for name, flag, given, now in (
            ("up", "--uplink", self.uplink, params.link.up),
            ("down", "--downlink", self.downlink, params.link.down),
        ):
            if given is not None:
                with _from(flag):
                    LinkProfile.named(given)
            if given is not None or both:
                changes[f"link.{name}"] = self._direction(now) if given is None else given
        for name, given in (("up", self.up_timeline), ("down", self.down_timeline)):
            text = self.timeline if given is None else given
            if text is not None:
                from netem import Timeline  # imported here, as it imports numpy, which --help must not do

                with _from("--timeline" if given is None else f"--{name}-timeline"):
                    changes[f"link.{name}_timeline"] = str(Timeline.read(text))
        for flag, given in (("--link", self.link), ("--uplink", self.uplink), ("--downlink", self.downlink)):
            for note in notes(given or ""):
                sys.stderr.write(f"{flag}: {note}\n")
        return params.set(changes, FLAG)

    def for_all_of(self, params: Params) -> Params:
        """`params` without the timelines of the directions for which these flags give another link."""
        both = self._both
        given = {"up": both or self.uplink is not None, "down": both or self.downlink is not None}
        return params.set({f"link.{direction}_timeline": "" for direction, other in given.items() if other}, FLAG)

    @property
    def _both(self) -> bool:
        """Whether the flags describe both directions."""
        return any(flag is not None for flag in (self.link, self.profile, *self._effects.values()))

    def _direction(self, default: str) -> str:
        """The text of one direction's link: the default, changed by the flags."""
        words, name = self.link, self.profile
        if words is not None and name is None and ALIASES.get(words, words) in PRESETS:
            words, name = None, words  # a profile that one property may be set on top of
        with _from("--profile" if self.link is None else "--link"):
            compose(words, name)
        base = LinkProfile.named(default)
        for effect, given in self._effects.items():
            if given is not None:
                with _from(f"--{effect}"):
                    compose(words, name, **{effect: given}, base=base)
        return str(compose(words, name, **self._effects, base=base))

    @property
    def _effects(self) -> dict[str, str | None]:
        """The flags that set one property, by their names."""
        return {name: getattr(self, name) for name in ("delay", "jitter", "loss", "resend", "reorder", "rate")}


def _loaded(base: Params, file: Path) -> Params:
    """`base` changed by a file; its errors name the file."""
    try:
        return base.load(file)
    except InvalidParameter as error:
        raise error if error.name == "--params" else HapnetError(f"{file}: {error}") from None


@contextmanager
def _from(flag: str) -> Iterator[None]:
    """A context whose errors name the flag that gave the text."""
    try:
        yield
    except NetemError as error:
        word, _, rest = str(error).partition(": ")
        known = flag.rpartition("-")[2]
        rest = f"{given}: {rest}" if (given := word.removeprefix(f"{known} ")) != word else rest
        raise HapnetError(f"{flag}: {rest if word.partition(' ')[0] in (known, 'profile') else error}") from None


OneWay = Annotated[LinkOptions, Without("uplink", "downlink", "up_timeline", "down_timeline")]
"""The link of a process that shapes only what it sends."""


@dataclass(frozen=True)
class ParamsOptions:
    """The sources of parameters besides the flags with names of their own."""

    params_file: flags.ParamsFile = None
    assign: flags.Assign = None
    show_params: flags.Show = False
    schema: flags.Schema = False

    def over(self, base: Params, named: Mapping[str, object] | None = None, links: LinkOptions | None = None) -> Params:
        """Defaults, then the file, then `named` (None: not given), then the link flags, then `--set`.

        Each overrides the sources before it.

        Raises HapnetError, netem.NetemError: one line that names the value and what is allowed.
        """
        params = base if self.params_file is None else _loaded(base, self.params_file)
        params = params.set({name: value for name, value in (named or {}).items() if value is not None}, FLAG)
        if links is not None:
            params = links.over(params)
        params = params.set_words(self.assign or ())
        for words in (params.link.up, params.link.down):
            LinkProfile.named(words)
        if self.schema and not self.show_params:
            raise InvalidParameter("--schema", "alone", "", why="it needs --show-params")
        return params

    def show(self, params: Params) -> int:
        """Print TOML that `--params` reads or, with `--schema`, the schema of such a file; returns 0."""
        text = params.toml()
        if self.schema:
            from hapnet.param_schema import schema

            text = json.dumps(schema(params), indent=2, ensure_ascii=False) + "\n"
        try:
            sys.stdout.write(text)
            sys.stdout.flush()
        except BrokenPipeError:
            raise
        except OSError as error:  # a full disk
            output.silence(sys.stdout)
            raise OutputError(f"cannot write standard output: {error.strerror or error}") from None
        return 0


@dataclass(frozen=True)
class ZenohOptions:
    """Zenoh's flags, and the security flags."""

    mode: flags.Mode = None
    connect: flags.Connect = None
    listen: flags.Listen = None
    config: flags.Config = None
    no_multicast_scouting: flags.NoScouting = False
    cfg: flags.Cfg = None
    tls_ca: flags.TlsCa = None
    tls_cert: flags.TlsCert = None
    tls_key: flags.TlsKey = None
    mutual_tls: flags.MutualTls = False
    user: flags.User = None
    password_file: flags.PasswordFile = None
    users: flags.Users = None
    secret_file: flags.SecretFile = None
    encrypt: flags.Encrypt = False

    @property
    def leave_this_host(self) -> bool:
        """Whether the flags give an endpoint or a configuration with which to reach the other side."""
        return bool(self.connect or self.listen or self.config)

    def words(self) -> list[str]:
        """The flags as words of a command line, for another command that accepts them."""
        found = [word for endpoint in self.connect or () for word in ("--connect", endpoint)]
        found += [word for endpoint in self.listen or () for word in ("--listen", endpoint)]
        found += [word for entry in self.cfg or () for word in ("--cfg", entry)]
        for field in fields(self):
            value = getattr(self, field.name)
            if value and not isinstance(value, list):
                found += [f"--{field.name.replace('_', '-')}", *([] if value is True else [str(value)])]
        return found

    @property
    def security(self) -> Security:
        """The security settings of these flags, with the password from the environment if it is set there."""
        from hapnet.transport.security import PASSWORD_VARIABLE, Security

        given = {field.name: getattr(self, field.name) for field in fields(self) if field.name in SECURITY}
        return Security(**given, password=os.environ.get(PASSWORD_VARIABLE))


Dialling = Annotated[
    ZenohOptions, Without("mode", "listen", "config", "no_multicast_scouting", "cfg", "users", "secret_file", "encrypt")
]
"""The options of a command that only dials."""


@dataclass(frozen=True)
class SideFlags:
    """The options of one side's process besides its parameters."""

    seed: flags.SideSeed = None
    session: flags.Session = "default"
    name: flags.Name = "device"
    record: flags.Record = None
    json_to: flags.Json = None
    out: flags.SideOut = None
    files: flags.Files = True
    realtime: flags.Realtime = False
    once: flags.Once = False
    log_to: flags.Log = None
    progress: flags.Progress = False
    verbose: flags.Verbose = False


def no_out_without_files(out: Path | None, files: bool) -> None:
    """Raise InvalidParameter for --out where no files are written."""
    if out is not None and not files:
        raise InvalidParameter("--out", str(out), "", why="--no-files writes no files; leave one of the two out")
