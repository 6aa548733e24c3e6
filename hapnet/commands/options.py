"""From a command line's options to parameters."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hapnet.errors import InvalidParameter
from hapnet.params import LinkParams, Params
from hapnet.runtime.security import PASSWORD_VARIABLE, Security
from netem.profile import PRESETS, LinkProfile, compose

NO_LINK = LinkParams("", "")
"""What two hosts on a real network start from: nothing is emulated unless asked for."""


@dataclass(frozen=True)
class LinkOptions:
    """The link flags as given."""

    link: str | None = None
    profile: str | None = None
    delay: str | None = None
    jitter: str | None = None
    loss: str | None = None
    reorder: str | None = None
    rate: str | None = None
    uplink: str | None = None
    downlink: str | None = None
    timeline: str | None = None
    up_timeline: str | None = None
    down_timeline: str | None = None

    def over(self, default: str) -> str:
        """The words of one direction: what the flags make of the default."""
        flags = (self.delay, self.jitter, self.loss, self.reorder, self.rate)
        if self.link is None and self.profile is None and all(flag is None for flag in flags):
            return default
        words = None if self.link is None else PRESETS.get(self.link, self.link)
        return str(compose(words, self.profile, *flags, base=LinkProfile.named(default)))


@dataclass(frozen=True)
class ZenohOptions:
    """Zenoh's flags as given, and those of who may connect."""

    mode: str | None
    connect: list[str] | None
    listen: list[str] | None
    config: str | None
    no_multicast_scouting: bool
    cfg: list[str] | None
    security: Security


def parameters(
    base: Params,
    *,
    file: Path | None = None,
    assignments: Sequence[str] = (),
    links: LinkOptions | None = None,
    **named: str | float | int | None,
) -> Params:
    """Defaults, then the file, then named options, then the link flags, then `--set`; each overrides what is before.

    Raises
    ------
    InvalidParameter, netem.NetemError : in one line, what is wrong and what is allowed.
    """
    params = base if file is None else base.load(file)
    params = params.set({name.replace("__", "."): value for name, value in named.items() if value is not None})
    if links is not None:
        up, down = links.over(params.link.up), links.over(params.link.down)
        up = up if links.uplink is None else links.uplink
        down = down if links.downlink is None else links.downlink
        changes = {"link.up": up, "link.down": down}
        for name, given in (("up", links.up_timeline), ("down", links.down_timeline)):
            text = links.timeline if given is None else given
            if text is not None:
                from netem import Timeline  # which brings numpy: not for --help

                changes[f"link.{name}_timeline"] = str(Timeline.read(text))
        params = params.set(changes)
    params = params.set_words(assignments)
    for words in (params.link.up, params.link.down):
        LinkProfile.named(words)
    return params


def security(
    tls_ca: Path | None,
    tls_cert: Path | None,
    tls_key: Path | None,
    mutual_tls: bool,
    user: str | None,
    password_file: Path | None,
    users: Path | None = None,
) -> Security:
    """The security flags, and the password in the environment for who wants none in a file."""
    password = os.environ.get(PASSWORD_VARIABLE)
    return Security(tls_ca, tls_cert, tls_key, mutual_tls, user, password_file, password, users)


def json_target(target: str | None) -> Path | None:
    """Where `--json` writes: None for standard output."""
    if target in (None, "-"):
        return None
    assert target is not None
    path = Path(target)
    if path.is_dir() or not os.access(path if path.exists() else path.absolute().parent, os.W_OK):
        raise InvalidParameter("--json", target, "- or a file that can be written, in a directory that exists")
    return path
