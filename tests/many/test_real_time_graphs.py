"""Devices with several edges, and followers, in real time: a process for each node, and one thread for its pairs."""

import signal
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.ext.many.loop import DeviceLoop, JointLoop
from hapnet.recording.mcap import read_recording
from hapnet.transport.config import free_address
from tests.support.processes import Program, read_json, started, until

HEAD = """duration_s = 4.0
scene = "free"
dof = 3
record_hz = 1000.0
rendering = "paper"
device.stiffness = 100.0
device.damping = 0.8
link.up = "delay 20ms 5ms loss 5%"
link.down = "delay 20ms 5ms loss 5%"
[nodes.n0]
kind = "device"
operator = "hand-21"
[nodes.n1]
kind = "follower"
[nodes.n2]
kind = "follower"
operator = "rest"
operator_model.stiffness = 40
"""
STAR = HEAD + '[[edges]]\nfrom = "n0"\nto = "n1"\n[[edges]]\nfrom = "n0"\nto = "n2"\nshare = 0.4\n'
CHAIN = HEAD + '[[edges]]\nfrom = "n0"\nto = "n1"\nforce = false\n[[edges]]\nfrom = "n1"\nto = "n2"\n'


# -- the thread of a node, without processes ---------------------------------------------------------------------------


class Ticks:
    """A pair of a loop: what it was called with, and whether it holds a force."""

    def __init__(self, loop: JointLoop, wrong: Callable[[int], bool] = lambda count: False) -> None:
        self.at_ns, self.failed, self.holds, self.wrong = list[int](), list[BaseException](), True, wrong
        self.part: DeviceLoop = loop.for_device(
            1_000_000, self.tick, safe=self.release, on_error=self.failed.append, paced=True, realtime=False,
            clock=time.monotonic_ns,
        )  # fmt: skip

    def tick(self, now_ns: int) -> None:
        self.at_ns.append(now_ns)
        if self.wrong(len(self.at_ns)):
            raise ValueError("this pair fails")

    def release(self) -> None:
        self.holds = False


def test_a_pair_that_fails_or_ends_leaves_the_others_in_one_thread() -> None:
    loop = JointLoop(period_ns=1_000_000)
    first, wrong, last = Ticks(loop), Ticks(loop, lambda count: count == 5), Ticks(loop)
    for one in (last, wrong, first):  # whatever comes first
        one.part.start()
    until(lambda: len(first.at_ns) > 20)
    assert [str(error) for error in wrong.failed] == ["this pair fails"]
    assert len(wrong.at_ns) == 5
    assert (first.holds, wrong.holds, last.holds) == (True, False, True)
    first.part.stop()
    assert not first.holds
    seen = len(last.at_ns)
    until(lambda: len(last.at_ns) > seen + 20)
    assert not last.failed
    last.part.stop()
    seen = len(last.at_ns)
    assert not last.holds
    assert set(first.at_ns[2:]) <= set(last.at_ns)  # one time for all pairs
    time.sleep(0.01)
    assert len(last.at_ns) == seen
    assert last.part.stats().ticks == len(last.at_ns)


# -- whole graphs ------------------------------------------------------------------------------------------------------


def columns(directory: Path, node: str, port: str, role: str) -> dict[str, Array]:
    found = getattr(read_recording(directory / node / f"{port}.mcap"), role)
    assert found is not None
    return dict(found)


def require_half(samples: Mapping[str, Array], *, held: bool, realigned: int = 0) -> float:
    """Theorem 1 of one side, with the work summed here; returns that work at the end [J].

    realigned : how often a robot's axes were aligned with another leader: its position jumps, and the robot does not.
    """
    force = samples["force_N"][:-1] if held else samples["coupling_force_N"][1:]
    done, counted = -np.sum(force * np.diff(samples["position_m"], axis=0), axis=1), np.diff(samples["work_J"])
    jumps = np.abs(done - counted) > 1e-11
    assert np.count_nonzero(jumps) <= realigned
    moved_m = np.linalg.norm(samples["velocity_mps"][1:] * np.diff(samples["time_ns"])[:, None] * 1e-9, axis=1)
    assert np.all(np.abs(counted[jumps]) <= 2.0 * (np.linalg.norm(force, axis=1) * moved_m)[jumps] + 1e-9)
    done[jumps] = counted[jumps]
    work = samples["work_J"][0] + np.concatenate([[0.0], np.cumsum(done)])
    margin = work + samples["bound_J"] + samples["credited_J"] - samples["sent_J"]
    assert np.min(margin - samples["potential_J"] - samples["account_J"]) >= -1e-11
    assert abs(samples["work_J"][0]) < 1e-4
    return float(work[-1])


def require_passive(found: Mapping[str, Any]) -> None:
    """From the summary alone. What a stalled servo gave out beyond its account, on a busy machine, is counted there."""
    for name, pair in found["edges"].items():
        leaked = sum(pair[side]["overrun_leak_J"] or 0.0 for side in ("device", "world"))
        assert pair["theorem"]["margin_J"] + leaked >= -1e-9, name
        for side in ("device", "world"):
            assert pair[side]["ledger"]["slack_J"] >= -1e-12, (name, side)
        for flow in pair["energy"].values():
            assert flow["credited_nJ"] <= flow["sent_nJ"], name
    for name, node in found["nodes"].items():
        assert 1e-9 * node["sent_nJ"] <= node["ledger_sent_J"] + 1e-12, name
        assert node["sent_nJ"] == pytest.approx(1e9 * node["ledger_sent_J"], abs=2.0 * len(node["edges"])), name


@pytest.mark.long
def test_a_teacher_and_two_students(tmp_path: Path) -> None:
    file, out = tmp_path / "star.toml", tmp_path / "run"
    file.write_text(STAR)
    with started("run", "--graph", file, "--out", out, "--json", "-") as run:
        code, _, err = run.end()
    assert code == 0 or "stalled" in err, err
    found = read_json(out / "summary.json")
    require_passive(found)
    teacher, total = found["nodes"]["n0"], 0.0
    paths = []
    for edge, share in (("n0-n1", 0.5), ("n0-n2", 0.4)):
        device = columns(out, "n0", edge, "device")
        total += require_half(device, held=True)
        robot = columns(out, edge[3:], edge, "world")
        require_half(robot, held=False)
        assert np.ptp(robot["position_m"], axis=0).max() > 0.005
        paths.append(dict(zip(device["time_ns"].tolist(), map(tuple, device["position_m"].tolist()), strict=True)))
        assert found["edges"][edge]["device"]["ledger"]["bound_J"] == pytest.approx(share * 0.1, rel=1e-9)
    both = set(paths[0]) & set(paths[1])
    assert len(both) > 1000
    assert all(paths[0][at] == paths[1][at] for at in both)  # one body, moved once a tick
    assert teacher["work_J"] == pytest.approx(total, rel=1e-9, abs=1e-11)
    assert teacher["ledger_work_J"] == pytest.approx(teacher["work_J"], rel=1e-9, abs=1e-11)
    assert found["nodes"]["n2"]["kind"] == "follower"
    with started("report", out, "--json", "-") as report:
        _, _, err = report.end()
    assert "there is no recording" not in err
    assert (out / "n0-n1.html").exists()
    assert (out / "n0-n2.html").exists()


def node(file: Path, kind: str, name: str, *more: object) -> Program:
    return started(kind, "--graph", file, "--node", name, *more)


@pytest.mark.long
def test_a_chain_whose_middle_is_killed_and_comes_again(tmp_path: Path) -> None:
    """Its neighbours' servos go on, and both pairs meet again. The last one is told to end, and says what it knows."""
    file = tmp_path / "chain.toml"
    file.write_text(CHAIN.replace("duration_s = 4.0", "duration_s = 0.0"))
    middle, last = free_address(), free_address()
    with (
        node(file, "world", "n2", "-l", last, "--out", tmp_path / "n2") as held,
        node(file, "device", "n0", "-e", middle, "--out", tmp_path / "n0") as hand,
    ):
        with node(file, "world", "n1", "-l", middle, "-e", last, "--no-files") as robot:
            robot.until_line("n0: paired with the device")
            robot.until_line("n1: paired with the world")
            time.sleep(1.0)
        held.until_line("n1: no data from the device")
        with node(file, "world", "n1", "-l", middle, "-e", last, "--out", tmp_path / "n1") as robot:
            robot.until_line("n0: paired with the device")
            robot.until_line("n1: paired with the world")
            time.sleep(1.0)
            for one, number in ((hand, signal.SIGINT), (robot, signal.SIGTERM), (held, signal.SIGTERM)):
                one.process.send_signal(number)
                assert one.end()[0] == 128 + number
    of = {name: read_json(tmp_path / name / "summary.json")["pairs"] for name in ("n0", "n1", "n2")}
    for half, port, role in ((of["n0"], "n0", "device"), (of["n2"], "n1", "world")):
        assert half[port][role]["incarnations"] == 2
    for name, port, role in (("n0", "n0", "device"), ("n1", "n0", "world"), ("n1", "n1", "device"),
                             ("n2", "n1", "world")):  # fmt: skip
        half, samples = of[name][port][role], columns(tmp_path, name, port, role)
        require_half(samples, held=role == "device", realigned=half["incarnations"] - 1)
        assert half["ledger"]["slack_J"] >= -1e-12
        assert 1e-9 * half["sent_nJ"] <= half["ledger"]["sent_J"] + 1e-12
        gaps = np.diff(samples["time_ns"])
        assert gaps.max() < 1e9, name  # no servo waited for the peer that had gone
    unfelt = columns(tmp_path, "n0", "n0", "device")
    assert np.array_equal(unfelt["set_position_m"], unfelt["position_m"])
    assert not np.any(unfelt["potential_J"])


@pytest.mark.long
def test_a_run_that_is_interrupted_ends_with_a_summary_of_all_nodes(tmp_path: Path) -> None:
    file, out = tmp_path / "star.toml", tmp_path / "run"
    file.write_text(STAR.replace("duration_s = 4.0", "duration_s = 60.0"))
    with started("run", "--graph", file, "--out", out, "-v") as run:
        run.until_line("n0: n0-n1: paired with the world")
        run.until_line("n0: n0-n2: paired with the world")
        time.sleep(1.0)
        run.process.send_signal(signal.SIGINT)
        code, _, _ = run.end()
        run.until_gone()
    assert code == 128 + signal.SIGINT
    found = read_json(out / "summary.json")
    assert set(found["edges"]) == {"n0-n1", "n0-n2"}
    require_passive(found)
