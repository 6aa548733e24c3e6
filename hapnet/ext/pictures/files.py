"""Writes figures and pages; each file appears only when it is complete."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING

from hapnet.recording.whole_file import complete_or_absent

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def png(fig: Figure) -> bytes:
    """`fig` as a PNG."""
    out = io.BytesIO()
    fig.savefig(out, format="png", dpi=150)
    return out.getvalue()


def save(data: bytes, path: str | os.PathLike[str], what: str) -> None:
    """Write `data`. Raises `RecordingError` if it cannot be written; the message calls it `what`."""
    with complete_or_absent(Path(path), what) as part:
        part.write_bytes(data)


def save_figure(fig: Figure, path: str | os.PathLike[str]) -> None:
    """Write `fig` as a PNG. Raises `RecordingError` if it cannot be written."""
    save(png(fig), path, "figure")
