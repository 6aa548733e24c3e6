"""Helpers for the pictures that are drawn by programs of this folder, not by a command of hapnet."""

from __future__ import annotations

import argparse
import io
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from hapnet.checks import Array
from hapnet.ext.pictures.style import MM, STYLE, png

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COUPLINGS = {"zoh": "plain spring", "pspm": "PSPM"}
POINTS = 2000
COLOURS, REST_MS = 48, 2000


def canvas(width_mm: float, height_mm: float) -> Figure:
    """An empty figure in the style of hapnet's pictures."""
    from matplotlib.figure import Figure

    matplotlib.rcParams.update(STYLE)
    figure = Figure(figsize=(width_mm * MM, height_mm * MM), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def saved(figure: Figure, name: str) -> None:
    """Write it into the directory that `--out` names."""
    (out_directory() / name).write_bytes(png(figure))


def image(figure: Figure) -> Image.Image:
    """The figure as it is now, as a frame of a moving picture."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=110)
    return Image.open(file).convert("RGB")


def animated(frames: list[Image.Image], description: str, name: str, frame_s: float) -> None:
    """Write a moving picture into the directory that `--out` names; its last frame stays for `REST_MS`."""
    sample = Image.new("RGB", (frames[0].width, 3 * frames[0].height))
    for row, share in enumerate((0.25, 0.5, 0.95)):
        sample.paste(frames[int(share * len(frames))], (0, row * frames[0].height))
    palette = sample.quantize(COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    first, *rest = [one.quantize(palette=palette, dither=Image.Dither.NONE) for one in frames]
    lasting = [round(1e3 * frame_s)] * len(rest) + [REST_MS]
    first.save(
        out_directory() / name, save_all=True, append_images=rest, duration=lasting, loop=0, optimize=False,
        comment=description.encode(),
    )  # fmt: skip


def out_directory() -> Path:
    """The directory that `--out` names."""
    out: Path = options().out
    return out


def options() -> argparse.Namespace:
    """The options of a program of this folder: `out`, which is made; `table`, of which one program makes a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", type=Path, default=Path())
    parser.add_argument("--table", type=Path)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    return given


def thinned(values: Array) -> Array:
    """Indices of about `POINTS` values: the smallest and the largest of each short stretch."""
    if len(values) <= POINTS:
        return np.arange(len(values))
    stretches = np.array_split(np.arange(len(values)), POINTS // 2)
    return np.unique([s[pick(values[s])] for s in stretches for pick in (np.argmin, np.argmax)])
