"""The summary of recordings: what the processes reported at their end; if they were killed, what the samples show."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from hapnet.couplings.registry import jointly_passive
from hapnet.errors import RecordingError
from hapnet.recording.samples import Columns, Recording, join
from hapnet.summary.run import combine, judged, merge, recorded_margins, unknown_device
from hapnet.summary.structure import EnvironmentPart, Ledger, Outages, SidePart, Summary, unknown
from hapnet.summary.verdict import has_reservoirs
from netem import LinkStats


def from_recording(recording: Recording) -> Summary:
    """The summary of a recording whose writer was killed: what its samples show, at their rate; None for the rest."""
    meta = recording.meta
    coupling = meta.get("coupling", "pspm")
    device = None if recording.device is None else _device_columns(recording.device, coupling)
    world = None if recording.world is None else _world_columns(recording.world, coupling)
    ends = [columns["time_s"][-1] for columns in (recording.device, recording.world) if columns is not None]
    asked = meta.get("links")
    asked = asked if isinstance(asked, Mapping) else {}
    tuning = meta.get("tuning")
    unknown = dict.fromkeys(field.name for field in fields(LinkStats))
    links = {way: {**unknown, "profile": asked[way]} if way in asked else None for way in ("up", "down")}
    return combine(
        device,
        world,
        links,
        seed=meta.get("seed"),
        duration_s=float(max(ends)) if ends else None,
        coupling=coupling,
        tuning=tuning if isinstance(tuning, Mapping) else None,
        torn=[side for side in ("device", "world") if getattr(recording, side) is not None],
        **recorded_margins(recording),
    )


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


def _side_columns(columns: Columns, coupling_name: str) -> SidePart:
    """The keys that both sides share."""
    slack = None if jointly_passive(coupling_name) else _extreme(columns["slack_J"], np.min)
    return {
        "ledger": unknown(Ledger)
        | {
            "margin_J": _extreme(columns["margin_J"], np.min),
            "slack_J": slack,
            "margin_end_J": _extreme(columns["margin_J"], lambda values: values[-1]),
        },
        "reservoir_min_J": _extreme(columns["reservoir_J"], np.min) if has_reservoirs(coupling_name) else None,
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
        "outages": unknown(Outages),
        "received": None,
        "missing": None,
        "dropped": None,
    }


def _extreme(values: NDArray[np.float64], pick: Callable[[NDArray[np.float64]], float]) -> float | None:
    """What `pick` finds among the known values; None if there are none."""
    known = values[np.isfinite(values)]
    return float(pick(known)) if len(known) else None


def _nanojoules(energy_J: float) -> int | None:
    return round(float(energy_J) * 1e9) if np.isfinite(energy_J) else None


def of_recordings(files: Sequence[Path], recordings: Sequence[Recording]) -> Summary:
    """The summary of a run from its one or two recordings: what the processes reported at their end, or the samples.

    Raises
    ------
    RecordingError : the summary in a file is not one.
    """
    parts = [cast(Summary, recording.summary) or from_recording(recording) for recording in recordings]
    for file, part in zip(files, parts, strict=True):
        if not isinstance(part, dict):
            raise RecordingError(f"{file} is not a recording: its summary does not fit")
    if len(parts) == 1:
        return judged(parts[0])
    try:
        device, world = sorted(parts, key=lambda part: part["device"] is None)
        return merge(device, world, recording=join(*recordings))
    except (KeyError, TypeError) as error:
        raise RecordingError(f"these are not recordings that fit each other: their summaries lack {error}") from None


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
