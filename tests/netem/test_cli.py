"""The command: what it prints, its JSON, and one line with exit code 2 for bad input."""

import json
import os
import pty
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from netem import PRESETS
from netem.cli import main
from tests.conftest import mostly_slow


def test_profiles_lists_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["profiles"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:]] == list(PRESETS)
    assert main(["profiles", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out) == dict(PRESETS)


def test_show_prints_the_profile_back_with_what_it_does(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "latency 40ms 10ms loss 10%", "--seed", "3", "--count", "2000"]) == 0
    out = capsys.readouterr().out
    assert "delay 40ms 10ms loss 10%" in out
    assert "#" in out


def test_show_json_is_the_object_alone(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = ["show", "delay 40ms 10ms 50% distribution normal loss 10%", "--count", "20000"]
    assert main([*words, "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["offered"] == 20_000 == found["delivered"] + found["lost"]
    assert found["lost"] == pytest.approx(2000, abs=5 * (20_000 * 0.1 * 0.9) ** 0.5)
    assert found["delay_p50_ms"] == pytest.approx(40.0, rel=0.03)
    assert found["delay_std_ms"] == pytest.approx(10.0, rel=0.05)
    assert sum(found["counts"]) == found["delivered"]
    assert main([*words, "--json", str(tmp_path / "out.json")]) == 0
    assert json.loads((tmp_path / "out.json").read_text()) == found


def test_show_takes_a_preset_with_overrides(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "--profile", "geo", "--delay", "300ms", "--loss", "0%", "--count", "10", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["profile"].startswith("delay 300ms 10ms")


def test_show_counts_what_is_resent(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "loss 100%", "--resend", "3 2ms", "--count", "50"]) == 0
    assert "resent     150 times, recovered 0 (0.00 %)" in capsys.readouterr().out
    assert main(["show", "--profile", "4g", "--resend", "0", "--loss", "0%", "--count", "50", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["profile"] == "delay 35ms 3ms 25% distribution normal loss 0% rate 6mbit"
    assert (found["resent"], found["recovered"]) == (0, 0)


@pytest.mark.parametrize(
    "words", [["show", "trace {}"], ["show", "csv {}"], ["udp", "--listen", ":0", "--to", ":9", "--timeline", "{}"]]
)
def test_a_pipe_is_refused_and_not_waited_for(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert main([word.format(tmp_path / "pipe") for word in words]) == 2
    assert "a plain file" in capsys.readouterr().err


def test_a_link_that_delivers_nothing_has_no_delays(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "loss 100%", "--count", "10", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["delay_p50_ms"] is found["delay_std_ms"] is found["delay_correlation"] is None
    assert main(["show", "loss 100%", "--count", "10"]) == 0


@pytest.mark.parametrize(
    "command",
    [
        [],
        ["--help"],
        ["show", "--help"],
        ["profiles", "--help"],
        *([name, "--help"] for name in ("udp", "zenoh", "bench")),
    ],
)
def test_help(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command) == 0
    assert "Usage: netem" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "named"),
    [
        (["show", "dely 40ms"], "dely"),
        (["show", "--profile", "dialup"], "dialup"),
        (["show", "loss 1%", "--loss", "2%"], "leave one of the two out"),
        (["show", "--interval", "5"], "interval"),
        (["show", "resend", "3"], "resend: ''"),
        (["show", "resend 3 8"], "resend: '8' is not allowed; allowed: a time"),
        (["show", "resend 101 8ms"], "resend: '101' is not allowed; allowed: a whole number from 0 to 100"),
        (["show", "resend 3 8ms sorted"], "'sorted'"),
        (["show", "resend 3 8ms", "--resend", "2 8ms"], "leave one of the two out"),
        (["show", "--resend", "3 8ms 5ms"], "one setting"),
        (["show", "--count", "many"], "--count"),
        (["show", "--frequency", "5"], "--frequency"),
        (["show", "--count", "1", "--json", "/nowhere/at/all"], "/nowhere/at/all"),
        (["show", "--count", "1", "--png", "/nowhere/at/all"], "/nowhere/at/all"),
        (["relay"], "relay"),
        (["udp", "--to", "127.0.0.1:9"], "--listen"),
        (["udp", "--listen", "nonsense", "--to", "127.0.0.1:9"], "listen: 'nonsense'"),
        (["tcp", "--listen", "nonsense", "--to", "127.0.0.1:9"], "listen: 'nonsense'"),
        (["tcp", "--listen", "192.0.2.1:9", "--to", "127.0.0.1:9"], "cannot listen on 192.0.2.1:9"),
        (["tcp", "--listen", "127.0.0.1:0", "--to", "127.0.0.1:9", "corrupt", "1%"], "corrupt"),
        (["udp", "--listen", "127.0.0.1:0", "--to", "127.0.0.1"], "to: '127.0.0.1'"),
        (["udp", "--listen", "192.0.2.1:9", "--to", "127.0.0.1:9"], "cannot listen on 192.0.2.1:9"),
        (["udp", "--listen", "127.0.0.1:0", "--to", "127.0.0.1:9", "dely", "4ms"], "dely"),
        (["udp", "--listen", "127.0.0.1:0", "--to", "127.0.0.1:9", "--up", "loss 200%"], "--up: "),
        (["udp", "--listen", "127.0.0.1:0", "--to", "127.0.0.1:9", "--timeline", "at 5: up"], "timeline"),
        (["udp", "--listen", "127.0.0.1:0", "--to", "127.0.0.1:9", "--timeline", "/nowhere"], "/nowhere"),
        (["udp", "--listen", "127.0.0.1:0", "--to", "127.0.0.1:9", "--duration", "-1"], "--duration"),
        (["udp", "--listen", "127.0.0.1:0", "--to", "127.0.0.1:9", "--json", "/nowhere/at/all"], "/nowhere/at/all"),
        (["zenoh", "--listen", "nonsense", "--connect", "tcp/127.0.0.1:9"], "listen: 'nonsense'"),
        (
            ["zenoh", "--listen", "tcp/127.0.0.1:9", "--connect", "tcp/127.0.0.1:9"],
            "is the endpoint that is listened on; give another",
        ),
        (["zenoh", "--listen", "tcp/127.0.0.1:9", "--connect", "tcp/127.0.0.1:8", "-k", "a//b"], "key: 'a//b'"),
        (["zenoh", "--listen", "tcp/127.0.0.1:9", "--connect", "tcp/127.0.0.1:8", "--mode", "router"], "--mode"),
        (["bench", "everything"], "everything"),
        (["bench", "--runs", "0"], "--runs"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    command: list[str], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert named in captured.err


def test_show_takes_words_without_quotes_and_names(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "delay", "40ms", "loss", "1%", "--count", "10", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["profile"] == "delay 40ms loss 1%"
    assert main(["show", "geo", "--count", "10", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["profile"] == PRESETS["geo"]


@pytest.mark.parametrize("words", mostly_slow(["delay 40ms 10ms loss 10%", "loss 100%", ""], 1))
def test_show_draws_a_figure(words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "figure.png"
    assert main(["show", words, "--count", "500", "--png", str(target)]) == 0
    assert target.read_bytes().startswith(b"\x89PNG\r\n")
    assert capsys.readouterr().err == ""


def command(*words: str) -> list[str]:
    return [sys.executable, "-c", "import netem.cli as c; raise SystemExit(c.main())", *words]


def test_help_loads_neither_numpy_nor_a_relay() -> None:
    script = "import sys, netem.cli as c; c.main(['--help']); print(sorted(set(sys.modules) & set(sys.argv[1:])))"
    heavy = ["numpy", "zenoh", "matplotlib", "rich.console", "asyncio", "netem.link", "netem.relay"]
    done = subprocess.run([sys.executable, "-c", script, *heavy], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", mostly_slow(["udp", "zenoh"], 1))
def test_a_relay_stops_cleanly_with_its_figures(kind: str, number: int, tmp_path: Path) -> None:
    target = tmp_path / "figures.json"
    where = ["--listen", "127.0.0.1:0", "--to", "127.0.0.1:9"]
    if kind == "zenoh":
        with socket.create_server(("127.0.0.1", 0)) as free:
            where = ["--listen", f"tcp/127.0.0.1:{free.getsockname()[1]}", "--connect", "tcp/127.0.0.1:9"]
    words = ["--up", "delay 3ms", "--down", "lan", "--seed", "5", "--json", str(target)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command(kind, *where, *words), **pipes) as relay:  # type: ignore[call-overload]
        first = relay.stdout.readline()
        assert first.startswith("netem: relaying ")
        assert relay.stdout.readline().split()[1] == "s"  # one line with figures; the signal handlers are there
        relay.send_signal(number)
        out, err = relay.communicate(timeout=60)
    assert (relay.returncode, err) == (0, "")
    assert "delay 3ms" in out
    found = json.loads(target.read_text())
    assert (found["up"]["profile"], found["down"]["profile"], found["seed"]) == ("delay 3ms", PRESETS["lan"], 5)
    assert found["dropped"] == 0


def test_a_relay_ends_after_its_duration_and_prints_json_alone(capsys: pytest.CaptureFixture[str]) -> None:
    where = ["--listen", "127.0.0.1:0", "--to", "127.0.0.1:9"]
    assert main(["udp", *where, "--duration", "50ms", "--json", "-"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["elapsed_s"] >= 0.05
    assert "relaying" in captured.err


def test_a_relay_on_a_terminal_redraws_a_table() -> None:
    ours, theirs = pty.openpty()
    words = ["udp", "--listen", "127.0.0.1:0", "--to", "127.0.0.1:9", "--duration", "0.6"]
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    with subprocess.Popen(command(*words), stdout=theirs, stderr=theirs, env=environment) as relay:
        os.close(theirs)
        shown = b""
        try:
            while chunk := os.read(ours, 65_536):
                shown += chunk
        except OSError:  # the other end is closed
            os.close(ours)
    assert relay.returncode == 0
    assert shown.count(b"offered") >= 2
    assert b"\x1b[" in shown


def test_a_port_in_use_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        listen = f"127.0.0.1:{taken.getsockname()[1]}"
        assert main(["udp", "--listen", listen, "--to", "127.0.0.1:9"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert "in use" in captured.err
