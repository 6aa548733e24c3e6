"""What the page says in words when something is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from hapnet.ext.page.history import Snapshot, Track
from hapnet.ext.page.numbers import SHOWN_S, Troubles
from hapnet.recording.samples import Event
from hapnet.recording.telemetry import Status

TIMES = np.linspace(-1.0, 0.0, 101)


def track(reservoir_mJ: float, empty_from_s: float = 1.0) -> Track:
    """A second at rest, with an empty reservoir from then on."""
    none = np.zeros((101, 1))
    reservoir = np.where(empty_from_s <= TIMES, 0.0, 1e-3 * reservoir_mJ)
    return Track(TIMES, none, none, none, np.zeros((101, 4, 1)), none[:, 0], reservoir, reservoir)


def snapshot(device: Track | None, world: Track | None, coupling: str = "pspm", *events: Event) -> Snapshot:
    status = Status("device", 0, 1, True, False, "", {"coupling": coupling}, {}, {})
    return Snapshot(device, world, status, None, True, events, 0)


def test_where_all_is_well_nothing_is_said() -> None:
    assert Troubles().now(snapshot(track(50.0), track(50.0)), 0.0) == []
    assert Troubles().now(snapshot(None, None), 0.0) == []


def test_a_servo_that_was_away_is_told_for_a_while() -> None:
    away = Event(7, "overrun", "the servo stalled for 24.0 ms (machine too busy): no force until it is on time again")
    reported = snapshot(
        track(50.0), track(50.0), "pspm", Event(1, "overrun", "earlier"), away, Event(9, "link", "better")
    )
    troubles = Troubles()
    line = "the servo stalled for 24.0 ms (machine too busy): no force until it is on time again"
    assert troubles.now(reported, 10.0) == [line]
    assert troubles.now(reported, 9.9 + SHOWN_S) == [line]
    assert troubles.now(reported, 10.1 + SHOWN_S) == []
    again = replace(
        reported,
        events=(
            *reported.events,
            Event(
                11, "overrun", "the servo stalled for 30.0 ms (machine too busy): no force until it is on time again"
            ),
        ),
    )
    assert len(troubles.now(again, 20.0)) == 1


@pytest.mark.parametrize(("empty_from_s", "says"), [(-0.2, False), (-0.5, True)])
def test_a_reservoir_is_empty_when_it_stays_so(empty_from_s: float, says: bool) -> None:
    found = Troubles().now(snapshot(track(50.0), track(50.0, empty_from_s)), 0.0)
    assert found == ["the world's reservoir is empty: the proxy cannot follow the hand"] * says


def test_a_coupling_without_reservoirs_has_none_that_are_empty() -> None:
    assert Troubles().now(snapshot(track(0.0), track(0.0), "zoh"), 0.0) == []
