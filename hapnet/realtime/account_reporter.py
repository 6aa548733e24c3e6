"""Tells the peer this side's half of the account: once a second, when it asks, and at the end until it has answered."""

from __future__ import annotations

from hapnet.realtime.figures import Figures
from hapnet.realtime.link_driver import LinkDriver
from hapnet.side.device import Clock
from hapnet.wire.session import Session

EVERY_NS = 1_000_000_000
AT_THE_END_NS = 50_000_000


class AccountReporter:
    """Of one side; on the event loop.

    figures, session, driver, clock : the side's parts.
    """

    def __init__(self, figures: Figures, session: Session, driver: LinkDriver, clock: Clock) -> None:
        self._figures, self._session, self._driver, self._clock = figures, session, driver, clock
        self._reported_ns: int | None = None

    def look(self) -> None:
        """Tell it if it is time, or if the peer asks; call this regularly."""
        with self._driver.lock:
            paired, owes = self._session.peer is not None, self._session.accounts.owes
        if paired and (owes or self._is_due(EVERY_NS)):
            self._report(final=False)

    def end(self) -> bool:
        """Tell it after control has stopped. Does the peer know it now? Call this again until it does."""
        if self._is_due(AT_THE_END_NS):
            self._report(final=True)
        with self._driver.lock:
            return self._session.accounts.known

    def _is_due(self, every_ns: int) -> bool:
        return self._reported_ns is None or self._clock() - self._reported_ns >= every_ns

    def _report(self, *, final: bool) -> None:
        values = self._figures.account(final=final)
        self._reported_ns = self._clock()
        with self._driver.lock:
            self._session.accounts.report(values, final=final)
        self._driver.arm()
