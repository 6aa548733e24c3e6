"""Serving the page: addresses, what is said, what is not imported."""

import re
import socket
import subprocess
import sys

import pytest

from hapnet.errors import InvalidParameter, MissingLibrary
from hapnet.ext.page.history import History
from hapnet.ext.page.server import serve


def test_without_viser_a_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingLibrary, match=r"viser.*extra `view`.*install viser"):
        serve(History(), port=0)


def test_a_taken_port_gives_the_next_free_one_and_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser", reason="the live page's library is not installed")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with serve(History(), port=port) as page:
            assert page.port > port
            assert re.fullmatch(rf"http://127\.0\.0\.1:{page.port}/[\w-]{{22}}/", page.url)
            assert not page.watched
            socket.create_connection(("127.0.0.1", page.port), timeout=5.0).close()
    page.close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", page.port), timeout=5.0)
    out = capfd.readouterr()
    assert out.out + out.err == ""


@pytest.mark.parametrize("host", ["::1", "::"])
def test_an_ipv6_address_is_in_brackets_as_a_browser_wants_it(host: str) -> None:
    pytest.importorskip("viser", reason="the live page's library is not installed")
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("there is no IPv6 here")
    with serve(History(), host=host, port=0) as page:
        assert page.url.startswith(f"http://[::1]:{page.port}/")
        socket.create_connection(("::1", page.port), timeout=5.0).close()


@pytest.mark.parametrize(
    ("host", "port", "words"),
    [("192.0.2.1", 0, "host"), ("nowhere.invalid", 0, "host"), ("127.0.0.1", 65536, "port"), ("127.0.0.1", -1, "port")],
)
def test_an_address_that_cannot_be_is_refused_with_a_line(host: str, port: int, words: str) -> None:
    pytest.importorskip("viser", reason="the live page's library is not installed")
    with pytest.raises(InvalidParameter, match=words):
        serve(History(), host=host, port=port)


PROBED = """
import socket
from hapnet.ext.page.history import History
from hapnet.ext.page.server import serve

with serve(History(), port=0) as page:
    for said in (b"", b"\\0\\1\\2", b"GET / HTTP/1.1\\r\\n\\r\\n", b"POST / HTTP/1.1\\r\\n\\r\\n"):
        with socket.create_connection(("127.0.0.1", page.port), timeout=30) as probe:
            probe.sendall(said)
            probe.shutdown(socket.SHUT_WR)
            while probe.recv(4096):  # until the page has dealt with it
                pass
"""


def test_who_connects_and_is_no_browser_leaves_no_traceback() -> None:
    """As a port scan does. In a process of its own: pytest takes what Python's logging would print."""
    pytest.importorskip("viser", reason="the live page's library is not installed")
    done = subprocess.run([sys.executable, "-c", PROBED], capture_output=True, text=True, timeout=100)
    assert done.returncode == 0
    assert not done.stderr
