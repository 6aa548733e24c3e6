"""Subscribe to keys, without part in the protocol, and reopen lost connections."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace

import zenoh

from hapnet.transport.config import ZenohSettings, reason, where, zenoh_config

LOOK_S = 0.2
"""The period of the checks of the connection [s]."""

LOST_S = 1.0
"""After this time without any connection, Zenoh is opened again [s]."""


class Subscription:
    """Passes each message on `keys` to `on_message`, on one of Zenoh's threads; `on_message` must not block.

    It dials as a Zenoh client: the process that it dials then forwards the messages of others.

    settings : where it dials. on_message : called with a message's key and its bytes.

    Attributes
    ----------
    problem : why Zenoh is not open, if it is not.

    Raises InvalidParameter, TransportError: as `zenoh_config`.
    """

    def __init__(self, settings: ZenohSettings, keys: Sequence[str], on_message: Callable[[str, bytes], None]) -> None:
        if settings.mode is None and settings.connect:
            settings = replace(settings, mode="client")
        self._config = zenoh_config(settings)
        self._keys, self._on_message = keys, on_message
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._main, name="subscription", daemon=True)
        self.problem: str = ""

    @property
    def where(self) -> str:
        """The endpoints that it dials, as text."""
        return where(self._config)

    def open(self) -> None:
        """Start listening in the background; returns at once."""
        self._thread.start()

    def close(self) -> None:
        """Stop listening."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _main(self) -> None:
        while not self._stopping.is_set():
            try:
                with zenoh.open(self._config) as session:
                    self.problem = ""
                    for key in self._keys:
                        session.declare_subscriber(key, zenoh.handlers.Callback(self._receive, indirect=False))
                    self._keep(session)
            except zenoh.ZError as error:
                self.problem = reason(error)
            self._stopping.wait(LOOK_S)

    def _keep(self, session: zenoh.Session) -> None:
        """Listen until the session is lost, or has had no connection for `LOST_S`."""
        alone_s = 0.0
        while not self._stopping.wait(LOOK_S) and not session.is_closed():
            alone_s = 0.0 if session.info.transports() else alone_s + LOOK_S
            if alone_s > LOST_S:
                return

    def _receive(self, sample: zenoh.Sample) -> None:
        self._on_message(str(sample.key_expr), sample.payload.to_bytes())
