"""Several sides behind one router: a device finds the seat that no other device has."""

import asyncio

import pytest

from hapnet.errors import HapnetError
from hapnet.transport.config import ZenohSettings, free_address
from hapnet.transport.router import free_name, routed
from tests.support.transports import Side, opened, paired


async def test_a_device_takes_the_first_seat_that_has_no_device() -> None:
    address = free_address()
    dials = ZenohSettings(connect=(address,))
    with routed(ZenohSettings(listen=(address,))) as own:
        worlds = [Side("world", own, device=name) for name in ("alice", "bob")]
        device = Side("device", dials, device="alice")
        async with opened(*worlds):
            assert await _free(dials) == "alice"
            async with opened(device):
                await paired(device, worlds[0])
                assert await _free(dials) == "bob"


async def test_without_a_free_seat_that_is_said() -> None:
    address = free_address()
    dials = ZenohSettings(connect=(address,))
    with routed(ZenohSettings(listen=(address,))) as own:
        world, device = Side("world", own, device="alice"), Side("device", dials, device="alice")
        async with opened(world, device):
            await paired(world, device)
            with pytest.raises(
                HapnetError, match=r"no world with the --session default waits for a device; taken: alice$"
            ):
                await _free(dials, 1.0)
            with pytest.raises(HapnetError, match=r"no world with the --session other waits for a device$"):
                await _free(dials, 0.5, "other")


async def _free(settings: ZenohSettings, within_s: float = 20.0, session: str = "default") -> str:
    return await asyncio.to_thread(free_name, settings, session, within_s)
