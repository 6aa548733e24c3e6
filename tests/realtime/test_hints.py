"""Hints name the right cause; the cause is made here, and the hint of another cause must not appear."""

import socket
import threading
from pathlib import Path

import pytest

from hapnet.assembly.build import prepare
from hapnet.params import Params
from hapnet.plant.operating_range import OperatingRange, RangeWatch, operating_range
from hapnet.transport.config import ZenohSettings
from hapnet.transport.diagnosis import why_unanswered

PERIOD_S = 1e-3


def why(settings: ZenohSettings) -> str:
    return why_unanswered(settings, 0.5) or ""


def test_a_side_that_only_scouts_is_told_of_networks_without_multicast() -> None:
    said = why(ZenohSettings(multicast_scouting=True))
    assert said.startswith("no node answers by multicast: if the other side runs, a network blocks it")
    assert "-l tcp/0.0.0.0:17447" in said
    assert "-e tcp/HOST:17447" in said


def test_a_side_that_listens_on_loopback_is_told_that_others_cannot_dial_it() -> None:
    for address in ("tcp/127.0.0.1:17447", "tcp/localhost:17447", "udp/[::1]:17447"):
        said = why(ZenohSettings(listen=(address,), multicast_scouting=False))
        assert said.startswith("only programs on this host can dial ")
        assert said.endswith("for others listen on 0.0.0.0")


def test_a_side_that_nobody_dials_is_told_what_the_other_needs() -> None:
    said = why(ZenohSettings(listen=("tcp/0.0.0.0:17447",), multicast_scouting=False))
    assert said == "nobody has dialled: the other side needs -e with this host's address, and a firewall must let it in"


def test_a_pair_over_a_unix_socket_gets_no_hint_of_networks(tmp_path: Path) -> None:
    assert not why(ZenohSettings(listen=(f"unixsock-stream/{tmp_path}/link",), multicast_scouting=False))


def test_a_websocket_to_nothing_is_named_like_tcp_to_nothing() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    for protocol in ("tcp", "ws"):
        endpoint = f"{protocol}/127.0.0.1:{port}"
        said = why(ZenohSettings(connect=(endpoint,), multicast_scouting=False))
        assert said == f"{endpoint}: no program listens there"


def test_a_websocket_to_another_program_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=lambda: server.accept()[0].close(), daemon=True)
        thread.start()
        endpoint = f"ws/127.0.0.1:{server.getsockname()[1]}"
        assert "not be Zenoh" in why(ZenohSettings(connect=(endpoint,), multicast_scouting=False))
        thread.join(2.0)


def declared() -> OperatingRange:
    return operating_range(1, ("workspace", 0.2), ("greatest_speed", 0.5), ("stiffness", (1.0, 3000.0)))


def refusal(new_each: int, *, speed_mps: float = 0.4, jump_m: float = 0.0) -> str:
    """The watch's message about a device that moves at this speed, and is read at 1 kHz but measures more seldom."""
    watch = RangeWatch(declared(), 0.0, (0.0,))
    for tick in range(1, 400):
        x = speed_mps * PERIOD_S * (tick - tick % new_each) + (jump_m if tick > 200 else 0.0)
        if not watch.passes(PERIOD_S, (x,), (0.0,)):
            return watch.why or ""
    return ""


def test_a_jump_after_repeated_readings_is_told_from_an_impossible_one() -> None:
    assert refusal(1) == ""
    repeated = refusal(150)
    assert "(it repeated one reading for 149 ms before: let it declare rate_hz)" in repeated
    assert "rate_hz" not in refusal(1, jump_m=0.15)
    assert "rate_hz" not in refusal(150, jump_m=0.15, speed_mps=0.0)


def test_a_speed_in_millimetres_is_asked_about_as_a_speed() -> None:
    watch = RangeWatch(declared(), 0.0, (0.0,))
    for _ in range(100):
        watch.passes(PERIOD_S, (0.0,), (100.0,))
    assert (watch.why or "").endswith("its maximum speed is 0.5 m/s (is it in mm/s?)")


URDF = """<robot name="three">
  <link name="base"/>
  {links}
</robot>"""
LINK = """<link name="l{i}"><inertial><mass value="0.2"/><origin xyz="0.1 0 0"/>
    <inertia ixx="1e-4" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="j{i}" type="revolute"><parent link="{parent}"/><child link="l{i}"/><origin xyz="{at} 0 0"/>
    <axis xyz="{axis}"/><limit lower="-1.5" upper="1.5" effort="5" velocity="10"/><dynamics damping="0.1"/></joint>"""


def arm(path: Path) -> str:
    """Three joints and 0.4 m, straight along x where all angles are 0, the middle between its stops."""
    rows = ((1, "base", 0, "0 0 1"), (2, "l1", 0, "0 1 0"), (3, "l2", 0.2, "0 1 0"))
    links = "\n  ".join(LINK.format(i=i, parent=parent, at=at, axis=axis) for i, parent, at, axis in rows)
    tip = '<link name="tip"/><joint name="end" type="fixed"><parent link="l3"/><child link="tip"/>'
    tip += '<origin xyz="0.2 0 0"/></joint>'
    path.write_text(URDF.format(links=links + tip))
    return str(path)


@pytest.mark.parametrize(("home", "stuck"), [("&home=0,0,0", True), ("&home=0,0.5,0.8", False), ("", False)])
def test_an_arm_that_begins_straight_is_warned_of(tmp_path: Path, home: str, stuck: bool) -> None:
    """A straight arm cannot move its tip along itself: x, by the arm's geometry. Its default home is bent."""
    hardware = f"arm:{arm(tmp_path / 'three.urdf')}?tip=tip{home}"
    said = [one for one in prepare(Params().set({"hardware": hardware})).warnings if "home" in one]
    assert len(said) == stuck
    if stuck:
        assert "no joint moves the tip along (1, 0, 0)" in said[0]
        assert said[0].endswith("choose another posture with &home=")
