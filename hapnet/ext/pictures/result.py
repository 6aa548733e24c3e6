"""How a run's result is drawn, and shown in a notebook."""

from __future__ import annotations

from base64 import b64encode

from hapnet.errors import MissingLibrary
from hapnet.ext.pictures.html import Html, element, join
from hapnet.ext.pictures.run import figure as figure
from hapnet.ext.pictures.style import also_to as also_to, png
from hapnet.ext.pictures.tables import brief
from hapnet.recording.samples import Recording
from hapnet.summary.structure import read
from hapnet.summary.words import outcome, verdict

_COLOURS = {"good": "#116329", "bad": "#a40e26", "unknown": "#7d4e00"}


def html(recording: Recording) -> str:
    """Of a recording with a summary. The picture is left out where nothing draws (extra `report`)."""
    summary = read(recording.summary)
    style = f"border-left: 0.4rem solid {_COLOURS[outcome(summary)]}; padding-left: 0.6rem; font-weight: 600"
    lines = [element("li", line) for line in brief(summary)]
    return element("div", element("p", verdict(summary), style=style), element("ul", *lines), _picture(recording))


def _picture(recording: Recording) -> Html:
    try:
        data = b64encode(png(figure(recording))).decode("ascii")
    except MissingLibrary:
        return join()
    return element("img", src=f"data:image/png;base64,{data}", alt="positions, forces and margin over time")
