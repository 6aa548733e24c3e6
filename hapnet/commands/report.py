"""`hapnet report`: summary and figure of one or two recordings; a torn one is repaired beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hapnet.commands import output
from hapnet.errors import InvalidParameter
from hapnet.mcap_file import read_recording, repair
from hapnet.metrics import motion
from hapnet.record import Recording, join
from hapnet.runtime.summary import from_recording, merge


def main(files: list[Path], json_to: str | None, out: Path | None) -> int:
    """Read, repair what is torn, summarise, draw."""
    if not 1 <= len(files) <= 2:
        raise InvalidParameter("FILE", [str(file) for file in files], "one recording, or the device's and the world's")
    words = output.console(json_to)
    recordings = [read_recording(file) for file in files]
    for file, recording in zip(files, recordings, strict=True):
        if recording.torn:
            words.print(f"{file} is torn (its writer was killed): repaired and indexed copy in {repair(file)}")
    whole = recordings[0] if len(files) == 1 else join(*recordings)
    summary = _summary(recordings)
    summary["motion"] = motion(whole)
    whole = Recording(whole.meta, whole.device, whole.world, whole.events, summary, whole.torn)
    directory = files[0].parent if out is None else output.run_directory(out, None)
    figure = output.save_figure(whole, directory / f"{'-'.join(file.stem for file in files)}.png")
    output.show_summary(words, summary)
    words.print(f"figure in {figure}")
    output.write_json(summary, json_to)
    return 0


def _summary(recordings: list[Recording]) -> dict[str, Any]:
    """What the processes said at their end, or what their recordings still tell."""
    parts = [recording.summary or from_recording(recording) for recording in recordings]
    if len(parts) == 1:
        return parts[0]
    device, world = sorted(parts, key=lambda part: part["device"] is None)
    return merge(device, world)
