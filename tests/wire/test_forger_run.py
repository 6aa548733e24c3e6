"""In real time: two processes over Zenoh, and a third party on the network that speaks in the name of one of them."""

import random
import re
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from hapnet.errors import BadMessage
from hapnet.transport.config import free_address
from hapnet.wire.messages import Account, Bye, Encrypted, Energy, Role, Signals, Welcome, decode, encode
from tests.conftest import mostly_slow
from tests.support.processes import HAPNET, Program, read_json

WITHOUT_KEYS = (
    "import sys, hapnet.wire.session as s; full = s.Handshake;"
    "s.Handshake = lambda identity, living, period_ns, secret: full(identity, living, period_ns);"
    "from hapnet.__main__ import main; sys.argv[0] = 'hapnet'; sys.exit(main())"
)
"""A side that offers no key, as other programs that speak the protocol do."""


Speech = Callable[[int, int, int], tuple[str, Any]]
"""What he says, from the incarnations of device and world and how often he has spoken: the key's end, and a message."""


class Forger:
    """He hears both, and speaks in their incarnations' names as soon as the two are paired."""

    def __init__(self, address: str, says: Speech) -> None:
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", f'["{address}"]')
        self.said: int = 0
        self._says = says
        self._names: dict[str, int] = {}
        self._paired = False
        self._session: Any = zenoh.open(config)
        self._hears = self._session.declare_subscriber("hapnet/default/device/*/*", zenoh.handlers.FifoChannel(1000))
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
                self._names[str(sample.key_expr).split("/")[3]] = message.incarnation
                self._paired |= isinstance(message, Account | Energy | Welcome | Encrypted)
            if self._paired and len(self._names) == 2:
                self.said += 1
                key, message = self._says(self._names["up"], self._names["down"], self.said)
                self._session.put(f"hapnet/default/device/{key}", encode(message))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._session.close()


def of_energy(more_nJ: int, style: str, towards: Role = "world") -> Speech:
    """In the name of the other side, of so much more energy each time."""

    def says(device: int, world: int, number: int) -> tuple[str, Energy]:
        total_nJ = more_nJ + 1000 * number
        more = {"sums": (number + 50, total_nJ, 0)} if style == "sums" else None
        key, sender, hearer = ("up", device, world) if towards == "world" else ("down", world, device)
        return f"{key}/energy", Energy(sender, hearer, total_nJ, 0, more)

    return says


def bye(device: int, world: int, number: int) -> tuple[str, Bye]:
    return "up/control", Bye(device, world, 0, "that was all")


def stop(device: int, world: int, number: int) -> tuple[str, Signals]:
    return "down/signals", Signals(world, device, 1000 + number, {"stop": "he said so"})


SECRETS = ("without keys", "with keys", "with a word")


@contextmanager
def two_sides(tmp_path: Path, *, secrets: str, seconds: float, seed: int) -> Iterator[tuple[str, Program, Program]]:
    """The address of the world, world and device; each writes its summary to `tmp_path`."""
    command = (sys.executable, "-c", WITHOUT_KEYS) if secrets == "without keys" else HAPNET
    (file := tmp_path / "word").write_text("correct horse", "utf-8")
    file.chmod(0o600)
    address, link = free_address("tcp"), ("--link", "delay 20ms 5ms loss 2%", "--seed", seed)
    with ExitStack() as stack:
        words: tuple[Any, ...] = ("--duration", seconds, *link, "--once", "--no-files")
        words += ("--secret-file", file) if secrets == "with a word" else ()
        world = stack.enter_context(
            Program("world", "-l", address, *words, "--json", tmp_path / "world.json", command=command)
        )
        device = stack.enter_context(
            Program("device", "-e", address, *words, "--json", tmp_path / "device.json", command=command)
        )
        yield address, world, device


def summaries(tmp_path: Path) -> dict[str, dict[str, Any]]:
    return {role: read_json(tmp_path / f"{role}.json") for role in ("device", "world")}


@pytest.mark.parametrize("runs", mostly_slow([1, 10], 0, 1))
@pytest.mark.parametrize(
    ("towards", "secrets"),
    mostly_slow(
        [
            ("world", SECRETS[0]),
            ("device", SECRETS[1]),
            ("world", SECRETS[2]),
            ("device", SECRETS[0]),
            ("world", SECRETS[1]),
            ("device", SECRETS[2]),
        ],
        0,
        3,
    ),
)
def test_a_forger_on_the_network(towards: Role, secrets: str, runs: int, tmp_path: Path) -> None:
    sender: Role = "device" if towards == "world" else "world"
    for k in range(runs):
        rng = random.Random(k)
        with two_sides(tmp_path, secrets=secrets, seconds=4.0, seed=k) as (address, world, device):
            world.until_line("waiting")
            says = of_energy(round(4e7 * 125 ** rng.random()), rng.choice(("bare", "sums")), towards)
            forger = Forger(address, says)
            try:
                codes = [side.end()[0] for side in (device, world)]
            finally:
                forger.close()
        reported = summaries(tmp_path)
        hears, names = reported[towards][towards], reported[sender][sender]
        assert forger.said > 50
        if secrets != "without keys":
            assert hears["dropped"]["forged"] > 20
            assert hears["credited_nJ"] <= names["sent_nJ"]
            assert any(hears["contradictions"].values()) == (secrets == "with keys")
            assert not any(names["contradictions"].values())
            assert set(codes) <= ({5} if secrets == "with keys" else {0})
        else:
            assert hears["credited_nJ"] > names["sent_nJ"]
            assert all(found["verdict"]["passive"] is not True for found in reported.values())
            assert names["contradictions"]["acknowledged"] > 0
            assert any(hears["contradictions"].values())
            assert set(codes) <= {4, 5}


@pytest.mark.parametrize(
    ("says", "codes", "secrets"),
    mostly_slow(
        [
            (bye, {2, 3}, SECRETS[0]),
            (stop, {3}, SECRETS[0]),
            (stop, {3}, SECRETS[1]),
            (bye, {2, 3}, SECRETS[2]),
            (bye, {2, 3}, SECRETS[1]),
            (stop, {3}, SECRETS[2]),
        ],
        0,
        4,
    ),
)
def test_a_goodbye_or_a_stop_that_is_forged(says: Speech, codes: set[int], secrets: str, tmp_path: Path) -> None:
    """Without keys he ends the pair, and neither side knows whether it was passive; or the device's force, and both say
    so. With a word that is dropped, and all is as without him; with a key alone the run is doubted. `codes` : without
    keys; the device's is 2 if it still hears that it was retired, before the world leaves."""
    seconds = 3.0
    with two_sides(tmp_path, secrets=secrets, seconds=seconds, seed=1) as (address, world, device):
        for side in (device, world):
            side.until_line("paired with")
        forger = Forger(address, says)
        try:
            ends = [side.end() for side in (device, world)]
        finally:
            forger.close()
    reported = summaries(tmp_path)
    verdicts = [reported[role]["verdict"] for role in ("device", "world")]
    kept = secrets != "without keys"
    assert {code for code, _, _ in ends} <= {"without keys": codes, "with keys": {0, 5}, "with a word": {0}}[secrets]
    if kept:
        receiver = "world" if says is bye else "device"
        assert reported[receiver][receiver]["dropped"]["forged"] > 50
        told = None if secrets == "with keys" else True
        assert all(verdict["passive"] is told for verdict in verdicts)
        assert all(end["duration_s"] > seconds for end in reported.values())
        assert reported["device"]["device"]["stopped"] is None
        assert reported["device"]["motion"]["peak_force_N"] > 1.0  # the hand is at the wall by then
    elif says is bye:
        assert [verdict["passive"] for verdict in verdicts] == [None, None]
        for verdict, other in zip(verdicts, ("world", "device"), strict=True):
            assert re.search(f"the {other}'s account is (not here|missing)", verdict["reason"])
        assert ends[1][0] == 3
        assert re.search("this incarnation was retired|the world's account is (not here|missing)", ends[0][2])
        assert "the device left: that was all" in ends[1][1]
    else:
        assert all("the device's force was stopped after" in err and "he said so" in err for _, _, err in ends)
        assert all(verdict["passive"] is True for verdict in verdicts)  # without force
        assert reported["device"]["device"]["stopped"]["why"] == "he said so"
