"""What is measured of a run in windows of time, and at the virtual world: the names are those of `METRICS`."""

from __future__ import annotations

from collections.abc import Mapping

from hapnet.metrics.contact import rendered_by_tenths
from hapnet.metrics.force import force_meanwhile, rms_difference
from hapnet.metrics.free_motion import following_error, free_windows
from hapnet.metrics.windows import Span, first_and_last
from hapnet.metrics.world import contact_force_error, energy_out, modulated_share, visits
from hapnet.recording.samples import Recording
from hapnet.study.run import Measures, Run


def felt_over_time(run: Run, local: Recording | None) -> Measures:
    """Free motion, drag, stiffness and true force error: of the whole run, and of its windows.

    local : the recording of the run to which the force is compared where the walls rub; None: they do not.
    """
    worst = _worst_stiffness(run)
    return {**_followed(run), **_dragged(run), **_true_error(run, local), "stiffness_worst_percent": worst}


def at_the_world(run: Run) -> Measures:
    """The contact's force and visits in the world, what is modulated, the reservoirs, and the energy that came out."""
    world, (device_part, world_part) = run.world, run.sides
    told: Mapping[str, object] = device_part
    share = told.get("modulated_share")
    bound_J, reservoir_J = world_part["ledger"]["bound_J"], world_part["reservoir_min_J"]
    return {
        "world_force_error_percent": contact_force_error(run.recording, run.proxy_force),
        "contacts_ratio": _contacts_ratio(run),
        "modulated_percent": None if world is None or reservoir_J is None else 100.0 * modulated_share(world),
        "modulated_device_percent": 100.0 * share if isinstance(share, float) else None,
        "world_reservoir_min_J": reservoir_J,
        "device_reservoir_min_J": device_part["reservoir_min_J"],
        "world_energy_out_J": None if world is None or bound_J is None else energy_out(world, bound_J),
    }


def _windows(run: Run) -> tuple[Span, Span] | tuple[None, None]:
    return first_and_last(run.params.duration_s, run.params.operator_hand.end_hold_s) or (None, None)


def _followed(run: Run) -> Measures:
    inside, (first, last) = run.inside, _windows(run)

    def error_mm(span: Span | None) -> float | None:
        if inside is None or span is None:
            return None
        error_m = following_error(run.recording, ~inside & span.holds(run.device["time_s"]))
        return None if error_m is None else 1e3 * error_m

    whole = Span(float("-inf"), float("inf"))
    return {"free_rms_mm": error_mm(whole), "free_first_mm": error_mm(first), "free_last_mm": error_mm(last)}


def _dragged(run: Run) -> Measures:
    world, (_, last) = run.world, _windows(run)
    found = None
    if run.delay_s is not None and world is not None and run.walls is not None:
        found = free_windows(run.recording, run.walls, run.delay_s + 2.0 * float(world["step_s"].max()))
    return {
        "drag_N": None if found is None else found.drag(),
        "drag_p95_N": None if found is None else found.greatest_drag(),
        "drag_last_N": None if found is None or last is None else found.during(last).drag(),
    }


def _true_error(run: Run, local: Recording | None) -> Measures:
    wanted = run.wanted if run.scalar else None
    if wanted is not None and local is not None:
        wanted = force_meanwhile(run.recording, local)
    _, last = _windows(run)
    whole_N = percent = last_percent = None
    if wanted is not None:
        whole_N, percent = rms_difference(run.device, wanted)
        if last is not None:
            _, last_percent = rms_difference(run.device, wanted, last.holds(run.device["time_s"]))
    return {
        "true_force_error_N": whole_N,
        "true_force_error_percent": percent,
        "true_force_error_last_percent": last_percent,
    }


def _worst_stiffness(run: Run) -> float | None:
    if run.wanted is None or not run.scalar or run.delay_s is None:
        return None
    shares = rendered_by_tenths(run.recording, run.wanted, run.delay_s, run.params.duration_s)
    return 100.0 * max(shares, key=lambda share: abs(share - 1.0)) if shares else None


def _contacts_ratio(run: Run) -> float | None:
    """Of a world whose proxy's penetration is not told this is None, as its walls are not known either."""
    if run.inside is None or run.world is None or not (by_hand := visits(run.inside)):
        return None
    return visits(run.world["penetration_m"] > 0.0) / by_hand
