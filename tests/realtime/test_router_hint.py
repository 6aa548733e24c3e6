"""What a side says that is connected to a node, but not to the other side; with a router of Zenoh itself."""

from collections.abc import Iterator

import pytest
import zenoh

from hapnet.transport.config import free_address
from tests.support.processes import started


def router(address: str) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", f'["{address}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


@pytest.fixture
def address() -> Iterator[str]:
    """Where a router listens."""
    address = free_address()
    with router(address):
        yield address


@pytest.mark.slow
def test_two_peers_that_dial_a_router_are_told_to_be_clients(address: str) -> None:
    """Eclipse-zenoh/zenoh#372: peers behind a router do not meet."""
    line = "(that node is a router, through which only clients meet: start both sides with -m client"
    with (
        started("world", "-e", address, "--no-files") as world,
        started("device", "-e", address, "--no-files", "--duration", "1") as device,
    ):
        device.until_line(line)
        world.until_line(line)
        assert any("it has no seat of this --session and --name)" in text for text in device.out)
        assert not any("--session" in text for text in world.out)


def test_two_clients_of_a_router_pair(address: str) -> None:
    """What the line advises."""
    with (
        started("world", "-e", address, "-m", "client", "--no-files") as world,
        started("device", "-e", address, "-m", "client", "--no-files", "--duration", "1", "-v") as device,
    ):
        device.until_line("paired with the world")
        assert not any("router" in text for text in [*device.out, *world.out])


def test_a_client_whose_other_side_is_absent_is_told_what_that_needs(address: str) -> None:
    with started("device", "-e", address, "-m", "client", "--no-files") as device:
        device.until_line("(a world with -m client and the same --session and --name is not connected to that router")


@pytest.mark.slow
def test_a_side_that_is_connected_to_a_stranger_is_told_that_the_other_may_not_be_started() -> None:
    address = free_address()
    with (
        started("world", "-l", address, "--session", "monday", "--no-files"),
        started("device", "-e", address, "--session", "tuesday", "--no-files") as device,
    ):
        device.until_line("(the world is not started yet, its --session or --name differs, or access control keeps")
