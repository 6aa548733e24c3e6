import asyncio
import contextlib
import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import cast

import pytest

from hapnet.errors import InvalidParameter, TransportError
from hapnet.transport.config import Mode, ZenohSettings, free_address, local_address, zenoh_config
from hapnet.transport.zenoh import ZenohTransport
from hapnet.wire.messages import Role
from tests.conftest import mostly_slow
from tests.support.transports import WAIT_S, Side, assert_exchange, opened, paired, value

# Configuration


def test_defaults_suit_small_messages_at_1_khz() -> None:
    settings = ZenohSettings(connect=("tcp/127.0.0.1:17447",))
    assert value(settings, "mode") == "peer"
    assert value(settings, "listen/endpoints") == []
    assert value(settings, "connect/endpoints") == ["tcp/127.0.0.1:17447"]
    assert value(settings, "transport/link/tx/lease") == 2000
    assert value(settings, "transport/link/tx/queue/size/real_time") == 16
    assert value(settings, "scouting/multicast/enabled") is False
    assert value(settings, "scouting/gossip/enabled") is False
    assert value(settings, "transport/shared_memory/enabled") is False
    assert value(settings, "connect/exit_on_failure") is False


def test_flags_and_overrides_come_after_the_file_and_defaults_never_undo_it(tmp_path: Path) -> None:
    file = tmp_path / "z.json5"
    file.write_text('{mode:"router", listen:{endpoints:["tcp/127.0.0.1:7"]}, transport:{link:{tx:{lease:700}}}}')
    by_file = ZenohSettings(config=str(file))
    assert value(by_file, "mode") == "router"
    assert value(by_file, "listen/endpoints") == ["tcp/127.0.0.1:7"]
    assert value(by_file, "transport/link/tx/lease") == 700
    assert value(by_file, "transport/link/tx/queue/size/real_time") == 16
    flags = ZenohSettings(
        config=str(file), mode="peer", listen=("tcp/127.0.0.1:8",), cfg=("transport/link/tx/lease:900",)
    )
    assert value(flags, "mode") == "peer"
    assert value(flags, "listen/endpoints") == ["tcp/127.0.0.1:8"]
    assert value(flags, "transport/link/tx/lease") == 900


def test_a_peer_that_only_scouts_listens_on_a_free_port() -> None:
    settings = ZenohSettings(multicast_scouting=True)
    assert value(settings, "listen/endpoints") == ["tcp/127.0.0.1:0"]
    assert value(settings, "scouting/multicast/interface") == "127.0.0.1"
    strategy = zenoh_config(settings).get_json("scouting/multicast/autoconnect_strategy")
    assert '"to_peer":"greater-zid"' in strategy


def listening() -> set[str]:
    """The addresses and ports on which this process accepts connections, as Linux lists them: in hexadecimal."""
    own: set[str] = set()
    for entry in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # that of the directory itself
            own.add(os.readlink(entry))
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/self/net/{table}").read_text("ascii").splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and f"socket:[{fields[9]}]" in own:
                found.add(fields[1])
    return found


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
async def test_without_endpoints_two_sides_find_each_other_and_only_this_machine_reaches_them() -> None:
    alone, before = ZenohSettings(multicast_scouting=True), listening()
    world, device = (Side(role, alone, session=f"alone-{os.getpid()}") for role in ("world", "device"))
    async with opened(world, device):
        await paired(world, device)
        assert {place.partition(":")[0] for place in listening() - before} == {"0100007F"}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (ZenohSettings(connect=("garbage",)), "connect is 'garbage'; allowed: PROTOCOL/ADDRESS:PORT"),
        (ZenohSettings(connect=("tcp/127.0.0.1",)), "connect is 'tcp/127.0.0.1'"),
        (ZenohSettings(listen=("tcp/127.0.0.1:99999",)), "listen is 'tcp/127.0.0.1:99999'"),
        (ZenohSettings(listen=("foo/127.0.0.1:1",)), "listen is 'foo/127.0.0.1:1'"),
        (ZenohSettings(), "connect and listen are empty: give an endpoint to dial (-e) or to listen on (-l)"),
        (
            ZenohSettings(listen=("tcp/[::1]:1",), cfg=("nosuch/key:1",)),
            "cfg is 'nosuch/key:1'; allowed: KEY:JSON5 that",
        ),
        (ZenohSettings(listen=("tcp/[::1]:1",), cfg=("mode",)), "cfg is 'mode'; allowed: KEY:JSON5, such as"),
        (ZenohSettings(listen=("tcp/[::1]:1",), cfg=('mode:"boss"',)), "unknown variant `boss`"),
        (ZenohSettings(listen=("tcp/[::1]:1",), cfg=("mode:{",)), "cfg is 'mode:{'"),
    ],
)
def test_bad_settings_are_one_line_that_names_them(settings: ZenohSettings, message: str) -> None:
    with pytest.raises(InvalidParameter) as raised:
        zenoh_config(settings)
    line = str(raised.value)
    assert message in line
    assert "\n" not in line
    assert ".rs" not in line


def test_a_bad_mode_is_named() -> None:
    boss = cast(Mode, "boss")  # what a command line may hand over
    with pytest.raises(InvalidParameter, match="mode is 'boss'; allowed: one of peer, client, router"):
        zenoh_config(ZenohSettings(mode=boss))


@pytest.mark.parametrize("content", [None, "{mode:", '{mode:"peer", foo:1}'])
def test_a_bad_config_file_is_one_line_that_names_it(tmp_path: Path, content: str | None) -> None:
    file = tmp_path / "zenoh.json5"
    if content is not None:
        file.write_text(content)
    with pytest.raises(TransportError) as raised:
        zenoh_config(ZenohSettings(config=str(file)))
    line = str(raised.value)
    assert line.startswith(f"config file {str(file)!r} is not usable: ")
    assert "\n" not in line
    assert ".rs" not in line


@pytest.mark.parametrize("name", ["", "a/b", "a#", "?", "a$b", "*", "a b", "a\n"])
def test_names_that_no_key_can_contain_are_refused(name: str) -> None:
    settings = ZenohSettings(listen=("tcp/127.0.0.1:1",))
    with pytest.raises(InvalidParameter, match=r"^session is "):
        ZenohTransport(settings, lambda kind, data, now_ns: None, session=name)
    with pytest.raises(InvalidParameter, match=r"^device is "):
        ZenohTransport(settings, lambda kind, data, now_ns: None, device=name)


# Exchange


@pytest.mark.parametrize("listener", ["device", "world"])
async def test_all_kinds_both_ways_with_the_listener_first(listener: Role) -> None:
    endpoint = free_address()
    dialler: Role = "world" if listener == "device" else "device"
    first = Side(listener, ZenohSettings(listen=(endpoint,)))
    second = Side(dialler, ZenohSettings(connect=(endpoint,)))
    async with opened(first, second):
        await paired(first, second)
        assert (first.transport.peers, first.transport.partners) == (1, 1)
        assert first.transport.status == f"connected to the {dialler}"
        await assert_exchange(first, second)


async def test_a_dialler_waits_for_its_listener_and_says_so() -> None:
    endpoint = free_address()
    dialler = Side("device", ZenohSettings(connect=(endpoint,)))
    listener = Side("world", ZenohSettings(listen=(endpoint,)))
    async with opened(dialler):
        assert dialler.transport.status == f"dialling {endpoint}, no peer yet"
        assert dialler.transport.peers == 0
        async with opened(listener):
            await paired(dialler, listener)
            await assert_exchange(dialler, listener)
        await dialler.until_partners(0)
        again = Side("world", ZenohSettings(listen=(endpoint,)))
        async with opened(again):
            await paired(dialler, again)
            await assert_exchange(dialler, again)


async def test_a_session_that_is_lost_is_opened_again() -> None:
    """Zenoh closes a session by itself when it thinks it must; here somebody else does it."""
    endpoint = free_address()
    dialler = Side("device", ZenohSettings(connect=(endpoint,)))
    listener = Side("world", ZenohSettings(listen=(endpoint,)))
    async with opened(dialler, listener):
        for lost in (dialler, listener):
            await paired(dialler, listener)
            session = lost.transport._session
            await asyncio.to_thread(session.close)
            went = lost.transport.put("position", b"nowhere")
            assert not went or lost.transport.reopened  # another session may be open by now
            async with asyncio.timeout(10.0):
                while not lost.transport.reopened:
                    await asyncio.sleep(0.01)
            await paired(dialler, listener)
            await assert_exchange(dialler, listener)
            assert lost.transport.reopened == 1


async def test_a_client_waits_for_its_router_and_reaches_the_other_client() -> None:
    endpoint = free_address()
    device = Side("device", ZenohSettings(mode="client", connect=(endpoint,)))
    world = Side("world", ZenohSettings(mode="client", connect=(endpoint,)))
    router = Side("device", ZenohSettings(mode="router", listen=(endpoint,)), device="another")
    waiting = asyncio.create_task(device.transport.open())
    async with opened(router):
        await asyncio.wait_for(waiting, WAIT_S)
        async with opened(world):
            await paired(device, world)
            await assert_exchange(device, world)
        assert router.received.empty()
        await device.until_partners(0)
        assert device.transport.status.startswith(
            "connected to 1 Zenoh node, no world on hapnet/default/device/down yet"
        )
        assert await device.transport.close()


async def test_two_processes_of_one_machine_have_a_socket_of_their_own(tmp_path: Path) -> None:
    endpoint = local_address(str(tmp_path))
    assert endpoint == f"unixsock-stream/{tmp_path}/link"
    world, device = Side("world", ZenohSettings(listen=(endpoint,))), Side("device", ZenohSettings(connect=(endpoint,)))
    async with opened(world, device):
        await paired(world, device)
        await assert_exchange(device, world)


@pytest.mark.parametrize("directory", ["/tmp/" + 90 * "x", "/tmp/my files", "/tmp/what?"])
def test_a_directory_where_no_socket_can_be_made_is_not_used(directory: str) -> None:
    assert local_address(directory).startswith("tcp/127.0.0.1:")


async def test_other_names_are_not_partners_and_two_of_one_name_are_seen() -> None:
    endpoint = free_address()
    world = Side("world", ZenohSettings(listen=(endpoint,)), session="s", device="left")
    stranger = Side("device", ZenohSettings(connect=(endpoint,)), session="s", device="right")
    twins = [Side("device", ZenohSettings(connect=(endpoint,)), session="s", device="left") for _ in range(2)]
    async with opened(world, stranger, *twins):
        await world.until_partners(2)
        assert "2 devices answer" in world.transport.status
        assert world.transport.peers == 3
        stranger.transport.put("control", b"not for you")
        twins[0].transport.put("control", b"for you")
        assert await asyncio.wait_for(world.received.get(), WAIT_S) == ("control", b"for you")
        assert world.received.empty()
        assert stranger.transport.partners == 0


@pytest.mark.parametrize(("role", "other"), mostly_slow([("device", "world"), ("world", "device")], 1))
async def test_two_of_one_side_and_none_of_the_other_say_so(role: Role, other: Role) -> None:
    endpoint = free_address()
    first = Side(role, ZenohSettings(listen=(endpoint,)))
    second = Side(role, ZenohSettings(connect=(endpoint,)))
    async with opened(first, second), asyncio.timeout(WAIT_S):
        while not (first.transport.doubled and second.transport.doubled):
            await asyncio.sleep(0.01)
        for side in (first, second):
            said = side.transport.status
            assert said == f"connected to another {role} and to no {other}: one of the two must be a {other}"


# What goes wrong


@pytest.mark.parametrize(("rate_hz", "at_once"), [(10.0, 2_000), (1_000.0, 2_000), (10_000.0, 20_000), (1e9, 40_000)])
def test_a_flood_is_ten_times_and_a_burst_two_seconds_of_what_a_side_sends(rate_hz: float, at_once: int) -> None:
    """But of no less than 1 kHz, and of no more than 20 kHz."""
    settings = ZenohSettings(connect=("tcp/127.0.0.1:17447",))
    limiter = ZenohTransport(settings, lambda kind, data, now_ns: None, rate_hz=rate_hz).rate_limiter
    now_ns = 10**15
    assert sum(limiter.admit(now_ns) for _ in range(at_once + 1)) == at_once
    later_ns = now_ns + 10**8  # in a tenth of a second half of the burst is there again
    assert sum(limiter.admit(later_ns) for _ in range(at_once)) == at_once // 2


async def test_an_endpoint_in_use_is_one_line_that_names_it() -> None:
    endpoint = free_address()
    first, second = (Side("world", ZenohSettings(listen=(endpoint,))) for _ in range(2))
    async with opened(first):
        assert first.transport.status == f"listening on {endpoint}, no peer yet"
        with pytest.raises(TransportError, match="Address already in use") as raised:
            await second.transport.open()
        line = str(raised.value)
        assert endpoint in line
        assert "\n" not in line
        assert ".rs" not in line


async def test_puts_without_a_session_are_counted_not_raised() -> None:
    side = Side("device", ZenohSettings(listen=(free_address(),)))
    assert not side.transport.put("position", b"early")
    async with opened(side):
        assert side.transport.put("position", b"nobody listens")
        assert side.transport.failed_puts == 1
    assert not side.transport.put("energy", b"late")
    assert side.transport.failed_puts == 2
    assert side.transport.status == "closed"
    assert await side.transport.close()
    with pytest.raises(InvalidParameter, match="kind is 'velocity'; allowed: one of position, energy, control"):
        side.transport.put("velocity", b"")


async def test_an_exception_in_on_message_is_counted_and_the_next_message_comes() -> None:
    warnings: list[str] = []
    endpoint = free_address()
    loop, third = asyncio.get_running_loop(), asyncio.Event()

    def on_message(kind: str, data: bytes, now_ns: int) -> None:
        if data == b"3":
            loop.call_soon_threadsafe(third.set)
        else:
            raise ValueError(data)

    fragile = ZenohTransport(ZenohSettings(listen=(endpoint,)), on_message, role="world", warn=warnings.append)
    sender = Side("device", ZenohSettings(connect=(endpoint,)))
    await fragile.open()
    async with opened(sender):
        await paired(sender)
        for data in (b"1", b"2", b"3"):
            sender.transport.put("control", data)
        await asyncio.wait_for(third.wait(), WAIT_S)
    assert await fragile.close()
    assert fragile.callback_errors == 2
    [warning] = warnings
    assert warning.startswith("on_message failed for a control message")
    assert warning.endswith("ValueError: b'1'")


async def test_a_cancelled_open_leaves_nothing_behind() -> None:
    side = Side("device", ZenohSettings(mode="client", connect=(free_address(),)))
    opening = asyncio.create_task(side.transport.open())
    await asyncio.sleep(0)
    opening.cancel()
    with pytest.raises(asyncio.CancelledError):
        await opening
    assert side.transport.status == "closed"


@pytest.mark.parametrize("end", ["return", "raise SystemExit(0)"])
def test_the_interpreter_exits_without_close_and_quietly(end: str) -> None:
    program = f"""
        import asyncio
        from hapnet.transport.config import ZenohSettings
        from hapnet.transport.zenoh import ZenohTransport
        async def main():
            got = asyncio.Event()
            loop = asyncio.get_running_loop()
            endpoint = {free_address()!r}
            world = ZenohTransport(
                ZenohSettings(listen=(endpoint,)), lambda *came: loop.call_soon_threadsafe(got.set), role="world"
            )
            device = ZenohTransport(ZenohSettings(connect=(endpoint,)), lambda kind, data, now_ns: None)
            await world.open()
            await device.open()
            while not device.partners:
                await asyncio.sleep(0.01)
            device.put("position", b"x")
            await got.wait()
            {end}
        asyncio.run(main())
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, timeout=WAIT_S, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
