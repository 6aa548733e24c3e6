"""Which browser gets which seat, and who is told that there is none."""

import asyncio
import urllib.error
import urllib.request
from collections.abc import Iterator
from http.cookiejar import CookieJar
from typing import ClassVar

import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")

import viser
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus
from websockets.typing import Origin, Subprotocol

from hapnet.ext.page.history import History
from hapnet.ext.page.seating import LOADING_S, RELOAD_S, BrowserSeat, SeatFull, Seating, SeatsServer
from hapnet.ext.page.viser_page import ViserPage
from tests.support.processes import until


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def seating(*names: str) -> tuple[Seating, Clock]:
    clock = Clock()
    return Seating(names, clock), clock


def test_each_gets_the_next_free_seat_and_the_last_none() -> None:
    found, _ = seating("seat1", "seat2")
    assert [found.choose("").name, found.choose("Zoe").name] == ["seat1", "seat2"]
    assert found.labels == {"seat1": "seat1", "seat2": "Zoe"}
    with pytest.raises(SeatFull, match="All 2 seats of this world are taken"):
        found.choose("")


def test_a_name_of_a_seat_is_that_seat_and_nobody_elses() -> None:
    found, _ = seating("alice", "bob", "carol")
    assert found.choose("bob").name == "bob"
    with pytest.raises(SeatFull, match=r"The seat bob is taken\. Free: alice, carol"):
        found.choose("bob")
    assert found.choose("", elsewhere={"alice"}).name == "carol"
    with pytest.raises(SeatFull, match="All 3 seats"):
        found.choose("", elsewhere={"alice"})


@pytest.mark.parametrize("name", ["<b>", "x" * 33, " alice", "a/b", "a\nb"])
def test_what_is_no_name_is_said(name: str) -> None:
    with pytest.raises(SeatFull, match="up to 32 letters"):
        seating("alice")[0].choose(name)


def test_a_browser_that_never_came_and_one_that_has_left_lose_their_seat() -> None:
    found, clock = seating("alice")
    seat = found.choose("")
    clock.now_s += LOADING_S + 0.1
    assert found.choose("") is seat
    found.open(seat)
    clock.now_s += 1000.0
    with pytest.raises(SeatFull, match="The seat of this world is taken"):
        found.choose("")
    found.close(seat)
    clock.now_s += RELOAD_S - 0.1
    with pytest.raises(SeatFull):
        found.choose("")
    clock.now_s += 0.2
    assert found.choose("") is seat


def test_a_page_is_reloaded_by_the_browser_that_has_it_only() -> None:
    found, _ = seating("alice", "bob")
    seat = found.choose("alice")
    key = found.admit(seat, "")
    found.open(seat)
    assert found.admit(seat, key) == key
    for other in ("", "x", "\u00e9"):
        with pytest.raises(SeatFull, match=r"The seat alice is taken\. Free: bob"):
            found.admit(seat, other)
    found.close(seat)
    seat.closing = True
    with pytest.raises(SeatFull):
        found.admit(seat, key)
    found.empty(seat)
    assert found.admit(seat, "") != key


class Sitting:
    """Somebody in a seat, with a page that shows nothing."""

    made: ClassVar[list["Sitting"]] = []

    def __init__(self, seat: BrowserSeat) -> None:
        self.seat, self.ended = seat, False
        self._page = ViserPage(History(), None)
        self.inner = self._page.connect
        self.made.append(self)

    def close(self) -> None:
        self._page.end_drawing()
        self._page.stop()
        self.ended = True


@pytest.fixture
def server() -> Iterator[SeatsServer]:
    Sitting.made.clear()
    with SeatsServer(Seating(("alice", "bob")), Sitting, lambda: {"bob"}, "127.0.0.1", 0) as served:
        yield served


def browser() -> tuple[urllib.request.OpenerDirector, CookieJar]:
    jar = CookieJar()
    return urllib.request.build_opener(urllib.request.HTTPCookieProcessor(jar)), jar


def refused(url: str) -> tuple[int, str]:
    with pytest.raises(urllib.error.HTTPError) as error:
        browser()[0].open(url)
    return error.value.code, error.value.read().decode()


async def page(url: str, cookies: CookieJar) -> bytes:
    """The first message of the page's WebSocket."""
    place = url.replace("http", "ws").rstrip("/")
    async with connect(
        place, origin=Origin("/".join(url.split("/")[:3])),
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")], max_size=None,
        additional_headers={"Cookie": "; ".join(f"{one.name}={one.value}" for one in cookies)},
    ) as opened:  # fmt: skip
        return bytes(await opened.recv())


def test_a_browser_is_led_to_its_seat_and_the_next_one_is_told(server: SeatsServer) -> None:
    """Another device has bob's seat."""
    opener, jar = browser()
    with opener.open(server.url) as answer:
        assert answer.geturl() == f"{server.url}alice/"
        assert b"<html" in answer.read(2000)
    assert asyncio.run(page(f"{server.url}alice/", jar))
    for url, says in (
        (server.url, "All 2 seats of this world are taken"),
        (f"{server.url}?name=alice", "The seat alice is taken"),
        (f"{server.url}?name=%3Cscript%3E", "up to 32 letters"),
    ):
        code, text = refused(url)
        assert (code, text.count("<p>")) == (503, 1)
        assert says in text
    assert refused(f"{server.url}nobody/")[0] == 404
    with pytest.raises(InvalidStatus, match="403"):
        asyncio.run(page(f"{server.url}alice/", CookieJar()))
    until(lambda: Sitting.made[0].ended)
    with browser()[0].open(f"{server.url}?name=alice") as answer:
        assert answer.status == 200


def test_a_page_that_is_reloaded_keeps_its_device(server: SeatsServer) -> None:
    opener, jar = browser()
    for _ in range(3):
        opener.open(f"{server.url}?name=alice" if not len(jar) else f"{server.url}alice/").close()
        assert asyncio.run(page(f"{server.url}alice/", jar))
    assert len(Sitting.made) == 1
