"""The settings of a recording: its parameters, and the commands that repeat the run."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hapnet.assembly.operators import LIVE
from hapnet.assembly.springs import without_rule
from hapnet.errors import InvalidParameter
from hapnet.param_sources import RESOLVED
from hapnet.param_values import flatten
from hapnet.params import Params, is_simulated
from hapnet.recording.samples import Recording
from hapnet.summary.structure import known, read
from hapnet.summary.words import get


class Setting(NamedTuple):
    """A parameter's value. `default` is empty if the value is the default, or if the parameter is unknown.

    source : the source of the value (`hapnet.param_sources`); empty if nothing set it, or if it is not recorded.
    """

    name: str
    value: str
    default: str
    meaning: str
    source: str = ""


class SuggestedCommand(NamedTuple):
    """A command to type, and its purpose."""

    purpose: str
    line: str


def settings(recording: Recording) -> list[Setting]:
    """All parameters in the recording, in the order of `--show-params`; two values if the sides differ."""
    sides = [_flat(part) for part in _parts(recording).values()]
    sources = [part for part in _sources(recording).values() if isinstance(part, Mapping)]
    defaults = {name: (value, meaning) for name, value, meaning in Params().described()}
    params = _params(recording)
    chosen = {} if params is None else {name: _written(value) for name, value in params.flat().items()}
    names = dict.fromkeys([*defaults, *(name for side in sides for name in side)])
    rows = []
    for name in names:
        values = list(dict.fromkeys(_written(side[name]) for side in sides if name in side))
        default, meaning = defaults.get(name, ("", ""))
        if values:
            is_default = values == [default] or chosen.get(name) == default
            by = [str(part[name]) for part in sources if name in part]
            source = " / ".join(dict.fromkeys(by))
            rows.append(Setting(name, " / ".join(values), "" if is_default else default, meaning, source))
    return rows


def commands(recording: Recording, files: Sequence[Path]) -> list[SuggestedCommand]:
    """Commands that repeat the run: with its settings and, if `files` contain a device's side, with its hand."""
    found = []
    if (params := _params(recording)) is not None:
        virtual = recording.meta.get("clock") == "virtual"
        live = params.operator == LIVE
        if live:  # these are no parameters of `hapnet play`
            playing = params.unset("operator", "duration_s")
            found.append(SuggestedCommand("The same settings, with your own hand", _line("play", recording, playing)))
        if is_simulated(params.hardware) and not live:
            servo = params.device.servo if virtual or params.device.servo != "auto" else "sampled"
            what = "The same run, to the last digit" if virtual else "The same settings in virtual time"
            sampled = params if servo == params.device.servo else params.set({"device.servo": servo})
            found.append(SuggestedCommand(what, _line("simulate", recording, sampled)))
        if not virtual and not live:
            found.append(SuggestedCommand("Once more in real time, on one machine", _line("run", recording, params)))
    if recording.device is not None and files:
        line = shlex.join(["hapnet", "replay", *map(str, files)])
        found.append(SuggestedCommand("The recorded hand again, through this link or another", line))
    return found


def of_side(recording: Recording, side: str) -> Mapping[str, Any]:
    """Return the metadata of the device's or the world's process."""
    found: Mapping[str, Any] = get(recording.meta, "sides", side) or recording.meta
    return found


def _parts(recording: Recording) -> dict[str, Any]:
    """The parameters of each process."""
    parts = {side: get(recording.meta, "sides", side, "params") for side in ("device", "world")}
    return {side: part for side, part in parts.items() if part} or {"": get(recording.meta, "params")}


def _sources(recording: Recording) -> dict[str, Any]:
    """The sources of each process's parameters, in the form of `_parts`; an old recording has none."""
    parts = {side: get(recording.meta, "sides", side, "sources") for side in ("device", "world")}
    return {side: part for side, part in parts.items() if part} or {"": get(recording.meta, "sources")}


def _params(recording: Recording) -> Params | None:
    """The parameters of both processes, each side's own from its process; None if they do not fit this version."""
    parts = _parts(recording)
    flat = _flat(next(iter(parts.values())))
    sources = _sources(recording)
    by = next(iter(sources.values()))
    if "world" in parts:
        flat |= {k: v for k, v in _flat(parts["world"]).items() if k.startswith(("world.", "link.down"))}
    if "world" in sources and isinstance(by, Mapping):
        others = {k: v for k, v in by.items() if not k.startswith(("world.", "link.down"))}
        by = others | {k: v for k, v in sources["world"].items() if k.startswith(("world.", "link.down"))}
    if not known(flat.get("duration_s")):
        flat["duration_s"] = round(read(recording.summary)["duration_s"] or Params().duration_s, 3)
    try:
        return without_rule(Params.recorded(flat, by))
    except InvalidParameter:
        return None


def _line(command: str, recording: Recording, params: Params) -> str:
    words = ["hapnet", command]
    if isinstance(seed := read(recording.summary)["seed"], int):
        words += ["--seed", str(seed)]
    for name, written, _ in params.described():
        if name in params.given and params.source(name) not in RESOLVED:
            value = params.get(name)
            words += ["--set", f"{name}={value if isinstance(value, str) else written}"]
    return shlex.join(words)


def _flat(tree: Any, prefix: str = "") -> dict[str, Any]:
    return dict(flatten(tree, prefix)) if isinstance(tree, Mapping) else {}


def _written(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)
