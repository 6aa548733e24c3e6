"""Which browser has which seat of a world with several hands, and the way of its requests to the page of that seat.

The page's address leads a browser to the next free seat, or with ``?name=alice`` to the seat of that name; any other
name is written at the hand in the next free seat. The seat is then part of the address, and a cookie keeps it for this
browser, so a page that is reloaded keeps its hand. A seat is free again some seconds after its last page has closed.
"""

from __future__ import annotations

import asyncio
import hmac
import re
import secrets
import time
from collections.abc import AsyncIterator, Callable, Collection, Mapping
from contextlib import asynccontextmanager, suppress
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from types import TracebackType
from typing import Protocol

from hapnet.errors import HapnetError
from hapnet.ext.page.entrance import Answered, Entrance, Inner, Visit
from hapnet.ext.page.history import History
from hapnet.ext.page.server import free_port, url_of
from hapnet.ext.page.viser_page import ViserPage

RELOAD_S = 3.0
"""A closed page keeps its seat for so long, as it may only be reloaded [s]."""

LOADING_S = 30.0
"""A seat is kept for so long for a browser that was led to it, until its page opens a WebSocket [s]."""

_COOKIE = "hapnet"
_NAME = re.compile(r"\w[\w .'-]{0,31}")
_NAMES = "up to 32 letters, digits and spaces, such as alice"


class SeatFull(HapnetError):
    """Nobody else can take this seat, or any; the text is for people."""


class BrowserSeat:
    """A seat. key : what the browser that has it shows; empty: none has it.

    pages : its open WebSockets. kept_until_s : for a page that loads, or reloads. closing : its device is ending.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.key = ""
        self.pages = 0
        self.kept_until_s = 0.0
        self.closing = False

    def taken(self, now_s: float) -> bool:
        """Whether a browser has it."""
        return self.pages > 0 or self.closing or now_s < self.kept_until_s


class Seating:
    """The seats, and who has them. names : of the seats. now_s : a monotonic clock [s].

    Attributes: labels, the names of those who have the seats, by the names of the seats.
    """

    def __init__(self, names: Collection[str], now_s: Callable[[], float] = time.monotonic) -> None:
        self.seats: Mapping[str, BrowserSeat] = {name: BrowserSeat(name) for name in names}
        self.labels = {name: name for name in names}
        self._now_s = now_s

    def choose(self, wanted: str, elsewhere: Collection[str] = ()) -> BrowserSeat:
        """Keep a seat for a browser that gives this name (empty: none). elsewhere : seats that other devices have.

        Raises SeatFull: the seat of that name is taken, or all are, or it is no name.
        """
        if wanted and not _NAME.fullmatch(wanted):
            raise SeatFull(f"The name in the address must be {_NAMES}.")
        now_s = self._now_s()
        free = [seat for seat in self.seats.values() if not seat.taken(now_s) and seat.name not in elsewhere]
        if wanted in self.seats:
            if self.seats[wanted] not in free:
                raise SeatFull(f"The seat {wanted} is taken. {self._others(free)}")
            seat = self.seats[wanted]
        elif not free:
            raise SeatFull(self._all_taken())
        else:
            seat = free[0]
        self.labels[seat.name], seat.kept_until_s = wanted or seat.name, now_s + LOADING_S
        return seat

    def admit(self, seat: BrowserSeat, key: str) -> str:
        """Let a browser that shows this key load the page of a seat; returns the key that it is to show from now on.

        Raises SeatFull: another browser has it.
        """
        now_s = self._now_s()
        if not seat.closing and _same(seat.key, key):
            return seat.key
        if seat.pages or seat.closing:
            free = [other for other in self.seats.values() if not other.taken(now_s)]
            raise SeatFull(f"The seat {seat.name} is taken. {self._others(free)}")
        seat.key, seat.kept_until_s = secrets.token_urlsafe(16), now_s + LOADING_S
        return seat.key

    def open(self, seat: BrowserSeat) -> None:
        """Count a WebSocket."""
        seat.pages += 1
        seat.kept_until_s = 0.0

    def close(self, seat: BrowserSeat) -> None:
        """Count a WebSocket that has closed; the seat is kept for `RELOAD_S`."""
        seat.pages -= 1
        if not seat.pages:
            seat.kept_until_s = self._now_s() + RELOAD_S

    def empty(self, seat: BrowserSeat) -> None:
        """Nobody has the seat any more."""
        seat.key, seat.kept_until_s, seat.closing = "", 0.0, False

    def _all_taken(self) -> str:
        seats = (
            "The seat of this world is" if len(self.seats) == 1 else f"All {len(self.seats)} seats of this world are"
        )
        return f"{seats} taken. Reload this page when somebody has left."

    def _others(self, free: list[BrowserSeat]) -> str:
        if not free:
            return self._all_taken()
        return f"Free: {', '.join(seat.name for seat in free)}; give one as ?name=, or no name."


class Occupant(Protocol):
    """The viser server of a page, and the device's side, while somebody has the seat."""

    inner: Inner

    def close(self) -> None:
        """End both; may block."""


class SeatEntrance(Entrance):
    """Leads browsers to seats. occupy : makes a seat's `Occupant`; may block. page : the viser server that has files.

    elsewhere : the seats that devices without a page have; may block.
    """

    def __init__(
        self,
        seating: Seating,
        occupy: Callable[[BrowserSeat], Occupant],
        page: Inner,
        elsewhere: Callable[[], Collection[str]] = tuple,
    ) -> None:
        self._seating, self._occupy, self._page, self._elsewhere = seating, occupy, page, elsewhere
        self._occupants: dict[BrowserSeat, asyncio.Task[Occupant]] = {}
        self._leaving: dict[BrowserSeat, asyncio.Task[None]] = {}

    async def file(self, visit: Visit) -> tuple[Inner, str, str] | Answered:
        name, _, path = visit.path.partition("/")
        seat = self._seating.seats.get(name)
        try:
            if seat is None:
                if visit.path:
                    return Answered(HTTPStatus.NOT_FOUND, "There is no such page.")
                elsewhere = await asyncio.to_thread(self._elsewhere)
                return Answered(HTTPStatus.FOUND, "", f"{self._seating.choose(visit.name, elsewhere).name}/")
            if path:
                return self._page, path, ""
            key = self._seating.admit(seat, _key(visit.cookie))
        except SeatFull as full:
            return Answered(HTTPStatus.SERVICE_UNAVAILABLE, str(full))
        return self._page, "", f"{_COOKIE}={key}; HttpOnly; SameSite=Strict"

    def refusal(self, visit: Visit) -> str:
        seat = self._seating.seats.get(visit.path.partition("/")[0])
        has_it = seat is not None and not seat.closing and _same(seat.key, _key(visit.cookie))
        return "" if has_it else "this browser does not have that seat: open the page again"

    @asynccontextmanager
    async def room(self, visit: Visit) -> AsyncIterator[Inner]:
        seat = self._seating.seats[visit.path.partition("/")[0]]
        self._seating.open(seat)
        try:
            if seat in self._leaving:
                self._leaving.pop(seat).cancel()
            if seat not in self._occupants:
                self._occupants[seat] = asyncio.create_task(asyncio.to_thread(self._occupy, seat))
            yield (await asyncio.shield(self._occupants[seat])).inner
        finally:
            self._seating.close(seat)
            if not seat.pages:
                self._leaving[seat] = asyncio.create_task(self._leave(seat))

    async def _leave(self, seat: BrowserSeat) -> None:
        await asyncio.sleep(RELOAD_S)
        self._leaving.pop(seat, None)
        seat.closing = True  # nobody takes it until its device has ended
        occupant = self._occupants.pop(seat, None)
        if occupant is not None:
            await _end(occupant)
        self._seating.empty(seat)

    async def close(self) -> None:
        """End what all seats have."""
        for task in self._leaving.values():
            task.cancel()
        await asyncio.gather(*map(_end, self._occupants.values()))
        self._occupants.clear()


class SeatsServer:
    """The address `url`, until `close`. Arguments as of `SeatEntrance` and `hapnet.ext.page.server.serve`."""

    def __init__(
        self,
        seating: Seating,
        occupy: Callable[[BrowserSeat], Occupant],
        elsewhere: Callable[[], Collection[str]],
        host: str,
        port: int,
    ) -> None:
        self.port = free_port(host, port)
        self._files = ViserPage(History(), None)  # nobody sees this page: it has the files, and the gate's event loop

        from hapnet.ext.page.gate import Gate, new_token

        token = new_token()
        self._entrance = SeatEntrance(seating, occupy, self._files.connect, elsewhere)
        self._gate = Gate(self._entrance, token, host, self._files.version)
        asyncio.run_coroutine_threadsafe(self._gate.open(self.port), self._files.loop).result()
        self.url: str = url_of(host, self.port, token)

    def close(self) -> None:
        """Close all pages, end what their seats have, and stop serving."""
        asyncio.run_coroutine_threadsafe(self._gate.close(), self._files.loop).result()
        asyncio.run_coroutine_threadsafe(self._entrance.close(), self._files.loop).result()
        self._files.end_drawing()
        self._files.stop()

    def __enter__(self) -> SeatsServer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


async def _end(occupant: asyncio.Task[Occupant]) -> None:
    with suppress(HapnetError):  # it could not be made, as whoever awaited it has been told
        await asyncio.to_thread((await occupant).close)


def _same(key: str, shown: str) -> bool:
    """Whether a browser shows this key; not if there is none."""
    return bool(key) and hmac.compare_digest(key.encode(), shown.encode(errors="replace"))


def _key(cookie: str) -> str:
    """The key in a browser's cookies; empty: none."""
    try:
        found = SimpleCookie(cookie).get(_COOKIE)
    except CookieError:
        return ""
    return "" if found is None else found.value
