"""Who may use the live page, and that viser listens nowhere."""

import asyncio
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")

import msgspec
import viser
import zstandard
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus
from websockets.typing import Origin, Subprotocol

from hapnet.ext.page.gate import is_same_origin, names_this_machine
from hapnet.ext.page.history import History
from hapnet.ext.page.offered import LONGEST_TEXT, Offered
from hapnet.ext.page.server import PageServer, serve

Message = dict[str, Any]


@pytest.fixture(scope="module")
def page() -> Iterator[PageServer]:
    with serve(History(), port=0) as server:
        yield server


def web_socket(page: PageServer, path: str, origin: str | None, host: str | None = None) -> int:
    """The HTTP status of the handshake; 101: the page is open, and something came."""

    async def ask() -> int:
        protocol = Subprotocol(f"viser-v{viser.__version__}")
        url = f"ws://{host or '127.0.0.1'}:{page.port}{path}"
        given = None if origin is None else Origin(origin)
        try:
            async with connect(
                url, host="127.0.0.1", port=page.port, origin=given, subprotocols=[protocol], max_size=None
            ) as browser:
                assert await browser.recv()
                return 101
        except InvalidStatus as error:
            return error.response.status_code

    return asyncio.run(ask())


def token(page: PageServer) -> str:
    return page.url.rstrip("/").rpartition("/")[2]


def test_the_page_itself_is_let_in(page: PageServer) -> None:
    assert web_socket(page, f"/{token(page)}", f"http://127.0.0.1:{page.port}") == 101
    assert web_socket(page, f"/{token(page)}", f"http://localhost:{page.port}", "localhost") == 101


@pytest.mark.parametrize(
    "origin", [None, "http://evil.example", "null", "", "http://127.0.0.1:1", "https://127.0.0.1", "file://", "http://"]
)
def test_a_foreign_or_absent_origin_is_refused(page: PageServer, origin: str | None) -> None:
    assert web_socket(page, f"/{token(page)}", origin) == 403


@pytest.mark.parametrize("wrong", ["", "/", "/x", "/{}x", "//{}", "/x/{}", "/%2e/{}", "/?{}", "/{}.", "/\u00e9"])
def test_a_wrong_token_is_refused(page: PageServer, wrong: str) -> None:
    assert web_socket(page, wrong.format(token(page)), f"http://127.0.0.1:{page.port}") == 403


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example", "192.0.2.1"])
def test_a_name_that_others_point_here_is_refused(page: PageServer, host: str) -> None:
    """DNS rebinding: the page's origin and the host agree, and the token is right."""
    assert web_socket(page, f"/{token(page)}", f"http://{host}:{page.port}", host) == 403


def test_the_files_of_the_page_need_all_that_too(page: PageServer) -> None:
    with urllib.request.urlopen(page.url) as answer:
        assert answer.status == 200
        assert b"<html" in answer.read(2000)
        assert answer.headers["Referrer-Policy"] == "no-referrer"
        assert answer.headers["X-Frame-Options"] == "DENY"
    bare = page.url.rstrip("/").removesuffix(token(page))
    for url, headers, words in (
        (bare, {}, "address that hapnet printed"),
        (f"{bare}x/", {}, "address that hapnet printed"),
        (page.url, {"Host": "evil.example"}, "Host is evil.example"),
        (page.url, {"Origin": "http://evil.example"}, "Origin is http://evil.example"),
    ):
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(urllib.request.Request(url, headers=headers))
        assert refused.value.code == 403
        assert words in refused.value.read().decode()


def test_each_start_has_another_token_and_one_may_be_given() -> None:
    tokens = []
    for given in ("", "", "mine"):
        with serve(History(), port=0, token=given) as page:
            tokens.append(token(page))
    assert tokens[2] == "mine"
    assert len(set(tokens)) == 3
    assert all(len(one) >= 22 for one in tokens[:2])


def test_only_the_gate_listens(page: PageServer) -> None:
    """Of this process's sockets only one listens, on loopback: viser has no port that could be reached around it."""
    tables = [Path("/proc/net/tcp"), Path("/proc/net/tcp6")]
    if not tables[0].exists():
        pytest.skip("only Linux says it")
    own = {
        link.removeprefix("socket:[").removesuffix("]")
        for entry in Path("/proc/self/fd").iterdir()
        if entry.exists() or entry.is_symlink()
        if (link := _link(entry)).startswith("socket:[")
    }
    rows = [line.split() for table in tables if table.exists() for line in table.read_text().splitlines()[1:]]
    listening = [row[1] for row in rows if row[3] == "0A" and row[9] in own]
    assert f"0100007F:{page.port:04X}" in listening
    before = len(listening)
    with serve(History(), port=0):
        rows = [line.split() for table in tables if table.exists() for line in table.read_text().splitlines()[1:]]
        own = {_link(entry).removeprefix("socket:[").removesuffix("]") for entry in Path("/proc/self/fd").iterdir()}
        assert len([row for row in rows if row[3] == "0A" and row[9] in own]) == before + 1


def _link(entry: Path) -> str:
    try:
        return str(entry.readlink())
    except OSError:
        return ""


@pytest.mark.parametrize(
    ("header", "host", "known"),
    [
        ("127.0.0.1:8080", "127.0.0.1", True),
        ("127.0.0.1", "127.0.0.1", True),
        ("localhost:9000", "127.0.0.1", True),  # through a tunnel
        ("[::1]:8080", "127.0.0.1", True),
        ("LOCALHOST.:8080", "127.0.0.1", True),
        ("192.168.0.2:8080", "127.0.0.1", False),
        ("192.168.0.2:8080", "0.0.0.0", True),
        ("[fe80::1]:8080", "::", True),
        ("robot:8080", "robot", True),
        ("robot.evil.example:8080", "robot", False),
        ("evil.example", "0.0.0.0", False),
        ("", "", False),
        ("[", "0.0.0.0", False),
        ("127.0.0.1@evil.example", "127.0.0.1", False),
        ("2130706433", "0.0.0.0", False),
    ],
)
def test_what_names_this_machine(header: str, host: str, known: bool) -> None:
    assert names_this_machine(header, host) is known


def test_the_same_origin_has_the_same_host_and_port() -> None:
    assert is_same_origin("http://127.0.0.1:8080", "127.0.0.1:8080")
    assert is_same_origin("https://robot.example", "robot.example")
    for other in ("http://127.0.0.1:8081", "ws://127.0.0.1:8080", "127.0.0.1:8080", "null", "http://127.0.0.1:8080/"):
        assert not is_same_origin(other, "127.0.0.1:8080")


# -- what a page may send ----------------------------------------------------------------------------------------------


def frame(*messages: Message) -> bytes:
    data = msgspec.msgpack.encode({"messages": messages})
    packed = zstandard.compress(data)
    return len(data).to_bytes(8, "little") + len(packed).to_bytes(8, "little") + packed


def control(kind: str, uuid: str, **props: object) -> Message:
    return {"type": kind, "uuid": uuid, "value": None, "props": {"visible": True, "disabled": False, **props}}


def update(uuid: str, value: object, **more: object) -> bytes:
    return msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value, **more}})


@pytest.fixture
def offered() -> Offered:
    found = Offered()
    found.learn(
        frame(
            control("GuiDropdownMessage", "choice", options=("pspm", "zoh")),
            control("GuiSliderMessage", "delay", min=0.0, max=500.0),
            control("GuiCheckboxMessage", "alike"),
            control("GuiButtonMessage", "pause"),
            control("GuiTextMessage", "words"),
            control("GuiUploadButtonMessage", "file"),
            control("GuiDropdownMessage", "fixed", options=("a",), disabled=True),
            control("GuiButtonMessage", "hidden", visible=False),
        )
    )
    return found


@pytest.mark.parametrize(
    ("uuid", "right", "wrong"),
    [
        ("choice", ["zoh", "pspm"], ["evilmod:x", "", 1, None, True]),
        ("delay", [0, 0.0, 40, 500.0], [-0.1, 500.1, float("nan"), float("inf"), "40", True, None]),
        ("alike", [True, False], [1, 0, "true", None]),
        ("pause", [True], [False, 1, "x"]),
        ("words", ["", "delay 40ms"], [1, "x" * (LONGEST_TEXT + 1), None]),
        ("fixed", [], ["a"]),
        ("hidden", [], [True]),
        ("unknown", [], [True, "zoh", 1.0]),
    ],
)
def test_a_value_is_one_that_its_control_offers(
    offered: Offered, uuid: str, right: list[object], wrong: list[object]
) -> None:
    for value in right:
        checked = offered.checked(update(uuid, value))
        assert checked is not None
        assert msgspec.msgpack.decode(checked)["updates"] == {"value": value}
        assert offered.checked(update(uuid, value, removed=True)) is None  # no property but the value
    assert [value for value in wrong if offered.checked(update(uuid, value)) is not None] == []


def test_what_is_offered_may_change(offered: Offered) -> None:
    offered.learn(frame({"type": "GuiUpdateMessage", "uuid": "choice", "updates": {"options": ("own", "zoh")}}))
    assert offered.checked(update("choice", "own")) is not None
    assert offered.checked(update("choice", "pspm")) is None
    offered.learn(frame({"type": "GuiRemoveMessage", "uuid": "choice"}))
    assert offered.checked(update("choice", "own")) is None


def test_a_file_comes_in_the_parts_that_were_said(offered: Offered) -> None:
    def start(**changes: object) -> bytes | None:
        message = {
            "type": "FileTransferStartUpload", "source_component_uuid": "file", "transfer_uuid": "t",
            "filename": "a.stl", "mime_type": "", "part_count": 2, "size_bytes": 5, **changes,
        }  # fmt: skip
        return offered.checked(msgspec.msgpack.encode(message))

    def part(index: int, content: bytes, transfer: str = "t") -> bytes | None:
        message = {
            "type": "FileTransferPart", "source_component_uuid": "file", "transfer_uuid": transfer,
            "part_index": index, "content": content,
        }  # fmt: skip
        return offered.checked(msgspec.msgpack.encode(message))

    assert part(0, b"abc") is None  # nothing has begun
    assert start(source_component_uuid="choice") is None
    assert start(size_bytes=2**40) is None
    assert start() is not None
    assert start(transfer_uuid="another") is None  # one at a time
    assert part(0, b"abc", "other") is None
    assert part(2, b"abc") is None
    assert part(0, b"abcdef") is None  # more than was said
    assert part(0, b"abc") is not None
    assert part(0, b"abc") is None  # twice
    assert part(1, b"d") is None  # less than was said
    assert part(1, b"de") is not None
    assert start(transfer_uuid="another") is not None
