"""A relay beside a program without a loop, and pytest's fixture that starts one."""

import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from netem import NetemError
from netem.background import BackgroundRelay
from netem.relay import format_address

WAIT_S = 30.0


def udp_server() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", 0))
    made.settimeout(WAIT_S)
    return made


def test_datagrams_cross_late_and_the_words_change_while_it_runs() -> None:
    with (
        udp_server() as server,
        udp_server() as client,
        BackgroundRelay(format_address(server.getsockname()), "delay 30ms", "") as relay,
    ):
        began = time.monotonic()
        client.sendto(b"one", relay.address)
        assert server.recv(100) == b"one"
        assert time.monotonic() - began >= 0.030
        relay.change(up="loss 100%")
        client.sendto(b"two", relay.address)
        while not relay.stats.up.lost:
            pass
        relay.change(up="")
        client.sendto(b"three", relay.address)
        assert server.recv(100) == b"three"
        assert str(relay.stats.down.profile) == ""


def test_faults_end_with_the_block() -> None:
    with (
        udp_server() as server,
        udp_server() as client,
        BackgroundRelay(format_address(server.getsockname()), "delay 1ms") as relay,
    ):
        with relay.faults("at 0s: down"):
            client.sendto(b"lost", relay.address)
            while not relay.stats.up.lost_down:
                pass
        client.sendto(b"kept", relay.address)
        assert server.recv(100) == b"kept"
        assert relay.stats.up.profile == "delay 1ms"


def test_a_program_of_streams_meets_the_link_too() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(WAIT_S)
        with BackgroundRelay(
            format_address(server.getsockname()), "delay 5ms loss 20%", protocol="tcp", seed=2
        ) as relay:
            with socket.create_connection(relay.address[:2], WAIT_S) as client:
                met, _ = server.accept()
                with met:
                    client.sendall(bytes(range(256)) * 100)
                    client.shutdown(socket.SHUT_WR)
                    with met.makefile("rb") as file:
                        assert file.read() == bytes(range(256)) * 100
            assert relay.stats.up.lost > 0


@pytest.mark.parametrize(
    ("to", "words", "named"),
    [("127.0.0.1", "", "127.0.0.1"), ("127.0.0.1:9", "dely 4ms", "dely"), ("127.0.0.1:9", "loss 200%", "loss")],
)
def test_what_is_wrong_is_said_before_it_runs(to: str, words: str, named: str) -> None:
    with pytest.raises(NetemError, match=named), BackgroundRelay(to, words):
        pass


def test_the_fixture_ends_its_relays_with_the_test(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text(
        "import socket, threading\n"
        "def test_crosses(netem_relay):\n"
        "    server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n"
        "    server.bind(('127.0.0.1', 0))\n"
        "    relay = netem_relay('127.0.0.1:%d' % server.getsockname()[1], 'delay 1ms')\n"
        "    server.sendto(b'x', relay.address)\n"
        "    assert server.recv(10) == b'x'\n"
        "    server.close()\n"
        "def test_nothing_runs_on():\n"
        "    assert 'netem' not in [thread.name for thread in threading.enumerate()]\n",
        "utf-8",
    )
    words = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:netem",
        "-p",
        "netem.pytest_plugin",
        "-p",
        "no:cacheprovider",
    ]
    done = subprocess.run([*words, str(tmp_path)], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_importing_netem_needs_neither_zenoh_nor_numpy() -> None:
    blocked = "import sys; [sys.modules.__setitem__(name, None) for name in ('zenoh', 'numpy', 'matplotlib', 'rich')]; "
    done = subprocess.run([sys.executable, "-c", blocked + "import netem"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
