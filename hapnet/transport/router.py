"""A Zenoh router in this process, for several sides of one program that others reach at one address, and their names.

Zenoh's peers that are connected by a third do not hear each other; clients of a router do. So a world with several
hands opens a router where its command says that it listens, and its sides are clients of that router.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from tempfile import TemporaryDirectory

import zenoh

from hapnet.errors import HapnetError, InvalidParameter, TransportError
from hapnet.transport.config import ZenohSettings, listen_here_too, local_address, reason, zenoh_config
from hapnet.transport.entities import call, check_name
from hapnet.transport.security import ANYBODY
from hapnet.transport.zenoh import DIRECTIONS

FREE = "free"
"""The name with which a device takes the first free seat of a world."""

FOUND_WITHIN_S = 5.0
_ASK_EVERY_S = 0.3


@contextmanager
def routed(settings: ZenohSettings) -> Iterator[ZenohSettings]:
    """A context with a Zenoh router that listens and dials by these settings; gives the settings of its clients.

    With the mode client there is no router here: the settings are returned as they are.

    Raises TransportError: the router cannot be opened. InvalidParameter: the settings do not fit.
    """
    if settings.mode == "client":
        if settings.listen:
            why = "each seat is a client of the router that -e names; leave -l out"
            raise InvalidParameter("--listen", settings.listen[0], "", why=why)
        yield settings
        return
    if settings.security.users is not None:
        raise InvalidParameter(
            "--users", str(settings.security.users), "", why="the seats have no passwords; use --secret-file"
        )
    with TemporaryDirectory(prefix="hapnet-") as sockets:  # only this user can read it
        address = local_address(sockets)
        outer = replace(settings, mode="router")
        config = zenoh_config(outer)
        listen_here_too(config, address)
        try:
            router = zenoh.open(config)
        except zenoh.ZError as error:
            raise TransportError(f"cannot open Zenoh's router: {reason(error)}") from None
        try:
            own = replace(ANYBODY, secret_file=settings.security.secret_file, encrypt=settings.security.encrypt)
            yield ZenohSettings(mode="client", connect=(address,), security=own, router=outer)
        finally:
            call(router.close)


def free_name(settings: ZenohSettings, session: str, within_s: float = FOUND_WITHIN_S) -> str:
    """The first name, in alphabetical order, under which a world of this session waits for a device. Blocks.

    Another device may take it meanwhile; then the world refuses this one.

    Raises HapnetError: no world waits, within `within_s` [s]. TransportError, InvalidParameter: as `zenoh_config`.
    """
    if settings.connect and settings.mode is None:
        settings = replace(settings, mode="client")  # a router tells its clients of other devices, and its peers not
    config, ends_s, taken = zenoh_config(settings), time.monotonic() + within_s, set[str]()
    root = f"hapnet/{check_name('session', session)}"
    try:
        with zenoh.open(config) as node:
            while time.monotonic() < ends_s:
                worlds, taken = (_names(node, f"{root}/*/{DIRECTIONS[role]}/*") for role in ("world", "device"))
                if free := sorted(worlds - taken):
                    return free[0]
                time.sleep(_ASK_EVERY_S)
    except zenoh.ZError as error:
        raise TransportError(f"cannot ask for a free seat: {reason(error)}") from None
    others = f"; taken: {', '.join(sorted(taken))}" if taken else ""
    raise HapnetError(f"no world with the --session {session} waits for a device{others}")


def taken_names(settings: ZenohSettings, session: str) -> set[str]:
    """The names of the devices of this session that a router knows. Blocks.

    Raises TransportError, InvalidParameter: as `zenoh_config`.
    """
    tokens = f"hapnet/{check_name('session', session)}/*/{DIRECTIONS['device']}/*"
    try:
        with zenoh.open(zenoh_config(replace(settings, mode="client"))) as node:
            return _names(node, tokens)
    except zenoh.ZError as error:
        raise TransportError(f"cannot ask for the seats: {reason(error)}") from None


def _names(node: zenoh.Session, tokens: str) -> set[str]:
    replies = node.liveliness().get(tokens, timeout=1.0)
    return {str(reply.ok.key_expr).split("/")[2] for reply in replies if reply.ok is not None}
