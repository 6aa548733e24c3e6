"""The verdict: every rule by itself, on a summary that is passive but for it, and the exit code that follows."""

import copy
import dataclasses
import random
from dataclasses import asdict
from typing import Any

import pytest

from examples.own_law import Mine
from hapnet import cli
from hapnet.assembly.build import prepare
from hapnet.couplings.registry import COUPLINGS
from hapnet.params import Params
from hapnet.simulation.simulation import Simulation, simulate
from hapnet.summary.run import combine, device_summary, judged, with_wire, world_summary
from hapnet.summary.verdict import broken, judge, overloaded
from hapnet.wire.messages import Energy, decode, encode
from tests.fuzzing.rig import MS, Rig

SIDE = {
    "ledger": {"margin_J": 0.05, "slack_J": 0.0, "bound_J": 0.05, "energy_out_J": 0.0, "margin_end_J": 0.06},
    "deficit_max_J": 0.0, "sent_nJ": 10, "credited_nJ": 10, "abandoned_nJ": 0, "incarnations": 1, "unanswered_s": 0.0,
}  # fmt: skip
FLOW = {"sent_nJ": 10, "credited_nJ": 10, "in_flight_nJ": 0, "abandoned_nJ": 0}
WELL: dict[str, Any] = {
    "coupling": "pspm",
    "theorem": {"margin_J": 0.1, "bound_J": 0.1, "energy_out_J": 0.0, "margin_end_J": 0.145, "margin_later_J": 0.104},
    "device": {**SIDE, "quantisation_J": 0.0, "true_slack_J": None},
    "world": SIDE,
    "energy": {"up": FLOW, "down": FLOW},
    "torn": [],
}


def but(changes: dict[str, Any]) -> dict[str, Any]:
    """A run in which all is well but for this, given by dotted names."""
    summary = copy.deepcopy(WELL)
    for name, value in changes.items():
        *path, last = name.split(".")
        branch = summary
        for part in path:
            branch = branch[part]
        branch[last] = value
    return summary


def test_a_run_that_was_passive_says_by_how_much() -> None:
    reason = "gave out at most 0 mJ of the 100 mJ allowed"
    assert judge(WELL) == {"passive": True, "reason": reason}
    some = but({"theorem.margin_J": 0.0876, "theorem.energy_out_J": 0.0124, "theorem.margin_later_J": None})
    assert judge(some)["reason"] == "gave out at most 12.4 mJ of the 100 mJ allowed"


AGAINST: dict[str, tuple[dict[str, Any], str]] = {
    "both ports": (
        {"theorem.margin_J": -0.0125, "theorem.energy_out_J": 0.1125},
        "gave out 112.5 mJ, more than the 100 mJ allowed",
    ),
    "beyond rounding": ({"theorem.margin_J": -2e-9}, "gave out 100.000002 mJ, more than the 100 mJ allowed"),
    "own margin": ({"world.ledger.margin_J": -0.003}, "the margin of the world's half fell to -3 mJ"),
    "half": ({"device.ledger.slack_J": -0.004}, "the device's half of the theorem fails by 4 mJ"),
    "true positions": ({"device.true_slack_J": -0.004}, "with the true positions the device's half"),
    "credited": (
        {"energy.down": FLOW | {"credited_nJ": 10_466_000_010}},
        "the device credited 10466 mJ that the world",
    ),
    "abandoned": ({"energy.down": FLOW | {"abandoned_nJ": -10_466_000_000}}, "the device credited 10466 mJ that the"),
    "abandoned by one that began anew": (
        {"energy.down": FLOW | {"abandoned_nJ": -10_466_000_000}, "world.incarnations": 2},
        "the device credited 10466 mJ that the",
    ),
    "hand": ({"hand": {"work_J": 9.0, "margin_J": -0.15}}, "the margin at the hand and the walls fell to -150 mJ"),
    "hand at the end": ({"hand": {"work_J": -0.3}, "environment": {"work_J": 0.05}}, "the walls fell to -150 mJ"),
    "diverged": ({"theorem.margin_J": None, "theorem.diverged": True}, "the run diverged"),
}


@pytest.mark.parametrize(("changes", "words"), AGAINST.values(), ids=AGAINST)
def test_what_makes_a_run_not_passive(changes: dict[str, Any], words: str) -> None:
    found = judge(but(changes))
    assert found["passive"] is False
    assert words in found["reason"]
    assert broken(but(changes))
    assert not broken(but({**changes, "coupling": "zoh"}))  # which claims nothing over a network


DOUBTS: dict[str, tuple[dict[str, Any], str]] = {
    "deficit": ({"device.deficit_max_J": 2e-12}, "the device gave out 2e-09 mJ that its reservoir did not have"),
    "world's deficit": ({"world.deficit_max_J": 0.001}, "the world gave out 1 mJ that its reservoir did not have"),
    "dead stream": ({"world.unanswered_s": 55.25}, "the world's energy stream is dead: no acknowledgement"),
    "other side": ({"world": None, "theorem": {"margin_J": None, "bound_J": None}}, "the world's account is missing"),
    "servo's word": ({"device.ledger": {}, "theorem.margin_J": None}, "the device's account is missing"),
    "no account": ({"device": None, "world": None, "theorem.margin_J": None}, "there is no energy account"),
    "restart": ({"world.incarnations": 2, "theorem.margin_J": None}, "the account of an earlier device"),
    "torn": ({"torn": ["device"]}, "the device's recording is incomplete"),
    "no fit": ({"theorem.margin_J": None}, "the accounts of the two sides do not match"),
    "early": ({"energy.down": FLOW | {"early_J": 0.002}}, "the device credited 2 mJ before the world sent it"),
    "both ended": (
        {"device.failed": "no power", "world.failed": "no power"},
        "both sides ended before their time: no power",
    ),
    "servo's risk": (
        {"device.overrun_risk_J": 0.11},
        "while the servo stalled, 110 mJ may have come out unseen, more than the margin",
    ),
    "follower's stop": (
        {"world.stopped": {"after_s": 2.5, "why": "it is hot", "asked": False}},
        "the follower's force was stopped after 2.5 s: it is hot",
    ),
    "follower's blur": (
        {"world.quantisation_J": 0.11},
        "the follower's encoders are coarse: the account may be off by 110 mJ",
    ),
    "follower's speed": (
        {"world.speed_max_mps": 2.0, "world.speed_limit_mps": 1.0},
        "the follower moved at 2 m/s, and declares at most 1 m/s",
    ),
    "blur": (
        {"device.quantisation_J": 0.11},
        "the encoders are coarse: the account may be off by 110 mJ, over the margin of",
    ),
    "servo away": ({"device.overrun_leak_J": 0.0058}, "watchdog_s: 5.8 mJ came out beyond the account"),
    "world's account": ({"environment": {"env_diverged": True}}, "the world's own account is not finite"),
    "failed at once": ({"world.failed": "no strength"}, "the world failed, and its own account is not known: no s"),
    "speed": (
        {"device.speed_max_mps": 1.2, "device.speed_limit_mps": 1.0},
        "the device moved at 1.2 m/s, and declares",
    ),
}


@pytest.mark.parametrize(("changes", "words"), DOUBTS.values(), ids=DOUBTS)
def test_what_keeps_it_from_being_known(changes: dict[str, Any], words: str) -> None:
    found = judge(but(changes))
    assert found["passive"] is None
    assert words in found["reason"]
    assert not broken(but(changes))
    worse = but({**changes, "device": {**SIDE, "ledger": {"slack_J": -1.0}}})
    assert judge(worse)["passive"] is False  # what is missing does not excuse what is known


AWAY = {"device.servo": {"overruns": 1076, "longest_ms": 239.7}, "device.overrun_leak_J": 0.0072}
HELD = {"theorem.margin_J": -0.007, "device.ledger": {"margin_J": -0.0071}, "environment": {"env_slack_J": 0.0}}


def test_what_held_forces_put_out_while_the_servo_was_away_is_the_servos() -> None:
    found = judge(but({**HELD, **AWAY}))
    assert found["passive"] is False
    assert "energy came from the servo (7 mJ)" in found["reason"]
    assert "1076 times, for up to 240 ms: 7.2 mJ came out beyond the account" in found["reason"]
    assert "coupling" not in found["reason"]
    assert not broken(but({**HELD, **AWAY}))
    line = overloaded(but({**HELD, **AWAY}))
    assert line.startswith("not passive, because of the servo and not of the coupling: the servo stalled")


@pytest.mark.parametrize(
    "worse",
    [
        {"theorem.margin_J": -0.0073},
        {"device.ledger": {"margin_J": -0.0073}},
        {"device.ledger": {"margin_J": -0.0071, "slack_J": -1e-8}},
        {"world.ledger": {"margin_J": -1e-8}},
        {"energy.down": FLOW | {"credited_nJ": 11}},
        {"hand": {"margin_J": -0.0073}},
    ],
)
def test_a_servo_that_was_away_excuses_nothing_else(worse: dict[str, Any]) -> None:
    changes = {**HELD, **AWAY, **worse}
    assert judge(but(changes))["passive"] is False
    assert broken(but(changes))
    assert overloaded(but(changes)) is None
    if "theorem.margin_J" in worse:
        assert "energy came from the servo (7.2 mJ), the coupling (0.1 mJ)" in judge(but(changes))["reason"]


def test_of_a_simulated_device_the_margins_tell_what_an_overrun_did() -> None:
    """Its port is known all the way; of a real one it is not, so there the same is a doubt."""
    changes = {**AWAY, "device.deficit_max_J": 0.0072}
    found = judge(but({**changes, "device.hand_work_J": 0.3}))
    assert found["passive"] is True
    assert found["reason"].endswith("1076 times, for up to 240 ms: 7.2 mJ came out beyond the account")
    assert judge(but(changes))["passive"] is None
    assert judge(but({**changes, "device.hand_work_J": 0.3, "device.deficit_max_J": 0.0073}))["passive"] is None


@pytest.mark.parametrize(
    "changes",
    [
        {"theorem.margin_J": -9e-10},
        {"device.deficit_max_J": 9e-13},
        {"world.unanswered_s": 4.9},
        {"device.quantisation_J": 0.09},
        {"device.quantisation_J": 0.2, "device.true_slack_J": -0.05},  # a simulation knows what the encoders hid
        {"device.overrun_leak_J": 0.0, "device.overrun_risk_J": 0.09},
        {"device.speed_max_mps": 1.0, "device.speed_limit_mps": 1.0},
        {"hand": {"work_J": -0.04}, "environment": {"work_J": -0.05}},
        {"device.force": "applied"},
        {"torn": 3, "energy": "none", "hand": []},
    ],
)
def test_what_is_no_fault(changes: dict[str, Any]) -> None:
    assert judge(but(changes))["passive"] is True


def test_a_device_that_tells_only_what_it_was_commanded() -> None:
    found = judge(but({"device.force": "commanded"}))
    assert found["passive"] is True
    assert found["reason"].endswith("; as commanded: the device does not report the applied force")


def test_of_a_sender_that_is_torn_or_began_anew_what_it_sent_is_not_known() -> None:
    more = {"energy.down": FLOW | {"credited_nJ": 99}}
    for changes in ({"torn": ["world"]}, {"device.incarnations": 2, "theorem.margin_J": None}):
        assert judge(but({**more, **changes}))["passive"] is None
    assert judge(but({**more, "torn": ["device"]}))["passive"] is False


@pytest.mark.parametrize("old", [None, {}, {"theorem": None}, {"device": {"ledger": {"margin_J": 0.5}}, "links": 3}])
def test_an_older_summary_that_lacks_what_counts_is_not_known(old: dict[str, Any] | None) -> None:
    assert judge(old)["passive"] is None


def test_an_older_summary_that_has_it_is_read() -> None:
    old = {"theorem": {"margin_J": 0.0312, "bound_J": 0.1}, "device": {"sent_nJ": 1}, "coupling": "pspm"}
    assert judge(old) == {"passive": True, "reason": "gave out at most 68.8 mJ of the 100 mJ allowed"}
    halves = {side: {"ledger": {"margin_J": margin}} for side, margin in (("device", 0.5), ("world", 0.25))}
    assert judge(halves) == {"passive": True, "reason": "margin at least 750 mJ"}


def test_of_ports_that_are_passive_together_only_one_alone_says_nothing() -> None:
    changes = {"coupling": "wave", "device.ledger.margin_J": -0.5, "device.ledger.slack_J": None}
    assert judge(but(changes))["passive"] is True
    assert judge(but({**changes, "theorem.margin_J": None}))["passive"] is None
    assert judge(but({**changes, "theorem.margin_J": None, "world": None}))["passive"] is None


# -- claims ----------------------------------------------------------------------------------------------------------

LINK = {"link.up": "delay 40ms", "link.down": "delay 40ms"}
CLAIMS: list[tuple[str, dict[str, object], bool]] = [
    ("pspm", {}, True),
    ("pspm", {"device.servo": "sampled"}, True),
    ("pspm", {"device.servo": "sampled", "device.harvest": "range"}, False),  # counts on the device's damping
    ("zoh", {}, False),
    ("popc", {}, False),  # one port's claim
    ("eba", {}, False),
    ("tdpa", {}, True),
    ("wave", {}, True),
    ("wave", {"wave.missing": "hold"}, False),
    ("digital-wave", {}, True),
    ("two-layer", {"link.up": "4g", "device.servo": "sampled"}, True),
    ("pd", {**LINK, "device.own_damping": 20.0}, True),
    ("pd", LINK, False),  # it warns: its hold leaks
    ("pd", {**LINK, "device.own_damping": 20.0, "link.up": "delay 40ms loss 1%"}, False),
    ("pd", {**LINK, "device.own_damping": 20.0, "link.up": "delay 40ms 5ms"}, False),
    ("pd", {**LINK, "device.own_damping": 20.0, "link.down_timeline": "at 1s: down"}, False),
    ("pd", {**LINK, "device.own_damping": 20.0, "pd.damping": 0.01}, False),
]


@pytest.mark.parametrize(("coupling", "changes", "claimed"), CLAIMS)
def test_what_is_claimed_of_a_coupling_on_a_link(coupling: str, changes: dict[str, object], claimed: bool) -> None:
    params = Params().set({"coupling": coupling, **changes})
    tuning = prepare(params, "continuous").tuning
    assert COUPLINGS[coupling].covers(params, tuning, True) == claimed
    failed = but({"coupling": coupling, "tuning": asdict(tuning), "theorem.margin_J": -0.5})
    assert broken(failed, params, virtual=True) == claimed
    if coupling == "pd":
        assert not broken(failed, params, virtual=False)  # nobody vouches for a real network's delay


def test_a_debt_that_is_claimed_to_be_possible_is_no_broken_claim() -> None:
    tuning = asdict(prepare(Params().set({"coupling": "tdpa", "tdpa.debt_limit_J": 0.02})).tuning)
    for margin, failed in ((-0.039, False), (-0.041, True)):
        summary = but({"coupling": "tdpa", "tuning": tuning, "theorem.margin_J": margin})
        assert judge(summary)["passive"] is False
        assert broken(summary) == failed


# -- a forged frame --------------------------------------------------------------------------------------------------


def test_one_forged_energy_frame_is_no_passive_run() -> None:
    """Somebody on the network says once, in the world's name, that it has sent 10.466 J; the device takes it for true.

    Of the device's own half nothing is wrong, and the margin of both halves stays where it was.
    """
    params = Params().set({"duration_s": 1.5, "wire.admission_burst_J": 20.0})
    simulation = Simulation(params, 1)
    simulation.pair()
    simulation._until(500 * MS)
    world, device = (end.session for end in (simulation.world_endpoint, simulation.device_endpoint))
    forged = Energy(world.identity.incarnation, device.identity.incarnation, 10_466_000_000, 0)
    simulation.device_endpoint.receive(simulation.now_ns, encode(forged))
    simulation._until(1_500 * MS)
    summary = simulation.close(1_500 * MS)
    assert summary["device"]["credited_nJ"] == 10_466_000_000
    assert summary["energy"]["down"]["abandoned_nJ"] < -10_000_000_000
    assert summary["device"]["ledger"]["slack_J"] >= -1e-9
    assert summary["verdict"]["passive"] is False
    assert "mJ that the world never sent" in summary["verdict"]["reason"]
    assert broken(summary, params, virtual=True)
    parts = [
        with_wire(make(side, "pspm"), session, simulation.now_ns)
        for make, side, session in (
            (device_summary, simulation.device, device),
            (world_summary, simulation.world, world),
        )
    ]
    apart = combine(*parts, {"up": None, "down": None}, seed=1, duration_s=1.0, coupling="pspm")
    assert apart["theorem"]["margin_J"] is None  # the sum of the halves bounds nothing then
    assert apart["verdict"]["passive"] is False


def test_the_device_alone_cannot_know_of_a_forged_frame() -> None:
    rng = random.Random(1)
    rig = Rig("device", rng, prepare(Params().set({"device.servo": "sampled"}), "sampled"))
    for _ in range(20):
        rig.run(MS)
    assert rig.paired
    peer, own = rig.honest.identity.incarnation, rig.session.identity.incarnation
    rig.attack(encode(Energy(peer, own, 400_000_000, 0)))
    rig.run(MS)
    assert rig.session.credited_nJ == 400_000_000


# -- an energy stream that nobody answers ----------------------------------------------------------------------------


def test_a_stream_of_energy_that_is_dead_is_seen_and_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing on the device's energy key arrives: positions do, in both directions, and the run goes on as if all were
    well."""
    params = Params().set({"operator": "sine", "duration_s": 9.0, "link.up": "", "link.down": ""})
    simulation = Simulation(params, 1, kernel=False)
    receive = simulation.world_endpoint.receive

    def deaf(now_ns: int, data: bytes) -> Any:
        return () if isinstance(decode(data), Energy) else receive(now_ns, data)

    monkeypatch.setattr(simulation.world_endpoint, "receive", deaf)
    summary = simulation.run().summary
    assert summary["device"]["sent_nJ"] > 0
    assert summary["device"]["acked_nJ"] == summary["world"]["credited_nJ"] == 0
    assert summary["world"]["received"] > 1000
    assert summary["device"]["unanswered_s"] > 6.0
    assert summary["verdict"]["passive"] is None
    assert "the device's energy stream is dead" in summary["verdict"]["reason"]


def test_a_silence_of_everything_is_no_dead_stream() -> None:
    words = {
        "operator": "sine",
        "duration_s": 9.0,
        "link.up_timeline": "at 1s: down",
        "link.down_timeline": "at 1s: down",
    }
    summary = simulate(Params().set(words), 1).summary
    assert summary["device"]["unanswered_s"] < 1.0
    assert summary["verdict"]["passive"] is True


# -- commands --------------------------------------------------------------------------------------------------------


def test_a_coupling_that_did_not_keep_its_claim_ends_with_4(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A simulation whose device's account was wrong by a millijoule."""
    run = Simulation.run

    def off(self: Simulation, progress: Any = None) -> Any:
        result = run(self, progress)
        result.summary["device"]["ledger"]["slack_J"] = -1e-3
        result.summary.update(judged(result.summary))
        return result

    monkeypatch.setattr(Simulation, "run", off)
    words = ["simulate", "--no-files", "--duration", "0.2"]
    assert cli.main(words) == 4
    out, err = capsys.readouterr()
    why = "the device's half of the theorem fails by 1 mJ"
    assert out.startswith(f"NOT PASSIVE: {why}")
    assert err == f"hapnet: the coupling pspm claims to be passive, but was not: {why}\n"
    assert cli.main([*words, "--coupling", "zoh"]) == 0


def test_a_law_of_ones_own_is_held_to_its_claim_where_it_runs_but_not_by_a_file_that_names_it() -> None:
    tuning = {"stiffness_N_m": 50.0, "damping_Ns_m": 1.5}
    summary = but({"coupling": "examples.own_law:Mine", "tuning": tuning, "theorem.margin_J": -0.2})
    assert judge(summary)["passive"] is False
    claiming = dataclasses.replace(Mine, covers=lambda params, tuning, virtual: True)
    assert broken(summary, spec=claiming)
    assert not broken(summary, spec=Mine)  # which claims nothing
    assert not broken(summary)


def test_a_servo_that_was_away_for_too_long_ends_with_3(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run = Simulation.run

    def away(self: Simulation, progress: Any = None) -> Any:
        result = run(self, progress)
        result.summary["device"] = {**result.summary["device"], **but(AWAY)["device"], **but(HELD)["device"]}
        result.summary["theorem"]["margin_J"] = -0.007
        result.summary.update(judged(result.summary))
        return result

    monkeypatch.setattr(Simulation, "run", away)
    assert cli.main(["simulate", "--no-files", "--duration", "0.2"]) == 3
    out, err = capsys.readouterr()
    assert out.startswith("NOT PASSIVE: ")
    assert "hapnet: not passive, because of the servo and not of the coupling: the servo stalled" in err
