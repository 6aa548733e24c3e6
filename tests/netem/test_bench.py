"""The benchmarks measure what they say, here shortly; in full, the figures they are for."""

import pytest

from netem import bench
from netem.cli import main


def test_lateness_is_positive_and_reported() -> None:
    found = bench.lateness(runs=1, seconds=0.1)
    for p50, p99 in (found.link, found.bare, found.thread):
        assert 0 < p50 <= p99
    assert found.ratios == (found.link[0] / found.bare[0], found.link[1] / found.bare[1])
    assert "link over bare" in found.lines()[-1]


def test_core_keeps_two_thousand_in_flight() -> None:
    found = bench.core(runs=1, messages=2000)
    assert found.in_flight == pytest.approx(2000, rel=0.2)
    assert found.heap > found.link > 0


def test_udp_counts_every_datagram() -> None:
    found = bench.udp(rate=1000, seconds=0.3)
    assert found.offered == found.arrived == (300, 300)
    assert found.missing == found.end_drops == found.relay.dropped == found.relay.socket_drops == 0
    assert found.relay.up.offered == found.relay.down.offered == 301  # one each to say hello


def test_the_command_writes_what_it_was_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "lateness", "--runs", "1", "--seconds", "0.1", "--json", "-"]) == 0
    assert '"lateness"' in capsys.readouterr().out


@pytest.mark.slow
def test_the_relay_forwards_twenty_thousand_a_second_each_way() -> None:
    found = bench.udp(rate=20_000, seconds=10.0)
    assert found.offered == (200_000, 200_000)
    assert found.relay.dropped == found.relay.socket_drops == 0
    assert found.missing == found.end_drops


@pytest.mark.slow
def test_a_link_with_every_effect_costs_a_few_times_the_heap_it_stands_on() -> None:
    """A ratio: how many messages that is a second depends on the machine (650,000 on one, 500,000 on another)."""
    found = bench.core()
    assert found.link >= found.heap / 5
