"""A Zenoh router in this process, for several sides of one program that others reach at one address.

Zenoh's peers that are connected by a third do not hear each other; clients of a router do. So a world with several
hands opens a router where its command says that it listens, and its sides are clients of that router.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from tempfile import TemporaryDirectory

import zenoh

from hapnet.errors import InvalidParameter, TransportError
from hapnet.transport.config import ZenohSettings, local_address, reason, zenoh_config
from hapnet.transport.entities import call
from hapnet.transport.security import ANYBODY


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
        outer = replace(settings, mode="router", listen=(*settings.listen, address))
        config = zenoh_config(outer)
        try:
            router = zenoh.open(config)
        except zenoh.ZError as error:
            raise TransportError(f"cannot open Zenoh's router: {reason(error)}") from None
        try:
            own = replace(ANYBODY, secret_file=settings.security.secret_file, encrypt=settings.security.encrypt)
            yield ZenohSettings(mode="client", connect=(address,), security=own, router=outer)
        finally:
            call(router.close)
