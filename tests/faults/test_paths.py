"""What `path` says of a real network, held against irtt; and that a figure beyond a limit is named."""

import shutil
from typing import Any

import pytest

from tests.faults.namespaces import Unavailable
from tests.faults.paths import misses, one, row

LOSSY = "delay 40ms 10ms loss 15%"
FINE: dict[str, Any] = {
    "round trip": 80.0, "irtt's": 80.0, "sent up": 10_000, "sent down": 10_000, "lost": 28.0, "irtt's lost": 28.0,
    "age p99 up": 70.0, "age p99 down": 130.0, "silence": 200.0, "verdict": True,
}  # fmt: skip


@pytest.mark.parametrize(
    ("transport", "cells", "named"),
    [
        ("udp", {}, []),
        (
            "udp",
            {"lost": 32.9},
            [],
        ),  # chance: 3 x 1.33 points, of 1920 messages in each direction and 2800 packets in 36 s
        ("udp", {"lost": 33.1}, ["lost"]),
        ("udp", {"lost": 22.9}, ["lost"]),
        ("udp", {"round trip": 83.9}, []),
        ("udp", {"round trip": 84.1}, ["round trip"]),
        ("tcp", {"lost": 0.0, "round trip": 240.0}, []),
        ("tcp", {}, ["lost"]),
        ("quic mixed_rel", {"round trip": 100.0, "silence": 600.0}, []),
        ("quic", {"lost": 54.0, "silence": 1001.0, "verdict": False}, []),
        ("quic", {"lost": 54.0, "silence": 999.0}, ["lost"]),
        ("udp", {"lost": 54.0, "silence": 1001.0}, ["lost"]),
        ("udp --encrypt", {"silence": 501.0, "age p99 down": 195.0}, ["silent", "age p99 down"]),
        ("udp", {"verdict": None}, ["verdict"]),
    ],
)
def test_what_misses_a_limit_is_named(transport: str, cells: dict[str, Any], named: list[str]) -> None:
    found = misses(LOSSY, transport, FINE | cells, 36.0, FINE)
    assert len(found) == len(named)
    assert all(words.startswith(start) for words, start in zip(found, named, strict=True))


def test_a_clean_path_has_irtts_round_trip_over_every_transport() -> None:
    cells = FINE | {"lost": 0.0, "irtt's lost": 0.0}
    for transport in ("tcp", "udp", "quic", "quic mixed_rel"):
        assert not misses("delay 40ms", transport, cells, 36.0, {})
        [what] = misses("delay 40ms", transport, cells | {"round trip": 85.0}, 36.0, {})
        assert what.startswith("round trip 85.0 ms")


@pytest.mark.soak
@pytest.mark.parametrize("transport", ["udp", "udp --encrypt"])
def test_path_says_what_irtt_says(transport: str) -> None:
    if shutil.which("irtt") is None:
        pytest.skip("no such tool: irtt")
    profile, seconds = "delay 40ms 10ms loss 5%", 20.0
    try:
        cells = row(one(transport, profile, seconds, 1, []))
    except Unavailable as reason:
        pytest.skip(str(reason))
    assert misses(profile, transport, cells, seconds, {}) == []
