from functools import partial
from typing import Any

import pytest

from hapnet.side.notices import Notice, notice_of
from hapnet.wire.events import (
    Contradiction,
    EnergyCredited,
    Event,
    Mismatch,
    Paired,
    PeerHeard,
    PeerLeft,
    PeerRefused,
    PeerSilent,
    PositionReceived,
    SignalReceived,
)
from hapnet.wire.messages import Identity

SECOND = 1_000_000_000
PEER = Identity(role="world", incarnation=5, name="there", dof=1, about={})


def about(value: float) -> Any:
    return pytest.approx(value)


def of(event: Event, on_silence: str = "hold") -> Notice | None:
    return notice_of(event, 7 * SECOND, "world", on_silence)


@pytest.mark.parametrize(
    ("event", "expected"),
    [
        (Paired(PEER, 1), Notice("paired", "paired with the world", 7 * SECOND, values={"pair": 1})),
        (Paired(PEER, 1, True), Notice("paired", "paired with the world, encrypted", 7 * SECOND, values={"pair": 1})),
        (
            Paired(PEER, 3),
            Notice("paired", "paired with the world (another process; pair 3)", 7 * SECOND, values={"pair": 3}),
        ),
        (PeerLeft("bye now"), Notice("left", "the world left: bye now", 7 * SECOND, values={"reason": "bye now"})),
        *(
            (
                event("2 axes, not 1"),
                Notice("refused", f"{says}: 2 axes, not 1", 7 * SECOND, "error", {"reason": "2 axes, not 1"}),
            )
            for event, says in (
                (Mismatch, "a world was refused"),
                (PeerRefused, "a world that is not this side's peer refuses this side"),
                (partial(PeerRefused, by_peer=True), "the world refuses this side"),
            )
        ),
        (
            PeerSilent(6_250_000_000),
            Notice(
                "silent",
                "no data from the world for 0.75 s; holding its last position",
                7 * SECOND,
                "warning",
                {"since_ns": 6_250_000_000, "silence_s": about(0.75)},
            ),
        ),
        (
            PeerHeard(2 * SECOND, 0, 0),
            Notice(
                "heard",
                "data from the world again after 2 s",
                7 * SECOND,
                values={"silence_s": about(2.0), "recovery_s": 0.0, "missing": 0},
            ),
        ),
        (
            PeerHeard(2 * SECOND, 30_000_000, 12),
            Notice(
                "heard",
                "data from the world again after 2 s, 30 ms after its first message; 12 positions are missing",
                7 * SECOND,
                values={"silence_s": about(2.0), "recovery_s": about(0.03), "missing": 12},
            ),
        ),
        (SignalReceived("button", True), Notice("signal", "button = true", 7 * SECOND)),
        (
            Contradiction("acked", "7 of 5 nJ"),
            Notice(
                "contradiction",
                "another sender uses the world's name (7 of 5 nJ): it is not known whether this run is passive",
                7 * SECOND,
                "error",
                {"kind": "acked"},
            ),
        ),
        (PositionReceived(3, 1, (0.0,)), None),
        (EnergyCredited(5), None),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_is_said_of_each_event(event: Event, expected: Notice | None) -> None:
    assert of(event) == expected


def test_what_a_side_does_in_silence_is_what_it_was_told_to_do() -> None:
    released = of(PeerSilent(6 * SECOND), "release")
    assert released.text == "no data from the world for 1 s; releasing the spring"
