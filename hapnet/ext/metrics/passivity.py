"""Metrics of the energy that came out of the ports, and of whether the coupling kept its claim to be passive."""

from __future__ import annotations

from hapnet.couplings import registry
from hapnet.ext.metrics.measured import Measured, metric
from hapnet.recording.samples import Columns
from hapnet.summary.verdict import broken


@metric("two-port margin", "J", "higher", over="extreme over every tick and step")
def margin_J(run: Measured) -> float | None:
    """Least value over time of d² plus the energy that hand and virtual world have put in at their ports. d² is the
    energy at the start with PSPM's reservoirs; every coupling is measured with the same d², although others start
    without energy. Below 0: not passive."""
    return _bound_J(run) + run.result.hand.lowest


@metric("energy out", "J", "lower", over="extreme over every tick and step")
def energy_out_J(run: Measured) -> float | None:
    """Greatest energy over time that has come out of both ports together beyond what has gone in: d² less the two-port
    margin. It is 0 for a passive coupling that starts with no energy."""
    return max(0.0, -run.result.hand.lowest)


@metric("margin at the end", "J", "higher", over="the whole run")
def margin_end_J(run: Measured) -> float | None:
    """d² plus the energy put in at both ports in the whole run."""
    return _bound_J(run) + run.result.hand.now


@metric("margin after 1 s", "J", "higher", over="extreme over every tick and step after 1 s")
def margin_later_J(run: Measured) -> float | None:
    """Least value of the two-port margin from one second after the start on; at the start it is always d²."""
    later = run.result.hand.later
    return None if later is None else _bound_J(run) + later


@metric("hand's margin", "J", "higher", over="extreme over every tick")
def hand_margin_J(run: Measured) -> float | None:
    """Least value over time of the hand's work plus the energy that the device's side starts with. Below 0: the hand
    got more energy than that."""
    bound = run.sides[0]["ledger"]["bound_J"]
    assert bound is not None
    return bound + run.result.hand.device_lowest


@metric("energy out at the hand", "J", "lower", over="extreme over every tick")
def hand_energy_out_J(run: Measured) -> float | None:
    """Greatest energy over time that came out at the hand's port alone. A hand that a passive spring pushes back gets
    only energy that it has put in before."""
    return max(0.0, -run.result.hand.device_lowest)


@metric("energy out at the world", "J", "lower", over="extreme over the recorded steps")
def world_energy_out_J(run: Measured) -> float | None:
    """Greatest energy over time that came out at the virtual world's port alone, into the damping of its walls and
    bodies. If both ports together gave out more than d² and the hand's port gave out nothing, the energy went this
    way."""
    bound = run.sides[1]["ledger"]["bound_J"]
    return None if run.world is None or bound is None else energy_out(run.world, bound)


@metric("two-port margin at the actuator", "J", "higher", over="extreme over every tick and step")
def actuator_margin_J(run: Measured) -> float | None:
    """As the two-port margin, but at the actuator's port instead of the device's, so without the device's own damping.
    Sampled servos only."""
    return run.summary["theorem"]["margin_J"] if run.params.device.servo == "sampled" else None


@metric("claim kept", "", "higher", over="the whole run")
def claim_kept(run: Measured) -> float | None:
    """0: the coupling claims to be passive on this link, and was not. 1: it was, or it makes no claim here."""
    spec = registry.coupling(run.params.coupling)
    return float(not broken(run.summary, run.params, virtual=True, spec=spec))


@metric("slack", "J", "higher", over="extreme over every tick and step")
def slack_J(run: Measured) -> float | None:
    """Minimum over time of the slack in either side's half of the theorem, for a coupling with energy reservoirs.
    Below 0 by more than rounding: the accounts are wrong."""
    slacks = [side["ledger"]["slack_J"] for side in run.sides]
    if any(side["reservoir_min_J"] is None for side in run.sides):
        return None
    return min(slack for slack in slacks if slack is not None)


@metric("world's reservoir, min", "J", "higher", over="extreme over every step")
def world_reservoir_min_J(run: Measured) -> float | None:
    """Minimum content of the reservoir at the world's side."""
    return run.sides[1]["reservoir_min_J"]


@metric("device's reservoir, min", "J", "higher", over="extreme over every tick")
def device_reservoir_min_J(run: Measured) -> float | None:
    """Minimum content of the reservoir at the device's side."""
    return run.sides[0]["reservoir_min_J"]


def energy_out(world: Columns, bound_J: float) -> float:
    """The most energy over time that came out at the world's port [J], 0 at least.

    The port's work is the side's account without the shuffled energy. `bound_J` : the side's share of d^2.
    """
    work = world["margin_J"] - bound_J - world["credited_J"] + world["sent_J"]
    return max(0.0, -float(work.min()))


def _bound_J(run: Measured) -> float:
    bound = run.summary["theorem"]["bound_J"]
    assert bound is not None
    return bound
