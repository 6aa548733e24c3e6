"""The two commands that the pages print for two hosts, each run on a host of its own, with a link of its own."""

import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.recording.mcap import read_recording
from hapnet.summary.run import merge
from hapnet.wire.messages import Role
from tests.conftest import ROOT
from tests.faults.namespaces import Host, Unavailable, two_hosts
from tests.faults.tun import CABLE
from tests.support.processes import HAPNET, Program, assert_accounts_agree, assert_passive, read_json

SOON = ("operator_model.wait_s=0", "operator_model.reach_s=0.4", "device.watchdog_s=0")
"""The hand is at the wall at once; and a machine that tests may hold a servo up."""

LINKS: dict[Role, tuple[str, float, float]] = {
    "device": ("delay 30ms loss 5%", 30.0, 0.05),
    "world": ("delay 20ms", 20.0, 0.0),
}
"""What each side sends through: its words, its delay [ms] and its loss."""


def printed_commands() -> tuple[dict[Role, list[str]], str]:
    """The first pair of commands on the page of tasks, without the program's name, and the world's address in it."""
    page = (ROOT / ".site" / "pages" / "how_to.md").read_text("utf-8")
    world = re.search(r"^hapnet world +-l tcp/0\.0\.0\.0:\d+ .*$", page, re.MULTILINE)
    device = re.search(r"^hapnet device +-e tcp/([\d.]+):\d+ .*$", page, re.MULTILINE)
    assert world is not None
    assert device is not None
    found: dict[Role, list[str]] = {
        "world": shlex.split(world[0], comments=True)[1:],
        "device": shlex.split(device[0], comments=True)[1:],
    }
    return found, device[1]


def start(host: Host, directory: Path, words: Sequence[str], role: Role) -> Program:
    """The command as printed, for a short time and through this side's link; it writes its files as it does anyway."""
    more = ["--duration", "1", "--link", LINKS[role][0], "--seed", "1", "--json", f"{role}.json"]
    for assignment in SOON:
        more += ["--set", assignment]
    return Program(*words, *more, command=(*host.enter, f"--wd={directory}", *HAPNET))


@pytest.mark.slow
def test_two_hosts_with_the_commands_as_printed(tmp_path: Path) -> None:
    """They meet, the wall is felt, no nanojoule is lost or made, and each link is as its own side was asked for."""
    commands, address = printed_commands()
    try:
        with two_hosts() as (of_world, of_device):
            of_world.ip(f"address add {address}/24 dev {CABLE}")
            of_device.ip(f"address add {address.rpartition('.')[0]}.99/24 dev {CABLE}")
            with (
                start(of_world, tmp_path, commands["world"], "world") as world,
                start(of_device, tmp_path, commands["device"], "device") as device,
            ):
                for side in (device, world):
                    code, out, err = side.end()
                    assert code == 0, out + err
                    assert "paired with the" in out
                    assert re.search(r"^PASSIVE: gave out at most [0-9.]+ mJ of the 150 mJ allowed$", out, re.M), out
                    assert re.search(r"^The wall of 3000 N/m (felt|was not touched)", out, re.M), out
                    assert re.search(r"^warning: the peer's identity is not proven: ", out, re.M), out
    except Unavailable as reason:
        pytest.skip(str(reason))
    ends = {role: read_json(tmp_path / f"{role}.json") for role in LINKS}
    for role, end in ends.items():
        assert_joint(end, ends, role)
        [left] = (tmp_path / "runs").glob(f"*-{role}")
        names = {file.name for file in left.iterdir()}
        assert names == {f"{role}.mcap", "summary.json", "report.html", "figure.png", "log.jsonl"}
        (left / f"{role}.mcap").rename(tmp_path / f"{role}.mcap")
        assert read_json(left / "summary.json") == end
    with Program("report", tmp_path, "--json", tmp_path / "both.json") as report:
        code, out, err = report.end()
    assert (code, err) == (0, "")
    assert read_json(tmp_path / "both.json")["verdict"]["passive"] is True
    summary = merge(ends["device"], ends["world"])
    assert_accounts_agree(summary)
    assert_passive(summary)
    assert summary["energy"]["up"]["sent_nJ"] > 0
    assert summary["verdict"]["passive"] is True
    assert_felt(tmp_path)
    for role, (words, delay_ms, loss) in LINKS.items():
        assert_link(ends[role], role, words, delay_ms, loss)
    trip_ms = sum(delay_ms for _, delay_ms, _ in LINKS.values())
    for end in ends.values():
        assert end["path"]["round_trip_p50_ms"] >= trip_ms


def assert_joint(end: dict[str, Any], ends: dict[Role, dict[str, Any]], role: Role) -> None:
    """One side's summary says of the other what that says of itself, as of the end of the one that ended first."""
    other: Role = "world" if role == "device" else "device"
    assert end["peer_report"]["side"] == other
    assert end["peer_report"]["whole"] is True
    assert end["theorem"]["margin_J"] is not None
    assert end["theorem"]["bound_J"] == ends[other]["theorem"]["bound_J"]
    for name in ("peak_force_N", "peak_penetration_m", "contacts"):
        assert end["motion"][name] is not None
    assert end["path"]["up"]["sent"] > 0
    assert end["path"]["down"]["sent"] > 0
    if end["peer_report"]["final"]:
        for name in ("margin_J", "slack_J", "bound_J", "work_J"):
            assert end[other]["ledger"][name] == ends[other][other]["ledger"][name]


def assert_felt(directory: Path) -> None:
    """The proxy is in the wall, and the hand is pushed back by the coupling."""
    world, device = read_recording(directory / "world.mcap").world, read_recording(directory / "device.mcap").device
    assert world["penetration_m"].max() > 0.0
    assert np.quantile(device["force_N"][:, 0], 0.1) < -0.3


def assert_link(end: dict[str, Any], role: Role, words: str, delay_ms: float, loss: float) -> None:
    """Of a side's own summary: it knows its own link only, which was as asked for."""
    own, other = ("up", "down") if role == "device" else ("down", "up")
    link = end["links"][own]
    assert end["links"][other] is None
    assert link["profile"] == words
    assert link["delay_p50_ms"] == pytest.approx(delay_ms, rel=0.012)  # a bin is 1.1 % wide
    deviations = 5.0 * (link["offered"] * loss * (1.0 - loss)) ** 0.5
    assert abs(link["lost"] - link["offered"] * loss) <= deviations
    assert link["offered"] > 30
