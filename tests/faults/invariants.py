"""What holds whatever happens, read from the recordings and summaries that the sides left.

Expected values are the parameters' (3.3 N, 0.5 N a step, ...) as the recording's own settings name them.
"""

import math

import numpy as np

from hapnet.checks import Array
from hapnet.recording.samples import Columns, Recording
from tests.support.own_motion import beyond

ROUNDING_J = 1e-9
NANO = 1e-9


def lengths(vectors: Array) -> Array:
    """Of rows."""
    return np.asarray(np.sqrt((vectors**2).sum(axis=1)))


def assert_device_within_limits(recording: Recording, *, gaps: bool = False) -> None:
    """Force and its steps, at every tick of the recording.

    A tick that came too late lets the spring go at once, which is the one step that may be larger; it is then without
    force. So does one whose parent stands still. `gaps` : samples may be missing, so that what came after a while need
    not be the next tick.
    """
    columns, params = recording.device, recording.meta["params"]["device"]
    force_limit = params["force_limit_N"]
    assert lengths(columns["force_N"]).max() <= force_limit * (1.0 + 1e-15)
    watchdog_s = params["watchdog_s"] or math.inf
    late = np.diff(columns["time_ns"]) * NANO > watchdog_s + 1.0 / params["servo_hz"] + NANO / 2
    reported, withheld = (
        np.isin(columns["time_ns"][1:], [event.time_ns for event in recording.events if event.kind == kind])
        for kind in ("overrun", "parent")
    )
    steps = _steps(columns, math.ceil(params["pspm_period_s"] * params["servo_hz"] - 1e-6))
    assert steps[~late & ~withheld].max() * params["stiffness"] <= params["step_limit_N"] + 1e-9
    released = np.flatnonzero(late & reported if gaps else late) + 1
    assert (columns["set_position_m"][released] == columns["position_m"][released]).all()
    assert (columns["force_N"][released] == 0.0).all()
    assert gaps or late.any() == reported.any()


def assert_world_within_limits(recording: Recording) -> None:
    """Steps of the virtual coupling's set-position, at every step of the recording."""
    columns, params = recording.world, recording.meta["params"]["world"]
    assert _steps(columns, 1).max(initial=0.0) * params["stiffness"] <= params["step_limit_N"] + 1e-9


def _steps(columns: Columns, ticks: int) -> Array:
    """The steps of the set-position beyond the part that the own motion causes in the spring's force [m].

    ticks : between two updates of the set-position, or one more in real time: an update takes all motion since the
    last one.
    """
    chosen, place = columns["set_position_m"], columns["position_m"]
    found = []
    for back in range(1, ticks + 2):
        before = np.concatenate([np.repeat(place[:1], back, axis=0), place])[: len(place)]
        found.append([beyond(*one) for one in zip(chosen[1:], chosen[:-1], (place - before)[1:], strict=True)])
    return np.min(np.array(found), axis=0)


def assert_passive(columns: Columns, *, restarted: bool = False) -> None:
    """The half of the theorem at every sample of a side.

    `restarted` : it began with an empty reservoir, so its margin begins at 0, and what a held torque leaks before it is
    charged may show: K/2 dx^2 a tick, 0.1 mJ in the five ticks of an interval at 0.6 m/s.
    """
    assert columns["slack_J"].min() >= -ROUNDING_J
    assert columns["margin_J"].min() >= -1e-4 if restarted else columns["margin_J"].min() > 0.0
    assert columns["reservoir_J"].min() >= 0.0


def assert_credited_was_sent(receiver: Columns, sender: Columns, sender_torn: bool, since_ns: int = 0) -> None:
    """At every instant of a pair of incarnations, what one has credited is at most what the other has sent until then.

    What it had sent is bounded by its first sample after the receiver's next one: what it shuffles to a new peer leaves
    before its next step, and a tick whose thread has to wait may still credit what was sent after it began. The pair
    began at `since_ns`; before that each may have had other peers. What is compared ends with the sender's recording,
    if that was cut off.
    """
    base_credited = _at(receiver, "credited_J", np.array([since_ns]))
    base_sent = _at(sender, "sent_J", np.array([since_ns]))
    ends_ns = np.append(receiver["time_ns"][1:], np.iinfo(np.int64).max)
    compared = receiver["time_ns"] >= since_ns
    if sender_torn:
        compared &= ends_ns <= sender["time_ns"][-1]
    if compared.any():
        credited = receiver["credited_J"][compared] - base_credited
        after = np.minimum(np.searchsorted(sender["time_ns"], ends_ns[compared]), len(sender["time_ns"]) - 1)
        sent = sender["sent_J"][after] - base_sent
        assert (credited <= sent + 2 * NANO).all()


def _at(columns: Columns, name: str, times_ns: Array) -> Array:
    """The value of a running total at these times: that of the last sample before, 0 before the first."""
    at = np.searchsorted(columns["time_ns"], times_ns, side="right")
    return np.asarray(np.concatenate(([0.0], columns[name]))[at])


def assert_pair_kept_the_rules(device: Recording, world: Recording, *, gaps: bool = False) -> None:
    """All of the above of two sides that were one pair from beginning to end. `gaps` : in the device's samples."""
    assert_device_within_limits(device, gaps=gaps)
    assert_world_within_limits(world)
    a, b = columns_of(device), columns_of(world)
    assert_passive(a)
    assert_passive(b)
    assert_credited_was_sent(a, b, False)
    if not gaps:
        assert_credited_was_sent(b, a, False)


def overruns_in(recording: Recording, first_ns: int, last_ns: int) -> bool:
    return any(event.kind == "overrun" and first_ns <= event.time_ns <= last_ns for event in recording.events)


def columns_of(recording: Recording) -> Columns:
    """The samples of the one side that it is of."""
    columns = recording.device or recording.world
    assert columns is not None
    return columns
