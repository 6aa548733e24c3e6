"""Replays a recorded run in virtual time, with its parameters and its hand, and compares the two runs."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from hapnet.assembly.operators import ALLOWED
from hapnet.couplings.registry import coupling, jointly_passive
from hapnet.errors import HapnetError, InvalidParameter, RecordingError
from hapnet.loading import load
from hapnet.param_sources import RECORDING
from hapnet.param_values import flatten
from hapnet.params import Params, arm_file, is_arm, is_simulated
from hapnet.recording.hand import begins_late, fingerprint, hand_times, knows_hand, left_out, replay_ns
from hapnet.recording.link_events import KIND, played
from hapnet.recording.mcap import read_recording
from hapnet.recording.missing import all_missing
from hapnet.recording.opened import fitting
from hapnet.recording.samples import Columns, Recording, join, on_device_clock
from hapnet.summary.from_samples import motion
from hapnet.summary.recorded import of_recordings
from hapnet.summary.run import Summary
from hapnet.summary.structure import SIDES
from netem import Timeline

_WORLDS = ("scene", "world.", "link.down")
"""Prefixes of the parameters that belong to the world; all others belong to the device."""

_MADE = re.compile(r"rest|sine|press|(hand|strokes|writing)-\d+")


@dataclass(frozen=True)
class Original:
    """A recorded run, ready to be replayed.

    params, seed : of the replay. hand : a description of the replay's hand.
    recording : of both sides, as far as there are files. summary : of the original.
    in_virtual_time : True if the original was simulated, so that the replay is exact.
    notes : one line for each difference between the replay and the original. incomplete : one line for each file of
    which a part is missing.
    """

    files: tuple[Path, ...]
    recording: Recording
    summary: Summary
    params: Params
    seed: int
    hand: str
    in_virtual_time: bool
    notes: tuple[str, ...]
    incomplete: tuple[str, ...] = ()


def read_original(files: Sequence[Path]) -> Original:
    """Read a run from one recording, or from the device's and the world's.

    The device's settings, hand and link come from the device's recording; the scene, the world's settings and its link
    come from the world's. With one recording everything comes from it.

    Raises RecordingError: a file cannot be read, or the two do not belong together. InvalidParameter: the files contain
    no run that could be replayed.
    """
    if not 1 <= len(files) <= 2:
        raise InvalidParameter("FILE", [str(file) for file in files], "one recording, or the device's and the world's")
    with fitting(" and ".join(map(str, files))):
        return _original(files)


def _original(files: Sequence[Path]) -> Original:
    parts = [read_recording(file) for file in files]
    recording = parts[0] if len(parts) == 1 else join(*parts)
    if recording.device is None:
        raise InvalidParameter("FILE", str(files[0]), "a recording with the device's side: the world's has no hand")
    if isinstance(recording.meta.get("graph"), Mapping):
        allowed = "a recording of a world with one hand: `hapnet simulate --graph` repeats this run with the same seed"
        raise InvalidParameter("FILE", str(files[0]), allowed)
    at = next(i for i, part in enumerate(parts) if part.device is not None)
    device = parts[at]
    world = parts[1 - at] if len(parts) == 2 else device
    simulated = device.meta.get("clock") == "virtual"
    known = set(Params().flat())
    own, worlds = _parameters(device), _parameters(world)
    chosen = {name: value for name, value in own.items() if name in known}
    chosen |= {name: value for name, value in worlds.items() if name in known and name.startswith(_WORLDS)}
    recorded, sources = dict(chosen), _sources(device, world)
    operator, hand = _hand(device, files[at], chosen)
    if operator != chosen.get("operator"):
        chosen["operator_model.end_hold_s"] = 0.0  # the recorded motion already contains its end
    notes = [*_notes(device, world, simulated, sorted({*own, *worlds} - known)), *_left_out(recording)]
    if not simulated:
        for direction, part in (("up", device), ("down", world)):
            if direction == "up" or part is not device:
                changes, about = _link(recording, part, direction, chosen)
                chosen |= changes
                notes += about
    if (then := device.meta.get("hardware_sha256")) is not None:
        file = arm_file(str(chosen.get("hardware")))
        if fingerprint(file) not in (then, None):
            notes.append(f"{file} has changed since: the replay has the arm that it describes now")
            chosen = {
                name: value for name, value in chosen.items() if name not in ("device.mass", "device.own_damping")
            }
    chosen |= {
        "operator": operator,
        "hardware": hardware if is_arm(hardware := str(chosen.get("hardware"))) else "simulated",
        "duration_s": _duration_s(recording, chosen.get("duration_s") if simulated else None),
    }
    if not simulated and chosen.get("device.servo") == "auto":
        chosen["device.servo"] = "sampled"
    if sources is not None:  # values that the replay changes have another source
        changed = {name for name, value in chosen.items() if value != recorded.get(name)}
        sources |= dict.fromkeys(changed, RECORDING)
    params, seed = Params.recorded(chosen, sources), device.meta.get("seed")
    if ":" not in params.coupling:  # a user's own coupling is loaded when it runs
        coupling(params.coupling)
    if not isinstance(seed, int) or seed < 0:
        raise InvalidParameter("seed of the recording", seed, "a whole number, 0 or above")
    try:
        summary = of_recordings(files, parts)
        summary["motion"] = motion(recording)
        key_figures(summary)
    except (KeyError, TypeError, AttributeError):
        raise RecordingError("this recording cannot be replayed: its summary does not fit") from None
    lacking = tuple(all_missing(files, parts))
    return Original(tuple(files), recording, summary, params, seed, hand, simulated, tuple(notes), lacking)


def compare(original: Original, replay: Recording, summary: Summary) -> dict[str, Any]:
    """Compare the replay with the original, as data: key figures of both, and the distance of the device's paths.

    The paths are compared at the original's samples, at the same time since control of the device started, as far as
    both go. `identical` : every value that both recorded is the same at each sample, to the last bit.
    """
    return {
        "of": [str(file) for file in original.files],
        "hand": original.hand,
        "in_virtual_time": original.in_virtual_time,
        **_difference(original.recording, replay),
        "identical": _identical(original.recording, replay),
        "original": key_figures(original.summary),
        "replay": key_figures(summary),
    }


def key_figures(summary: Summary) -> dict[str, float | int | None]:
    """The figures by which a run is judged."""
    sides = {
        f"{side}_margin_J": None if (part := summary[side]) is None else part["ledger"]["margin_J"] for side in SIDES
    }
    known = [margin for margin in sides.values() if margin is not None]
    # of two processes only the sum of their minimum margins is known, so it is used for both runs
    margin = sum(known) if len(known) == 2 else None
    theorem, moved = summary["theorem"], cast("dict[str, float | int | None]", summary["motion"])
    if jointly_passive(str(summary["coupling"])):
        margin = theorem["margin_J"]
    bound, end = theorem["bound_J"], theorem.get("margin_end_J")
    out = None if margin is None or bound is None else max(0.0, bound - margin)
    return {"energy_out_J": out, "margin_end_J": end, "margin_J": margin, **sides, **moved}


def _parameters(recording: Recording) -> dict[str, Any]:
    """All parameters of the recorded run, by dotted names."""
    tree = recording.meta.get("params")
    if not isinstance(tree, Mapping):
        raise RecordingError("this recording cannot be replayed: it does not contain the parameters of its run")
    return dict(flatten(tree))


def _sources(device: Recording, world: Recording) -> dict[str, object] | None:
    """The sources of the parameters; None: an older recording without sources."""
    own, worlds = device.meta.get("sources"), world.meta.get("sources")
    if not isinstance(own, Mapping) or not isinstance(worlds, Mapping):
        return None
    found = {name: source for name, source in own.items() if not str(name).startswith(_WORLDS)}
    return found | {name: source for name, source in worlds.items() if str(name).startswith(_WORLDS)}


def _notes(device: Recording, world: Recording, simulated: bool, unknown: list[str]) -> Iterator[str]:
    if not simulated:
        yield (
            "recorded in real time: the replay has the same hand, links and seed, but its servo and steps are exactly "
            "on time, so it is similar to the original, not identical"
        )
    for key in ("seed", "coupling"):
        if (ours := device.meta.get(key)) != (theirs := world.meta.get(key)):
            yield f"the world's {key} was {theirs}: a replay uses one for both sides, by default the device's, {ours}"
    if unknown:
        yield f"this version does not have these parameters and leaves them out: {', '.join(unknown)}"


def _left_out(recording: Recording) -> Iterator[str]:
    cuts = left_out(recording)
    if begins_late(recording):
        begin_ns, end_ns = cuts.pop(0)
        yield (
            f"the recording begins {(end_ns - begin_ns) / 1e9:.1f} s after its session: the replay begins there, at "
            "rest and with initial reservoirs"
        )
    if cuts:
        lasted_s = sum(end - begin for begin, end in cuts) / 1e9
        yield f"the replay leaves out pauses: {len(cuts)}, {lasted_s:.1f} s in all"


def _link(
    whole: Recording, part: Recording, direction: str, chosen: Mapping[str, Any]
) -> tuple[dict[str, object], list[str]]:
    """The link's parameters as its side recorded them, including changes during the run; and notes about them.

    `whole` is on the device's clock, `part` on its own.
    """
    words = (part.meta.get("links") or {}).get(direction, chosen.get(f"link.{direction}", ""))
    events = [event for event in part.events if event.kind == KIND]
    times = np.array([event.time_ns for event in events], dtype=np.int64)
    times = replay_ns(whole, times if part.device is not None else on_device_clock(whole.meta, times))
    start, entries, notes = played(words, zip(times.tolist(), (event.text for event in events), strict=True))
    if entries:
        often = "once" if len(entries) == 1 else f"{len(entries)} times"
        notes.append(f"the {direction}link was changed {often} during the run: the replay makes the same changes")
    changed: dict[str, object] = {f"link.{direction}": start}
    if events or begins_late(whole):  # else the run's own timeline, if any, made all changes
        changed[f"link.{direction}_timeline"] = str(Timeline(entries)) if entries else ""
    return changed, notes


def _hand(device: Recording, file: Path, chosen: Mapping[str, Any]) -> tuple[str, str]:
    """The operator that generates the hand again, or else follows its recorded motion; and a description of it."""
    operator, recorded = str(chosen.get("operator")), str(file.resolve())
    if not is_simulated(hardware := str(chosen.get("hardware", "simulated"))):
        why = f"the device was {hardware}"
    elif begins_late(device):
        why = "the recording begins in the middle of its session"
    elif _MADE.fullmatch(operator):
        return operator, f"{operator}, generated again from its parameters"
    else:
        now = fingerprint(operator)
        then = device.meta.get("operator_sha256", now)
        if now is not None and then == now:
            return operator, f"read again from {operator}"
        why = f"{operator} cannot be generated again" if then is None else f"{operator} has changed or is missing"
        if then is None:
            with suppress(HapnetError):
                load("operator", operator, ALLOWED)
                return operator, f"generated again by {operator}"
    if knows_hand(device):
        return recorded, f"its recorded motion, joined by cubic curves: {why}"
    return recorded, f"the device's recorded positions, joined by cubic curves: {why}, and its hand is unknown"


def _duration_s(recording: Recording, simulated_s: object) -> object:
    """Time from pairing to the end, or to where a recording is torn [s]. `simulated_s` : the simulated duration."""
    if simulated_s is not None and not recording.torn:
        return simulated_s
    sides = [side for side in (recording.device, recording.world) if side is not None]
    return max(float(replay_ns(recording, side["time_ns"][-1:])[0]) for side in sides) / 1e9


def _difference(original: Recording, replay: Recording) -> dict[str, float | None]:
    """Distance between the device's paths in the two runs [m]."""
    assert original.device is not None
    assert replay.device is not None
    result: dict[str, float | None] = dict.fromkeys(("max_position_difference_m", "rms_position_difference_m"))
    first, second = original.device["position_m"], replay.device["position_m"]
    at, times = hand_times(original), hand_times(replay)
    both = (at >= times[0]) & (at <= times[-1])
    if first.shape[1] == second.shape[1] and both.any():
        again = np.column_stack([np.interp(at[both], times, axis) for axis in second.T])
        apart = np.linalg.norm(again - first[both], axis=1)
        result["max_position_difference_m"] = float(apart.max())
        result["rms_position_difference_m"] = float(np.sqrt(np.mean(apart**2)))
    return result


def _identical(original: Recording, replay: Recording) -> bool:
    pairs = [(original.device, replay.device), (original.world, replay.world)]
    return all(first is None or (second is not None and _same(first, second)) for first, second in pairs)


def _same(first: Columns, second: Columns) -> bool:
    """Whether all values of two recordings of a side are the same, as far as both go."""
    both = min(len(first["time_ns"]), len(second["time_ns"]))
    known = [name for name, values in first.items() if not np.isnan(values).all()]
    return all(np.array_equal(first[name][:both], second[name][:both], equal_nan=True) for name in known)
