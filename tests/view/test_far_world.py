"""`hapnet play` with the world on another host: real processes, without a browser."""

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")

from hapnet import cli
from hapnet.commands.options import ZenohOptions
from hapnet.commands.side import PAGE
from hapnet.ext.page.commands.far_world import FarWorld, MouseHand, fitting
from hapnet.ext.page.commands.play import led
from hapnet.ext.page.history import History
from hapnet.params import Params
from hapnet.processes.child import FrameWriter, frames
from hapnet.recording.mcap import read_recording
from hapnet.recording.telemetry import Status
from hapnet.transport.config import free_address
from tests.conftest import ENVIRONMENT, mostly_slow
from tests.support.processes import HAPNET, LIMIT_S, Program, read_json, started, until


def world_status(**about: object) -> Status:
    return Status("world", 0, 1, False, False, "", about, {}, {})


def test_axes_and_coupling_are_the_worlds_unless_they_are_given() -> None:
    status = world_status(dof=3, params={"coupling": "wave", "rendering": "paper", "scene": "mine:pillow"})
    fit = fitting(Params(), status)
    assert (fit.get("dof"), fit.coupling, fit.rendering, fit.scene) == (3, "wave", "paper", "free")
    fit = fitting(Params().set({"coupling": "tdpa"}), status)
    assert (fit.coupling, fit.rendering) == ("tdpa", "paper")


@pytest.mark.parametrize("told", [
    {"coupling": "os:system", "rendering": "paper"}, {"coupling": 7}, {"coupling": ["pspm"]}, "pspm", None,
])  # fmt: skip
def test_the_network_names_no_code_that_is_loaded_here(told: object) -> None:
    fit = fitting(Params(), world_status(dof=2, params=told))
    assert (fit.get("dof"), fit.coupling, fit.rendering) == (2, "pspm", "auto")


def test_the_flags_are_passed_on_as_they_were_given() -> None:
    options = ZenohOptions(
        mode="client", connect=["tls/a:1", "tls/b:2"], cfg=["x:1"], tls_ca=Path("ca.pem"), encrypt=True, user="ann"
    )
    assert options.leave_this_host
    assert not ZenohOptions(cfg=["x:1"]).leave_this_host
    words = options.words()
    assert words[:6] == ["--connect", "tls/a:1", "--connect", "tls/b:2", "--cfg", "x:1"]
    assert words[6:] == ["--mode", "client", "--tls-ca", "ca.pem", "--user", "ann", "--encrypt"]
    far = FarWorld(options, "s", "n", 4, Path("there"), files=False, realtime=True)
    assert far.words()[len(words) :] == [
        "--session", "s", "--name", "n", "--seed", "4", "--out", "there", "--no-files", "--realtime",
    ]  # fmt: skip


def test_messages_of_any_length_come_whole_and_in_order() -> None:
    ours, theirs = os.pipe()
    sent = [bytes([k]) * size for k, size in enumerate((0, 1, 70_000, 3, 200_000))]
    writer = FrameWriter(theirs)
    for one in sent:
        writer.put(one)
    with os.fdopen(ours, "rb") as pipe:
        found = frames(pipe)
        assert [next(found) for _ in sent] == sent


@pytest.mark.parametrize(("argv", "says"), [
    (["-e", "tcp/127.0.0.1:9", "--scene", "sphere"], "hapnet world --scene sphere"),
    (["-e", "tcp/127.0.0.1:9", "--encrypt"], "it needs --secret-file"),
    (["-e", "tcp/127.0.0.1"], "such as tcp/127.0.0.1:17447"),
    (["--session", "mine"], "it needs -e or -l"),
    (["--no-files"], "it needs -e or -l"),
    (["--encrypt"], "it needs -e or -l"),
    (["--seats", "0"], "allowed: 1 to 64"),
    (["--seats", "65"], "allowed: 1 to 64"),
    (["--seats", "alice,alice"], "different names"),
    (["--seats", "world,alice"], "names other than world"),
    (["--seats", "2", "-e", "tcp/127.0.0.1:9"], "leave -e and -l out"),
    (["--seats", "2", "--name", "alice"], "it needs -e or -l"),
    (["--seats", "2", "--scene", "sphere"], "have room for several hands"),
    (["--seats", "2", "--set", "operator=press"], "the mouse is the hand here"),
])  # fmt: skip
def test_what_cannot_be_is_said_in_a_line(argv: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["play", "--no-browser", *argv]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1


def led_to(hand: MouseHand, history: History, x_m: float) -> Callable[[], bool]:
    def there() -> bool:
        hand.lead((x_m,))
        track = history.snapshot().device
        return track is not None and abs(float(track.position_m[-1, 0]) - x_m) < 3e-3

    return there


@pytest.mark.slow
def test_the_mouse_moves_a_world_elsewhere_and_its_page_sees_both_sides() -> None:
    address = free_address()
    history = History()
    with started("world", "-l", address, "--no-files", "--scene", "free") as world, ExitStack() as closing:
        zenoh = ZenohOptions(connect=[address])
        far = FarWorld(zenoh, "default", "device", 1, None, files=False, realtime=False)
        params = led(Params().set({"scene": "free", "link.up": "", "link.down": ""}))
        hand = MouseHand(params, far, history, closing)
        until(led_to(hand, history, 0.03))
        until(lambda: history.snapshot().world_status is not None and history.snapshot().summary is not None)
        until(lambda: (w := history.snapshot().world) is not None and abs(float(w.position_m[-1, 0]) - 0.03) < 5e-3)
        hand.link("up", "delay 60ms")
        until(lambda: (d := history.snapshot().device_status) is not None and "60ms" in str(d.link.get("profile")))
        assert world.alive


def _ends(program: Program, other: Program) -> None:
    for one, more in ((program, other), (other, program)):
        os.kill(one.process.pid, signal.SIGINT)
        code, out, errors = one.end()
        assert code == 130, (out, errors)
        assert not errors
        assert re.search(r"^PASSIVE: gave out at most [0-9.]+ mJ of the 150 mJ allowed$", out, re.MULTILINE), out
        assert more is not one


@pytest.mark.parametrize("listens", mostly_slow([True, False], 0, 1))
def test_both_ends_print_the_joint_verdict_and_write_their_files(listens: bool, tmp_path: Path) -> None:
    """Of a world with three axes and another rendering, which the command line of the hand's side does not name."""
    address = free_address()
    here, there = ("-l", "-e") if listens else ("-e", "-l")
    with (
        started("world", there, address, "--scene", "sphere", "--rendering", "paper", "--out", tmp_path / "w") as world,
        started("play", here, address, "--no-browser", "--port", 0, "--out", tmp_path / "d") as play,
    ):
        play.until_line("open http://127.0.0.1:")
        assert any("sphere" in line and "pspm" in line for line in play.out)
        world.until_line("paired")
        play.until("a recording", lambda: (tmp_path / "d" / "device.mcap").exists())
        _ends(play, world)
    for directory in ("d", "w"):
        summary = json.loads((tmp_path / directory / "summary.json").read_text("utf-8"))
        assert summary["verdict"]["passive"] is True
        role = {"d": "device", "w": "world"}[directory]
        recording = read_recording(tmp_path / directory / f"{role}.mcap")
        assert recording.meta["params"]["rendering"] == "paper"
        assert {"report.html", "figure.png", "log.jsonl"} <= {file.name for file in (tmp_path / directory).iterdir()}


@pytest.mark.slow
def test_a_hand_whose_page_was_killed_ends_in_order(tmp_path: Path) -> None:
    address = free_address()
    with (
        started("world", "-l", address, "--no-files", "--once") as world,
        started("play", "-e", address, "--no-browser", "--port", 0, "--out", tmp_path) as play,
    ):
        play.until_line("open http://127.0.0.1:")
        play.until("a recording", lambda: (tmp_path / "device.mcap").exists())
        play.process.kill()
        until(lambda: (tmp_path / "summary.json").exists())
        summary = json.loads((tmp_path / "summary.json").read_text("utf-8"))
        assert "hapnet play" in str(summary["device"]["failed"])
        assert play.end()[0] == -signal.SIGKILL
        world.end()


def test_a_hand_whose_page_was_killed_while_it_started_ends_too(tmp_path: Path) -> None:
    """By the time it looks, another process is its parent."""
    with subprocess.Popen([sys.executable, "-c", ""]) as killed:
        pass
    page, theirs = os.pipe()
    command = [*HAPNET, "device", "-l", free_address(), "--out", str(tmp_path)]
    environment = {**ENVIRONMENT, PAGE: f"{theirs} {killed.pid}"}
    with (
        os.fdopen(page, "rb"),
        subprocess.Popen(command, pass_fds=(theirs,), env=environment, stdout=subprocess.DEVNULL) as hand,
    ):
        os.close(theirs)
        try:
            hand.wait(LIMIT_S)
        finally:
            hand.kill()
    assert "hapnet play" in read_json(tmp_path / "summary.json")["device"]["failed"]


@pytest.mark.slow
def test_the_mouse_takes_a_free_seat() -> None:
    """Of two, in the alphabetical order of their names."""
    address = free_address()
    scene = ("--scene", "shared:block?mass=0.2")
    with ExitStack() as closing:
        world = closing.enter_context(started("world", "--seats", "bob,alice", *scene, "-l", address, "--no-files"))
        world.until_line("alice: waiting for the device")
        for name in ("alice", "bob"):
            page = ("--no-browser", "--no-files", "--port", 0)
            play = closing.enter_context(started("play", "--name", "free", "-e", address, *page))
            world.until_line(f"{name}: paired with the device")
            assert f"takes the free seat {name}\n" in play.out
