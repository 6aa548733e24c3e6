"""In real time: two processes over Zenoh, and a third party on the network that speaks in the device's name."""

from __future__ import annotations

import random
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from hapnet.errors import BadMessage
from hapnet.transport.config import free_address
from hapnet.wire.messages import Energy, Welcome, decode, encode
from tests.processes import HAPNET, Program, read_json

WITHOUT_KEYS = (
    "import sys, hapnet.wire.session as s; full = s.Handshake;"
    "s.Handshake = lambda identity, living, period_ns, secret: full(identity, living, period_ns);"
    "from hapnet.__main__ import main; sys.argv[0] = 'hapnet'; sys.exit(main())"
)
"""A side that offers no key, as other programs that speak the protocol do."""


class Forger:
    """He hears the world, which names the device's incarnation, and tells of energy as soon as the two are paired."""

    def __init__(self, address: str, more_nJ: int, style: str) -> None:
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", f'["{address}"]')
        self.said: int = 0
        self._more_nJ, self._style = more_nJ, style
        self._parties: tuple[int, int] | None = None
        self._session: Any = zenoh.open(config)
        self._hears = self._session.declare_subscriber("hapnet/default/device/down/*", zenoh.handlers.FifoChannel(1000))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(0.02):
            while (sample := self._hears.try_recv()) is not None:
                try:
                    message = decode(sample.payload.to_bytes())
                except BadMessage:
                    continue
                if isinstance(message, Energy | Welcome):
                    self._parties = message.addressee, message.incarnation
            if self._parties is not None:
                self.said += 1
                total_nJ = self._more_nJ + 1000 * self.said
                more = {"sums": (self.said + 50, total_nJ, 0)} if self._style == "sums" else None
                self._session.put("hapnet/default/device/up/energy", encode(Energy(*self._parties, total_nJ, 0, more)))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._session.close()


@contextmanager
def two_sides(tmp_path: Path, *, keys: bool, seconds: float, seed: int) -> Iterator[tuple[str, Program, Program]]:
    """The address of the world, world and device; each writes its summary to `tmp_path`."""
    command = HAPNET if keys else (sys.executable, "-c", WITHOUT_KEYS)
    address, link = free_address("tcp"), ("--link", "delay 20ms 5ms loss 2%", "--seed", seed)
    with ExitStack() as stack:
        words = ("--duration", seconds, *link, "--once")
        world = stack.enter_context(
            Program("world", "-l", address, *words, "--json", tmp_path / "world.json", command=command)
        )
        device = stack.enter_context(
            Program("device", "-e", address, *words, "--json", tmp_path / "device.json", command=command)
        )
        yield address, world, device


def summaries(tmp_path: Path) -> dict[str, dict[str, Any]]:
    return {role: read_json(tmp_path / f"{role}.json") for role in ("device", "world")}


@pytest.mark.parametrize(
    "runs",
    [pytest.param(1, marks=pytest.mark.slow), pytest.param(10, marks=pytest.mark.soak)],
)
@pytest.mark.parametrize("keys", [False, True], ids=["without keys", "with keys"])
def test_a_forger_on_the_network(keys: bool, runs: int, tmp_path: Path) -> None:
    for k in range(runs):
        rng = random.Random(k)
        with two_sides(tmp_path, keys=keys, seconds=4.0, seed=k) as (address, world, device):
            world.until_line("waiting")
            forger = Forger(address, round(4e7 * 125 ** rng.random()), rng.choice(("bare", "sums")))
            try:
                codes = [side.end()[0] for side in (device, world)]
            finally:
                forger.close()
        told = summaries(tmp_path)
        assert forger.said > 50
        if keys:
            assert told["world"]["world"]["dropped"]["forged"] > 20
            assert told["world"]["world"]["credited_nJ"] <= told["device"]["device"]["sent_nJ"]
            assert not any(told["world"]["world"]["contradictions"].values())
            assert not any(told["device"]["device"]["contradictions"].values())
        else:
            assert told["world"]["world"]["credited_nJ"] > told["device"]["device"]["sent_nJ"]
            assert all(found["verdict"]["passive"] is not True for found in told.values())
            assert told["device"]["device"]["contradictions"]["acknowledged"] > 0
            assert any(told["world"]["world"]["contradictions"].values())
            assert set(codes) <= {4, 5}
