"""Accounts: what each side reports of its half comes over any link, and makes the same summary there as here."""

from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given, strategies as st
from msgspec import structs

from hapnet.recording.samples import DeviceSample, WorldSample
from hapnet.simulation.result import Result
from hapnet.simulation.simulation import simulate
from hapnet.summary.former import former_part
from hapnet.summary.from_samples import LiveFigures, motion
from hapnet.summary.recorded import of_parts
from hapnet.summary.reported import Claim, joined, values_of
from hapnet.summary.run import combine, merge
from hapnet.summary.structure import SIDES, Summary
from hapnet.summary.verdict import judge
from hapnet.wire.account import Heard
from hapnet.wire.fields import Signal
from hapnet.wire.messages import MAX_FRAME_BYTES, Account, Role, decode, encode
from hapnet.wire.session import Session
from tests.support.sessions import MS, Network, paired


def talk(network: Network, seconds: float, values: Mapping[Session, tuple[dict[str, Signal], bool]]) -> None:
    """Run the network; each side answers when it is asked, within 50 ms, and reports its values once a second."""
    for round_ in range(round(seconds * 20)):
        for one, (reported, final) in values.items():
            if one.accounts.owes or round_ % (1000 if final else 20) == 0:
                one.accounts.report(reported, final=final)
        network.run(50 * MS)


@pytest.mark.parametrize("seed", range(5))
def test_over_a_lossy_link_both_have_the_last_account_of_the_other(seed: int) -> None:
    """One goes on: its answer, made after the other had ended, covers the other's time."""
    network, device, world = paired(seed=seed, jitter=30 * MS)
    network.loss, network.repeat = 0.4, 0.2
    talk(network, 3.0, {device: ({"n": 1}, False), world: ({"n": 2}, False)})
    assert not device.accounts.whole
    assert not world.accounts.whole
    assert not device.accounts.known
    talk(network, 5.0, {device: ({"n": 3}, True), world: ({"n": 4}, False)})
    assert device.accounts.known
    assert device.accounts.whole
    heard, theirs = device.accounts.heard, world.accounts.heard
    assert (heard.values, heard.final) == ({"n": 4}, False)
    assert (theirs.values, theirs.final) == ({"n": 3}, True)
    assert world.accounts.whole


def test_an_answer_from_before_the_end_does_not_cover_it() -> None:
    network, device, world = paired()
    world.accounts.report({"n": 2}, final=False)
    network.run(50 * MS)
    device.accounts.report({"n": 1}, final=True)
    network.run(1000 * MS)
    assert world.accounts.owes
    assert not device.accounts.whole
    assert not device.accounts.known


def test_two_that_end_fall_silent_when_both_are_answered() -> None:
    network, device, world = paired()
    talk(network, 1.0, {device: ({"n": 1}, True), world: ({"n": 2}, True)})
    assert device.accounts.known
    assert world.accounts.known
    before = len(network.sent)
    network.run(2000 * MS)
    assert not [data for data in network.sent[before:] if isinstance(decode(data), Account)]
    assert device.accounts.next_due_ns is world.accounts.next_due_ns is None


def test_what_the_last_peer_told_stays_when_it_leaves_and_a_new_one_has_told_nothing() -> None:
    network, device, world = paired()
    talk(network, 0.5, {device: ({"n": 1}, True)})
    device.close(network.now, "over")
    network.run(500 * MS)
    assert world.peer is None
    assert world.accounts.heard is not None
    world.accounts.change_pair(paired=True)
    assert world.accounts.heard is None


def test_bad_accounts_are_counted_and_dropped() -> None:
    network, device, world = paired()
    world.accounts.report({"n": 2}, final=False)
    network.run(50 * MS)
    good = Account(2, 1, 7, 0, False, False, {"n": 7})
    kinds = {
        "stale": structs.replace(good, number=6), "range": structs.replace(good, heard=1),
        "addressee": structs.replace(good, addressee=9),
        "rival": structs.replace(good, incarnation=9),
    }  # fmt: skip
    device.receive(network.now, device.position(network.now, (0.0,)))
    device.receive(network.now, world.position(network.now, (0.0,)))  # it is living
    device.receive(network.now, encode(good))
    device.dropped.clear()
    for message in kinds.values():
        device.receive(network.now, encode(message))
    assert device.dropped == dict.fromkeys(kinds, 1)
    assert device.accounts.heard.values == {"n": 7}


# The summary of both


@pytest.fixture(scope="module")
def result() -> Result:
    return simulate({"duration_s": 3.0, "link.up": "delay 20ms loss 2%", "link.down": "delay 20ms"}, seed=1)


def own(result: Result, role: Role) -> Summary:
    """What one side alone would know of the run."""
    whole = result.summary
    parts = {side: whole[side] if side == role else None for side in SIDES}
    summary = combine(
        parts["device"], parts["world"], {"up": None, "down": None}, seed=1, duration_s=3.0, coupling="pspm",
        felt=whole["environment"],
    )  # fmt: skip
    live = LiveFigures()
    for sample in samples(result, role):
        live.see(sample)
    summary["motion"] = live.motion()
    return summary


def samples(result: Result, role: Role) -> list[Any]:
    kind = DeviceSample if role == "device" else WorldSample
    return [sample for sample in result.recording.samples() if isinstance(sample, kind)]


def claimed(result: Result, role: Role, *, final: bool = True, whole: bool = True, **changes: Signal) -> Claim:
    """What the other side reported, through the wire."""
    values = {
        **values_of(own(result, role), role),
        **{name.replace("__", "."): value for name, value in changes.items()},
    }
    data = encode(Account(1, 2, 1, 0, True, final, values))
    assert len(data) < 1200 < MAX_FRAME_BYTES
    message = decode(data)
    assert isinstance(message, Account)
    return Claim(message.values, 2.5, final, whole)


@pytest.mark.parametrize("role", SIDES)
def test_only_a_side_that_had_several_peers_reports_the_accounts_of_earlier_ones(role: Role, result: Result) -> None:
    summary = own(result, role)
    part = summary[role]
    assert part is not None
    former = former_part([Heard(1, {"ledger.margin_J": 0.01, "sent_nJ": 7}, True, 0, 0)])
    for peers in (1, 2):
        summary[role] = {**part, "incarnations": peers, "former": former}  # the result is of other tests too
        values = values_of(summary, role)
        assert (values.get("former.sent_nJ"), values.get("former.margin_J")) == (
            (7, 0.01) if peers > 1 else (None, None)
        )


@pytest.mark.parametrize("role", SIDES)
def test_the_joint_summary_is_that_of_both_halves(role: Role, result: Result) -> None:
    """As `hapnet report` makes it of both sides' own."""
    other: Role = "world" if role == "device" else "device"
    there = joined(own(result, role), role, claimed(result, other))
    merged = merge(own(result, "device"), own(result, "world"))
    for key in ("theorem", "energy", "hand", "environment"):
        assert there[key] == merged[key]  # type: ignore[literal-required]
    assert there["verdict"]["passive"] is True
    assert there["verdict"]["reason"] == f"{merged['verdict']['reason']}; the {other}'s account as it reported it"
    expected = motion(result.recording)
    for name in ("peak_force_N", "peak_penetration_m", "contacts"):
        assert there["motion"][name] == pytest.approx(expected[name], rel=1e-12)  # type: ignore[literal-required]
    assert expected["contacts"]


def test_a_peer_that_vanished_leaves_the_verdict_open_and_is_not_accused(result: Result) -> None:
    open_ = joined(own(result, "device"), "device", claimed(result, "world", final=False, whole=False))
    assert open_["verdict"]["passive"] is None
    words = "the rest of the world's account is missing since its last report, 2.5 s after pairing"
    assert open_["verdict"]["reason"].startswith(words)
    credited = result.summary["world"]["credited_nJ"]
    assert credited
    fewer = credited // 2  # it sent more since
    later = joined(own(result, "world"), "world", claimed(result, "device", final=False, sent_nJ=fewer))
    assert later["verdict"]["passive"] is True
    forged = joined(own(result, "world"), "world", claimed(result, "device", sent_nJ=fewer))
    assert forged["verdict"]["passive"] is False
    assert "the world credited" in forged["verdict"]["reason"]


@pytest.mark.parametrize("killed", SIDES)
def test_a_pair_whose_side_was_killed_is_judged_by_what_the_other_one_heard(killed: Role, result: Result) -> None:
    """A side that is killed leaves no summary; the other's has its last report, and the verdict says what is not."""
    left: Role = "world" if killed == "device" else "device"
    heard = claimed(result, killed, final=False, whole=False)
    reported = {left: joined(own(result, left), left, heard)}
    found = of_parts(reported, {}, None, {killed: "was killed by SIGKILL"}, coupling="pspm", seed=1, margins={})
    assert found["verdict"]["passive"] is None
    words = f"the rest of the {killed}'s account is missing since its last report, 2.5 s after pairing"
    assert words in found["verdict"]["reason"]
    assert f"the {killed} ended before its time: was killed by SIGKILL" in found["verdict"]["reason"]
    assert found[killed]["ledger"]["margin_J"] is not None
    nothing = of_parts({}, {}, None, {killed: "was killed by SIGKILL"}, coupling="pspm", seed=1)
    assert nothing["verdict"] == {"passive": None, "reason": "there is no energy account"}


def test_a_half_that_its_side_says_was_not_kept_counts(result: Result) -> None:
    bad = joined(own(result, "device"), "device", claimed(result, "world", ledger__slack_J=-0.004))
    assert bad["verdict"]["passive"] is False
    assert "the world's half of the theorem fails by 4 mJ" in bad["verdict"]["reason"]
    assert "as it reported it" in bad["verdict"]["reason"]


NAMES = st.sampled_from([
    "ledger.margin_J", "ledger", "ledger.bound_J", "sent_nJ", "incarnations", "stopped.why", "stopped.after_s",
    "peers_J", "motion.contacts", "path.sent", "path.lost", "wall.springs_N_m", "wall.stiffness_N_m", "nobody.knows",
])  # fmt: skip
ONE = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False, allow_infinity=False)
ANY = ONE | st.text(max_size=5) | st.lists(st.floats(-9, 9), max_size=3).map(tuple)


@given(st.dictionaries(NAMES, ANY), st.booleans(), st.booleans())
def test_whatever_a_peer_claims_there_is_a_verdict(values: dict[str, Signal], final: bool, whole: bool) -> None:
    part: Any = {"ledger": {"margin_J": 0.1, "bound_J": 0.1}, "sent_nJ": 5, "credited_nJ": 5, "acked_nJ": 5}
    part |= {"abandoned_nJ": 0, "in_flight_nJ": 0}
    alone = combine(None, part, {"up": None, "down": None}, seed=1, duration_s=1.0, coupling="pspm")
    found = joined(alone, "world", Claim(values, 1.0, final, whole))
    assert judge(found)["reason"]
    assert found["world"] == part
