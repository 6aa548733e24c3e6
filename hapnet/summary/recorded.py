"""The summary of recordings: as the processes wrote it at their end, or from the samples if they were killed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from hapnet.couplings.registry import jointly_passive
from hapnet.errors import RecordingError
from hapnet.recording.samples import Columns, Recording, join
from hapnet.summary.former import FormerPart
from hapnet.summary.from_samples import START_S
from hapnet.summary.run import combine, has_account, judged, merge, recorded_margins, unknown_device
from hapnet.summary.structure import (
    SIDES,
    Contradictions,
    EnvironmentPart,
    LedgerSummary,
    OutagesSummary,
    PeerPart,
    SidePart,
    Summary,
    unknown,
)
from hapnet.summary.verdict import has_reservoirs
from hapnet.units import METRES, text_in
from hapnet.wire.messages import Role
from netem import LinkStats

MODULATED_M = 1e-9
"""Set-positions that differ by more count as modulated [m]."""


def from_recording(recording: Recording) -> Summary:
    """The summary of a recording whose writer was killed, from its samples, at their rate; other values are None."""
    meta = recording.meta
    coupling = meta.get("coupling", "pspm")
    device = None if recording.device is None else _device_columns(recording.device, coupling)
    world = None if recording.world is None else _world_columns(recording.world, coupling)
    ends = [columns["time_s"][-1] for columns in (recording.device, recording.world) if columns is not None]
    profiles = meta.get("links")
    profiles = profiles if isinstance(profiles, Mapping) else {}
    tuning, felt = meta.get("tuning"), meta.get("felt")
    unknown = dict.fromkeys(field.name for field in fields(LinkStats))
    links = {
        direction: {**unknown, "profile": profiles[direction]} if direction in profiles else None
        for direction in ("up", "down")
    }
    return combine(
        device,
        world,
        links,
        seed=meta.get("seed"),
        duration_s=float(max(ends)) if ends else None,
        coupling=coupling,
        units=_units(recording),
        tuning=tuning if isinstance(tuning, Mapping) else None,
        felt=felt if isinstance(felt, Mapping) else None,
        torn=[side for side in ("device", "world") if getattr(recording, side) is not None],
        **recorded_margins(recording),
    )


def _units(recording: Recording) -> str:
    columns = recording.device or recording.world
    return text_in(recording.meta, columns["position_m"].shape[1]) if columns else METRES


def _device_columns(columns: Columns, coupling_name: str) -> SidePart:
    result = _side_columns(columns, coupling_name)
    if has_reservoirs(coupling_name):
        result["deficit_max_J"] = _extreme(columns["deficit_J"], np.max)
    return {**unknown_device(), **result}


def _world_columns(columns: Columns, coupling_name: str) -> SidePart:
    result, steps = _side_columns(columns, coupling_name), columns["step_s"]  # one sample a step
    result["step"] = {"count": len(steps), "mean_s": _finite(steps.mean()), "max_s": _finite(steps.max())}
    result["environment"] = unknown(EnvironmentPart)
    return result


def _modulated(columns: Columns) -> float | None:
    """The share of the samples whose set-position differs from the wanted one."""
    away = np.linalg.norm(columns["set_position_m"] - columns["target_m"], axis=1) > MODULATED_M
    return float(np.mean(away)) if len(away) else None


def _side_columns(columns: Columns, coupling_name: str) -> SidePart:
    """The keys that both sides share."""
    slack = None if jointly_passive(coupling_name) else _extreme(columns["slack_J"], np.min)
    later = columns["time_s"] >= columns["time_s"][0] + START_S
    return {
        "ledger": unknown(LedgerSummary)
        | {
            "margin_J": _extreme(columns["margin_J"], np.min),
            "slack_J": slack,
            "margin_end_J": _extreme(columns["margin_J"], lambda values: values[-1]),
            "margin_later_J": _extreme(columns["margin_J"][later], np.min),
            "sent_J": _extreme(columns["sent_J"], lambda values: values[-1]),
        },
        "reservoir_min_J": _extreme(columns["reservoir_J"], np.min) if has_reservoirs(coupling_name) else None,
        "modulated_share": _modulated(columns) if has_reservoirs(coupling_name) else None,
        "deficit_max_J": None,
        "sent_nJ": _nanojoules(columns["sent_J"][-1]),
        "credited_nJ": _nanojoules(columns["credited_J"][-1]),
        "acked_nJ": None,
        "unanswered_s": None,
        "in_flight_nJ": None,
        "discarded_nJ": None,
        "abandoned_nJ": None,
        "incarnations": None,
        "peers_J": None,
        "former": unknown(FormerPart),
        "outages": unknown(OutagesSummary),
        "received": None,
        "missing": None,
        "dropped": None,
        "contradictions": unknown(Contradictions),
        "peer": unknown(PeerPart),
    }


def _extreme(values: NDArray[np.float64], pick: Callable[[NDArray[np.float64]], float]) -> float | None:
    """Return the result of `pick` among the known values; None if there are none."""
    known = values[np.isfinite(values)]
    return float(pick(known)) if len(known) else None


def _nanojoules(energy_J: float) -> int | None:
    return round(float(energy_J) * 1e9) if np.isfinite(energy_J) else None


def of_recordings(files: Sequence[Path], recordings: Sequence[Recording]) -> Summary:
    """The summary of a run from its one or two recordings: as the processes wrote it at their end, or from the samples.

    Raises RecordingError: the summary in a file is not a summary.
    """
    for file, recording in zip(files, recordings, strict=True):
        if not isinstance(recording.summary, dict | None):
            raise RecordingError(f"{file} is not a recording: its summary does not fit")
    if len(recordings) == 1:
        return judged(_own(recordings[0]))
    device, world = sorted(recordings, key=lambda one: one.device is None)
    try:
        return merge(_own(device), _own(world), recording=join(device, world))
    except (KeyError, TypeError) as error:
        raise RecordingError(f"these are not recordings that fit each other: their summaries lack {error}") from None


def of_parts(
    reported: Mapping[str, Summary],
    recordings: Mapping[str, Recording],
    whole: Recording | None,
    failed: Mapping[str, str],
    *,
    coupling: str,
    seed: int,
    margins: Mapping[str, Any] | None = None,
) -> Summary:
    """The summary of a run on this machine, even if its processes failed.

    reported : by role, the summary that a process left at its end. recordings : by role; they are used for a side whose
    process, or whose servo's process, left no summary. whole : both recordings, or the only one. failed : by role, the
    reason why a side ended early. coupling, seed : of the run. margins : of both ports together, as `combine` takes
    them; None: those of the recording.
    """
    parts: dict[Role, Summary] = {}
    for role in SIDES:
        left, recording = reported.get(role), recordings.get(role)
        found = left if recording is None or (left is not None and has_account(left[role])) else _own(recording)
        if found is not None:
            parts[role] = found
            if (side := found[role]) is not None and role in failed:
                side["failed"] = failed[role]
    if len(parts) == 2:
        both = whole is not None and whole.device is not None and whole.world is not None
        recording = whole if both else None
        return merge(parts["device"], parts["world"], seed=seed, recording=recording, margins=margins)
    for part in parts.values():
        for role in SIDES:  # the other's half, as it reported it to this side
            if (side := part[role]) is not None and role in failed:
                side["failed"] = failed[role]
        return judged(part)
    return combine(None, None, {"up": None, "down": None}, seed=seed, duration_s=None, coupling=coupling)


def _own(recording: Recording) -> Summary:
    """Return the summary of the process that wrote the recording, or figures from the samples if it was killed."""
    return cast(Summary, recording.summary) if recording.summary else from_recording(recording)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
