"""Who gets in, and what they may then read and write: over real connections."""

import asyncio
import contextlib
import re
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from pathlib import Path

import pytest
import zenoh

from hapnet.transport.config import ZenohSettings, free_address, zenoh_config
from hapnet.transport.security import Security
from tests.conftest import mostly_slow
from tests.support.processes import read_json, started
from tests.support.secured import ACCESS, shows, users as users
from tests.support.transports import WAIT_S, Side, assert_exchange, opened, own, paired

REFUSED_S = 0.8
"""How long who is refused goes on trying; Zenoh dials every 0.1 to 0.5 s [s]."""


# Over loopback: who gets in


async def never(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + REFUSED_S
    while time.monotonic() < deadline:
        assert not condition()
        await asyncio.sleep(0.02)


@contextlib.asynccontextmanager
async def opened_together(*sides: Side) -> AsyncIterator[None]:
    """Who is not let in opens after a second only."""
    async with contextlib.AsyncExitStack() as stack:
        await asyncio.gather(*(stack.enter_async_context(opened(side)) for side in sides))
        yield


async def assert_only(right: Side, strangers: dict[str, Side], world: Side) -> None:
    """The right one gets in and is heard, in both directions; who came before it, with the same names, is not, nor
    hears."""
    async with opened(world), opened_together(*strangers.values()), opened(right):
        await paired(world, right)
        await never(lambda: any(side.transport.peers or side.transport.partners for side in strangers.values()))
        for side in strangers.values():
            side.transport.put("control", b"let me in")
        await assert_exchange(world, right)
        assert (world.transport.peers, world.transport.partners) == (1, 1)
        assert all(side.received.empty() for side in strangers.values())


@pytest.mark.parametrize("protocol", mostly_slow(["tls", "quic"], 1))
async def test_mutual_tls(protocol: str, certificates: Path) -> None:
    endpoint = free_address(protocol)

    def dialler(security: Security) -> Side:
        return Side("device", ZenohSettings(connect=(endpoint,), security=security))

    strangers = {
        "no certificate": dialler(Security(certificates / "ca.pem")),
        "another authority's": dialler(own(certificates, "other/alice")),
        "wrong root": dialler(own(certificates, "alice", ca="other")),
        "no root": dialler(Security()),
    }
    world = Side("world", ZenohSettings(listen=(endpoint,), security=own(certificates, "world", mutual=True)))
    await assert_only(dialler(own(certificates, "alice")), strangers, world)


async def test_who_is_not_the_world_cannot_play_it(certificates: Path) -> None:
    """Neither with a certificate of another authority, nor with a device's own, which is not for that address."""
    names = ("world", "bob", "other/world")
    endpoints = [free_address("tls") for _ in names]
    right, *wrong = (
        Side("world", ZenohSettings(listen=(endpoint,), security=shows(certificates, name)))
        for endpoint, name in zip(endpoints, names, strict=True)
    )
    device, *deceived = (
        Side("device", ZenohSettings(connect=(endpoint,), security=own(certificates, "alice")))
        for endpoint in endpoints
    )
    async with opened(right, *wrong), opened_together(*deceived), opened(device):
        await paired(right, device)
        await never(lambda: any(side.transport.peers for side in (*wrong, *deceived)))
        await assert_exchange(right, device)


async def test_users(certificates: Path, users: Path) -> None:
    endpoint, world = free_address("tls"), shows(certificates, "world")

    def dialler(user: str | None, password: str | None) -> Side:
        security = Security(certificates / "ca.pem", user=user, password=password)
        return Side("device", ZenohSettings(connect=(endpoint,), security=security))

    strangers = {
        "wrong password": dialler("alice", "guess"),
        "another's password": dialler("alice", "b:o b"),
        "unknown": dialler("eve", "secret"),
        "nobody": dialler(None, None),
    }
    listener = Side("world", ZenohSettings(listen=(endpoint,), security=replace(world, users=users)))
    await assert_only(dialler("bob", "b:o b"), strangers, listener)


# Over loopback: who may do what


Got = Counter[tuple[str, str]]


@contextlib.asynccontextmanager
async def session(settings: ZenohSettings, got: Got, *subscriptions: str) -> AsyncIterator[zenoh.Session]:
    """A bare Zenoh session under hapnet's configuration, which counts what it gets: keys, and who sent it."""
    opened = await asyncio.to_thread(zenoh.open, zenoh_config(settings))

    def count(sample: zenoh.Sample) -> None:
        got[str(sample.key_expr), sample.payload.to_string()] += 1

    try:
        for key in subscriptions:
            opened.declare_subscriber(key, zenoh.handlers.Callback(count, indirect=False))
        yield opened
    finally:
        await asyncio.to_thread(opened.close)


NAMES = ("alice", "bob")
UPS = [f"hapnet/s/{name}/up/position" for name in NAMES]
DOWNS = [f"hapnet/s/{name}/down/position" for name in NAMES]


def known(by: str, certificates: Path, users: Path, config: str) -> tuple[ZenohSettings, ...]:
    """The settings of a world with access control, of alice and of bob."""
    if by == "certificate":
        endpoint, world = free_address("tls"), own(certificates, "world", mutual=True)
        devices = [own(certificates, name) for name in NAMES]
    else:
        endpoint, world = free_address("tcp"), Security(users=users)
        devices = [Security(user="alice", password="secret"), Security(user="bob", password="b:o b")]
    dials = (ZenohSettings(connect=(endpoint,), security=device) for device in devices)
    return ZenohSettings(listen=(endpoint,), config=config, security=world), *dials


async def until_each_came_often(*expected: tuple[Got, tuple[str, str]], put: Callable[[], None]) -> None:
    deadline = time.monotonic() + WAIT_S
    while missing := [message for got, message in expected if got[message] < 20]:
        assert time.monotonic() < deadline, missing
        put()
        await asyncio.sleep(0.005)


@pytest.mark.parametrize("by", ["certificate", "password"])
async def test_a_device_writes_its_own_up_keys_only(by: str, certificates: Path, users: Path, tmp_path: Path) -> None:
    """Even if it sends what nobody told it to: here the world sends every device that it wants everything."""
    text = Path(ACCESS).read_text("utf-8")
    told_all = tmp_path / "told_all.json5"
    loosened, rules = re.subn(r'(flows: \["egress"\], key_exprs: )\[[^]]*\]', r'\1["**"]', text)
    assert rules == 4
    told_all.write_text(loosened, "utf-8")
    world, *devices = known(by, certificates, users, str(told_all))
    got = Got()
    async with session(world, got, "**"), session(devices[0], Got()) as alice, session(devices[1], Got()) as bob:

        def put() -> None:
            for device, name in ((alice, "alice"), (bob, "bob")):
                for key in (*UPS, *DOWNS, f"hapnet/s/{name}", f"hapnet/s/{name}/up/position/x", "else"):
                    device.put(key, name)

        right = [(up, name) for up, name in zip(UPS, NAMES, strict=True)]
        await until_each_came_often(*((got, message) for message in right), put=put)
    assert set(got) == set(right)


@pytest.mark.parametrize("by", ["certificate", "password"])
async def test_a_device_reads_its_own_down_keys_only(by: str, certificates: Path, users: Path) -> None:
    world, *devices = known(by, certificates, users, ACCESS)
    at_alice, at_bob = Got(), Got()
    greedy = (*UPS, *DOWNS, "hapnet/s/*/down/*", "hapnet/**", "**")
    async with (
        session(world, Got()) as listener,
        session(devices[0], at_alice, *greedy),
        session(devices[1], at_bob, *greedy),
    ):

        def put() -> None:
            for key in (*UPS, *DOWNS, "else"):
                listener.put(key, "world")

        right = [(down, "world") for down in DOWNS]
        await until_each_came_often((at_alice, right[0]), (at_bob, right[1]), put=put)
    assert (set(at_alice), set(at_bob)) == ({right[0]}, {right[1]})


async def test_a_viewer_reads_telemetry_and_nothing_else(certificates: Path) -> None:
    """Of both sides, through the one it dials; and whatever it says reaches nobody."""
    endpoint = free_address("tls")
    world = ZenohSettings(listen=(endpoint,), config=ACCESS, security=own(certificates, "world", mutual=True))
    alice = ZenohSettings(connect=(endpoint,), security=own(certificates, "alice"))
    viewer = ZenohSettings(mode="client", connect=(endpoint,), security=own(certificates, "viewer"))
    ways = ("hapnet/s/alice/up", "hapnet/s/alice/down")
    telemetry = [f"{way}/telemetry" for way in ways]
    at_world, at_alice, seen = Got(), Got(), Got()
    greedy = (*telemetry, "**", "hapnet/s/alice/up/*", *(f"{way}/position" for way in ways))
    async with (
        session(world, at_world, "hapnet/s/alice/up/position") as listener,
        session(alice, at_alice, "hapnet/s/alice/down/position") as device,
        session(viewer, seen, *greedy) as watching,
    ):

        def put() -> None:
            for kind in ("telemetry", "position"):
                device.put(f"{ways[0]}/{kind}", "device")
                listener.put(f"{ways[1]}/{kind}", "world")
                for way in ways:
                    watching.put(f"{way}/{kind}", "viewer")

        right = [(telemetry[0], "device"), (telemetry[1], "world")]
        went = [(at_world, (f"{ways[0]}/position", "device")), (at_alice, (f"{ways[1]}/position", "world"))]
        await until_each_came_often(*((seen, message) for message in right), *went, put=put)
    assert {message for message in seen if message[1] != "viewer"} == set(right)  # it hears itself
    assert "viewer" not in {words for got in (at_world, at_alice) for _, words in got}


async def test_a_device_with_another_ones_name_is_neither_seen_nor_heard(certificates: Path) -> None:
    """The transport itself under access control, its liveliness tokens too."""
    endpoint, names = free_address("tls"), {"session": "s", "device": "alice"}
    listens = ZenohSettings(listen=(endpoint,), config=ACCESS, security=own(certificates, "world", mutual=True))
    world = Side("world", listens, **names)
    alice, bob = (
        Side("device", ZenohSettings(connect=(endpoint,), security=own(certificates, name)), **names)
        for name in ("alice", "bob")
    )
    async with opened(world, bob, alice):
        await paired(world, alice)
        while not bob.transport.peers:
            await asyncio.wait_for(bob.changed.wait(), WAIT_S)
        for _ in range(20):
            assert bob.transport.put("position", b"not mine")
        await assert_exchange(world, alice)
        await never(lambda: not bob.received.empty() or not world.received.empty() or bob.transport.partners > 0)
        assert world.transport.partners == 1


# The commands


@pytest.mark.slow
def test_both_commands_with_certificates_users_and_access_control(
    certificates: Path, users: Path, tmp_path: Path
) -> None:
    address = free_address("tls")
    password = tmp_path / "password"
    password.write_text("secret\n", "utf-8")
    password.chmod(0o600)

    def side(role: str, name: str, *more: object) -> list[object]:
        files = ("--tls-cert", certificates / f"{name}.pem", "--tls-key", certificates / f"{name}.key")
        common = ("--tls-ca", certificates / "ca.pem", *files, "--name", "alice", "--duration", 1)
        return [role, *common, *more, "--json", tmp_path / f"{role}.json"]

    with (
        started(*side("world", "world", "-l", address, "--mutual-tls", "--users", users, "-c", ACCESS)) as world,
        started(*side("device", "alice", "-e", address, "--user", "alice", "--password-file", password)) as device,
    ):
        for code, stdout, stderr in (world.end(), device.end()):
            assert (code, stderr) == (0, "")
            assert "identity is not proven" not in stdout
    ends = {role: read_json(tmp_path / f"{role}.json") for role in ("device", "world")}
    sent = ends["device"]["device"]["sent_nJ"]
    assert sent > 0
    up, down = (ends[role]["energy"][way] for role, way in (("device", "up"), ("world", "down")))
    assert ends["world"]["world"]["credited_nJ"] == sent - up["in_flight_nJ"] - up["abandoned_nJ"]
    back = ends["world"]["world"]["sent_nJ"] - down["in_flight_nJ"] - down["abandoned_nJ"]
    assert ends["device"]["device"]["credited_nJ"] == back
    for role in ("device", "world"):
        assert ends[role][role]["ledger"]["margin_J"] > 0.0
