"""A world with several seats in real time: real processes, a router in the world's, and devices that come and go."""

import json
import signal
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from hapnet.transport.config import free_address
from tests.conftest import ROOT
from tests.support.processes import Program, started

SCENE = ("--scene", "shared:block?mass=0.2&at=60mm,0,0")
LAB = """
[nodes.table]
kind = "world"
scene = "shared:block?mass=0.2&at=0,0,0"

[nodes.alice]
kind = "device"
operator = "press"
operator_model = { hold_s = 60.0, reach_s = 0.5, goal_m = 0.04 }

[nodes.bob]
kind = "device"
operator = "press"
operator_model = { hold_s = 60.0, reach_s = 0.5, goal_m = -0.04 }

[[edges]]
from = "alice"
to = "table"
link = "delay 20ms 5ms loss 2%"
at = [-0.06, 0.0, 0.0]

[[edges]]
from = "bob"
to = "table"
link = "lan"
at = [0.06, 0.0, 0.0]
"""


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    file = tmp_path / "lab.toml"
    file.write_text(LAB)
    return file


def account(seat: Mapping[str, Any]) -> Mapping[str, Any]:
    """A seat's half of the theorem holds, whatever became of its device."""
    ledger = seat["world"]["ledger"]
    assert ledger["slack_J"] >= -1e-9
    return seat["world"]


def test_a_graph_runs_on_this_machine(lab: Path) -> None:
    with started("run", "--graph", lab, "--duration", "4", "--no-files", "--json", "-") as run:
        found = run.summary()
    assert found["verdict"]["passive"] is True
    own = found["nodes"]["table"]["environment"]
    assert own["env_slack_J"] >= -1e-9
    for name, role in (("table", "world"), ("alice", "device"), ("bob", "device")):
        node = found["nodes"][name]
        halves = [found["edges"][edge][role] for edge in node["edges"]]
        assert node["sent_nJ"] == sum(half["sent_nJ"] for half in halves)
        assert 0.0 <= node["ledger_sent_J"] - 1e-9 * node["sent_nJ"] <= 2e-9 * len(halves)
        assert node["bound_J"] == pytest.approx(0.05 * len(halves) if role == "world" else 0.1, rel=1e-9)
    for name, deep_N in (("alice-table", 0.1), ("bob-table", 0.1)):
        edge = found["edges"][name]
        assert edge["verdict"]["passive"] is True
        assert edge["theorem"]["margin_J"] >= -1e-9
        assert edge["energy"]["up"]["credited_nJ"] <= edge["energy"]["up"]["sent_nJ"]
        assert (
            edge["motion"]["peak_force_N"] > deep_N
        )  # the block is between the hands: each feels the other through it


def test_two_hands_hold_a_box_of_mujoco_on_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco")
    monkeypatch.chdir(ROOT)  # the graph names its model from there
    graph = "examples/graphs/carried_box.toml"
    with started("run", "--graph", graph, "--duration", "3", "--no-files", "--json", "-") as run:
        found = run.summary()
    assert found["verdict"]["passive"] is True
    assert found["nodes"]["table"]["environment"]["env_slack_J"] >= -1e-9
    for name in ("alice-table", "bob-table"):
        edge = found["edges"][name]
        assert edge["theorem"]["margin_J"] >= -1e-9
        assert edge["energy"]["up"]["credited_nJ"] <= edge["energy"]["up"]["sent_nJ"]
        assert edge["motion"]["peak_force_N"] > 0.3  # more than free motion: the box is between the pads


def device(lab: Path, name: str, address: str) -> Program:
    return started("device", "--graph", lab, "--node", name, "-e", address, "--no-files")


@pytest.mark.slow
def test_a_device_that_is_killed_in_contact_lets_go_and_its_seat_is_taken_again(lab: Path, tmp_path: Path) -> None:
    address, summary = free_address(), tmp_path / "world.json"
    with started("world", "--graph", lab, "-l", address, "--no-files", "--json", summary) as world:
        world.until_line("bob: waiting for the device")
        with device(lab, "bob", address) as bob:
            with device(lab, "alice", address) as alice:
                world.until_line("alice: paired with the device")
                world.until_line("bob: paired with the device")
                time.sleep(1.0)  # both press the block by now
            world.until_line("alice: no data from the device")
            with device(lab, "alice", address) as alice:
                alice.until_line("paired with the world")
                world.until("alice's second pair", lambda: sum("alice: paired" in line for line in world.out) == 2)
            bob.process.send_signal(signal.SIGTERM)
            bob.end()
        world.process.send_signal(signal.SIGTERM)
        world.end()
    found = json.loads(summary.read_text())
    alice_, bob_ = account(found["seats"]["alice"]), account(found["seats"]["bob"])
    assert (alice_["incarnations"], bob_["incarnations"]) == (2, 1)
    assert alice_["ledger"]["bound_J"] == bob_["ledger"]["bound_J"]  # of the seat, not of each process in it
    assert found["environment"]["env_slack_J"] >= -1e-9


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["separate", "pooled"])
def test_an_empty_seat_is_filled_and_a_group_shares(kind: str, lab: Path, tmp_path: Path) -> None:
    address, summary = free_address(), tmp_path / "world.json"
    own = ("--set", "world.seat_refill_s=1", "--set", f"world.reservoir={kind}", "--no-files", "--json", summary)
    with started("world", "--graph", lab, "-l", address, *own) as world:
        world.until_line("bob: waiting for the device")
        with device(lab, "bob", address) as bob:
            for number in range(3):
                with device(lab, "alice", address):
                    world.until("a pair", lambda n=number: sum("alice: paired" in line for line in world.out) == n + 1)
                    time.sleep(2.0)  # both press the block by now
            time.sleep(3.0)
            bob.process.send_signal(signal.SIGTERM)
            bob.end()
        world.process.send_signal(signal.SIGTERM)
        world.end()
    found = json.loads(summary.read_text())
    seats = found["reservoirs"]["seats"]
    assert (found["reservoirs"]["kind"], found["reservoirs"]["seat_refill_s"]) == (kind, 1.0)
    assert seats["alice"]["refilled_J"] > 0.0
    assert sum(seat["got_J"] for seat in seats.values()) == pytest.approx(sum(s["given_J"] for s in seats.values()))
    for name in ("alice", "bob"):
        account(found["seats"][name])
    assert found["environment"]["env_slack_J"] >= -1e-9


@pytest.mark.slow
def test_a_device_that_does_not_fit_is_refused_and_its_seat_stays_open(tmp_path: Path) -> None:
    address, summary = free_address(), tmp_path / "world.json"
    with started("world", "--seats", "alice,bob", *SCENE, "-l", address, "--no-files", "--json", summary) as world:
        world.until_line("bob: waiting for the device")
        with started("device", "--name", "alice", "--scene", "wall", "-e", address, "--no-files") as wrong:
            code, _, err = wrong.end()
        assert code == 2
        assert "3 degrees of freedom" in err
        for name in ("bob", "alice"):
            with started("device", "--name", name, *SCENE, "-e", address, "--no-files", "--duration", "1") as right:
                assert right.end()[0] == 0
        world.process.send_signal(signal.SIGTERM)
        world.end()
    seats = json.loads(summary.read_text())["seats"]
    assert [account(seats[name])["incarnations"] for name in ("alice", "bob")] == [1, 1]


@pytest.mark.parametrize(
    ("seats", "allowed"),
    [
        ("0", "1 to 64"),
        ("65", "1 to 64"),
        ("alice,alice", "different names"),
        ("alice,", "different names"),
        ("Al ice", "small letters"),
    ],
)
def test_bad_seats_are_refused_in_one_line(seats: str, allowed: str) -> None:
    with started("world", "--seats", seats, *SCENE, "--no-files") as world:
        code, _, err = world.end()
    assert code == 2
    assert err.count("\n") == 1
    assert "--seats" in err
    assert allowed in err


@pytest.mark.slow
def test_a_seat_lets_in_the_owner_of_its_certificate_only(certificates: Path) -> None:
    """The seats are in the world's own process, and have no certificates; the devices' must be of the seat's name."""
    address = free_address("tls")

    def shown(name: str) -> tuple[str | Path, ...]:
        own = (certificates / "ca.pem", certificates / f"{name}.pem", certificates / f"{name}.key")
        return tuple(word for pair in zip(("--tls-ca", "--tls-cert", "--tls-key"), own, strict=True) for word in pair)

    access = ("--mutual-tls", "-c", ROOT / "examples/secure/access.json5")
    with started(
        "world", "--seats", "alice,bob", *SCENE, "-l", address, *shown("world"), *access, "--no-files"
    ) as world:
        world.until_line("bob: waiting for the device")
        with started(
            "device", "--name", "bob", *SCENE, "-e", address, *shown("alice"), "--duration", "2", "--no-files"
        ) as thief:
            world.until_line("access control does not let alice")
            thief.process.send_signal(signal.SIGTERM)
            thief.end()
        with started(
            "device", "--name", "alice", *SCENE, "-e", address, *shown("alice"), "--duration", "2", "--no-files"
        ) as alice:
            world.until_line("alice: paired with the device")
            alice.until_line("PASSIVE")
        assert not any("bob: paired" in line for line in world.out)
        world.process.send_signal(signal.SIGTERM)
        world.end()
