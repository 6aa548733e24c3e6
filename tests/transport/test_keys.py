import asyncio
from collections.abc import Collection

import pytest
import zenoh
from hypothesis import given, strategies as st

from hapnet.transport.config import ZenohSettings, free_address, may_lose, zenoh_config
from hapnet.transport.keys import (  # fmt: skip
    AGAIN_NS,
    IN_VAIN,
    KEEP_ALIVE_NS,
    SILENT_NS,
    WATCH_NS,
    KeyWatch,
    any_node,
    key_expressions,
)
from hapnet.transport.zenoh import KINDS
from netem import LinkProfile
from netem.relay import UdpRelay
from tests.support.lossy import Arrivals, talking
from tests.support.transports import Side, opened, paired

MS = 1_000_000


@given(st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, 400 * MS)), max_size=40))
def test_no_key_is_quiet_for_longer_than_it_may(puts: list[tuple[str, int]]) -> None:
    """Looked at every `WATCH_NS`, whatever else is put in between; and nothing is added to a key that is busy."""
    watch, now_ns, begin_ns = KeyWatch(KINDS), 10**12, 10**12
    sent: dict[str, list[int]] = {kind: [begin_ns] for kind in KINDS}
    for kind in KINDS:
        watch.sent(kind, begin_ns)
    own: list[tuple[int, str]] = []
    for kind, wait_ns in puts:
        own.append((own[-1][0] + wait_ns if own else begin_ns + wait_ns, kind))
    end_ns = own[-1][0] if own else begin_ns + 1000 * MS
    while now_ns < end_ns:
        now_ns += WATCH_NS
        for at_ns, kind in own:
            if now_ns - WATCH_NS < at_ns <= now_ns:
                watch.sent(kind, at_ns)
                sent[kind].append(at_ns)
        for kind in watch.quiet(now_ns):
            assert now_ns - sent[kind][-1] >= KEEP_ALIVE_NS - WATCH_NS
            watch.sent(kind, now_ns)
            sent[kind].append(now_ns)
    for times in sent.values():
        assert all(b - a <= KEEP_ALIVE_NS for a, b in zip([*times], [*times[1:], now_ns], strict=True))


def test_a_silent_key_is_declared_again_and_again_until_it_is_heard() -> None:
    watch, now = KeyWatch(KINDS), 10**12
    watch.connected(now, is_connected=False)
    assert not watch.silent(now)  # nobody is there
    watch.connected(now, is_connected=True)
    assert not watch.declare_now(now + SILENT_NS)
    assert watch.declare_now(now + SILENT_NS + 1)
    assert not watch.declare_now(now + SILENT_NS + AGAIN_NS)
    now += SILENT_NS + AGAIN_NS + 1
    watch.heard("position", now)
    watch.heard("energy", now)
    assert watch.silent(now) == ["control"]
    assert watch.declare_now(now)
    watch.heard("control", now)
    assert not watch.declare_now(now + AGAIN_NS)
    assert watch.silent(now + SILENT_NS + 1) == list(KINDS)
    watch.connected(now, is_connected=False)  # the next one is given time
    watch.connected(now + SILENT_NS, is_connected=True)
    assert not watch.silent(now + 2 * SILENT_NS)


def given_up(watch: KeyWatch, now_ns: int, until_ns: int, alive: Collection[str] = ()) -> tuple[int, int, list[str]]:
    """Look every `WATCH_NS` as the transport does, while `alive` are heard; when, after how many declarations, what."""
    declared = 0
    while now_ns < until_ns:
        now_ns += WATCH_NS
        for kind in alive:
            watch.heard(kind, now_ns)
        watch.connected(now_ns, is_connected=True)
        if dead := watch.dead(now_ns):
            return now_ns, declared, dead
        declared += watch.declare_now(now_ns)
    return now_ns, declared, []


def test_a_key_is_dead_after_ten_declarations_in_vain_while_others_live() -> None:
    """After 3 s: a key is silent after 0.45 s, and each declaration has 0.25 s for its effect."""
    watch, began_ns = KeyWatch(KINDS), 10**12
    watch.connected(began_ns, is_connected=True)
    now_ns, declared, dead = given_up(watch, began_ns, began_ns + 10**11, alive=["position"])
    assert dead == ["energy", "control"]
    assert declared == IN_VAIN + 1  # the last shows that the one before it had its time
    assert now_ns - began_ns <= SILENT_NS + (IN_VAIN + 1) * AGAIN_NS + 4 * WATCH_NS


def test_nothing_is_dead_where_nobody_ever_spoke() -> None:
    """Somebody else may be connected."""
    watch, now_ns = KeyWatch(KINDS), 10**12
    watch.connected(now_ns, is_connected=True)
    assert given_up(watch, now_ns, now_ns + 10**11)[2] == []


def test_no_key_is_dead_because_nobody_looked() -> None:
    """A process that was stopped for a minute has declared nothing meanwhile: silence alone proves nothing."""
    watch, now_ns = KeyWatch(KINDS), 10**12
    watch.heard("position", now_ns)
    watch.connected(now_ns, is_connected=True)
    assert not watch.dead(now_ns + 60 * 10**9)


@pytest.mark.parametrize("alive", [[], ["position"]])
def test_another_session_is_tried_less_and_less_often(alive: list[str]) -> None:
    """After 3, 5, 10, 20, 40, 80 and 80 s; a word on the silent keys begins anew."""
    watch, now_ns = KeyWatch(KINDS), 10**12
    silent = [kind for kind in KINDS if kind not in alive]
    for _ in range(2):
        for kind in KINDS:
            watch.heard(kind, now_ns)
        for patience in (10, 20, 40, 80, 160, 320, 320):
            watch.connected(now_ns, is_connected=False)
            watch.connected(now_ns, is_connected=True)
            now_ns, declared, dead = given_up(watch, now_ns, now_ns + 10**12, alive)
            assert (declared, dead) == (patience + 1, silent)


def test_the_expressions_hold_the_three_keys_and_nothing_else() -> None:
    expressions = [zenoh.KeyExpr(text) for text in key_expressions("hapnet/s/d/up")]
    assert len({str(each) for each in expressions}) == len(expressions) > 3
    for each in expressions:
        assert all(each.includes(zenoh.KeyExpr(f"hapnet/s/d/up/{kind}")) for kind in KINDS)
        others = ("up/telemetry", "up/2423a0fdad58225298c60e87ec2e410c", "down/position")
        assert not any(each.intersects(zenoh.KeyExpr(f"hapnet/s/d/{other}")) for other in others)
    assert zenoh.KeyExpr("hapnet/*/d/up/*").includes(expressions[1])  # what access control asks for


def test_all_nodes_of_a_side_are_looked_for_without_declaring_how_its_keys_begin() -> None:
    """Over a lossy link; over others the literal beginning, which is all that access control allows, is never lost."""
    token, others = "hapnet/s/d/up/2423a0fdad58225298c60e87ec2e410c", ("hapnet/s/d/down/2423a0fd", "hapnet/s/e/up/24")
    for lossy in (True, False):
        looked = zenoh.KeyExpr(any_node("hapnet/s/d/up", lossy=lossy))
        assert looked.includes(zenoh.KeyExpr(token))
        assert not any(looked.intersects(zenoh.KeyExpr(other)) for other in others)
        assert str(looked).startswith("*/") is lossy


@pytest.mark.parametrize(
    ("endpoint", "loses"),
    [("udp/127.0.0.1:1", True), ("tcp/127.0.0.1:1", False), ("tcp/127.0.0.1:1?rel=0", True)],
)
def test_which_links_may_lose_a_declaration(endpoint: str, loses: bool) -> None:
    for settings in (ZenohSettings(listen=(endpoint,)), ZenohSettings(connect=(endpoint,))):
        assert may_lose(zenoh_config(settings)) is loses


async def test_keys_with_nothing_to_carry_carry_keep_alives_that_nobody_else_sees() -> None:
    endpoint = free_address()
    world, device = Side("world", ZenohSettings(listen=(endpoint,))), Side("device", ZenohSettings(connect=(endpoint,)))
    watches = [Arrivals(), Arrivals()]
    world.transport._watch, device.transport._watch = watches
    async with opened(world, device), asyncio.timeout(10.0):
        while any(len(times) < 3 for watch in watches for times in watch.times_ns.values()):
            await asyncio.sleep(0.01)
        assert world.received.empty()
        assert device.received.empty()
        assert not world.transport.declared_again


async def test_energy_is_not_lost_among_the_positions_that_overtake_it() -> None:
    """No datagram is lost here; but Zenoh drops one that comes after later ones of the same priority.

    With the positions' priority nearly all would be dropped: each has ten positions behind it within the jitter. Some
    may overtake each other, where this machine lets two leave at once.
    """

    def jittery(listen: str, to: str) -> UdpRelay:
        profile = LinkProfile.parse("delay 20ms 10ms")
        return UdpRelay(listen, to, profile, profile)

    async with talking("udp", jittery) as two:
        await two.until_paired()
        await two.until_all_heard()  # the declaration of a key may be overtaken too: then it is declared again, later
        for side in two.sides:
            side.shuffles = False
        device, came = two.device.transport, two.world.unreadable
        for tick in range(400):
            device.put("position", b"-")
            if tick % 20 == 0:  # further apart than the jitter
                device.put("energy", b"-")
            await asyncio.sleep(0.002)
        device.put("control", b"-")
        await two.until(lambda: came["control"] > 0, 10.0)
        await two.until(lambda: came["energy"] >= 15, 10.0)


async def test_a_transport_of_low_latency_works() -> None:
    """Zenoh's `info.transports()` and its events with history panic there."""
    endpoint, cfg = free_address(), ("transport/unicast/lowlatency:true",)
    world = Side("world", ZenohSettings(listen=(endpoint,), cfg=cfg))
    device = Side("device", ZenohSettings(connect=(endpoint,), cfg=cfg))
    async with opened(world, device):
        await paired(world, device)
        assert (world.transport.peers, device.transport.peers) == (1, 1)
        device.transport.put("energy", b"x")
        assert await asyncio.wait_for(world.received.get(), 10.0) == ("energy", b"x")
    assert world.transport.peers == 0
