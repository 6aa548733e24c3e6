"""The pictures of a report, each with a caption and an alternative text."""

from __future__ import annotations

from dataclasses import dataclass

from hapnet.ext.pictures import zoomed
from hapnet.ext.pictures.histograms import lateness_histogram, link_histogram
from hapnet.ext.pictures.run import figure
from hapnet.ext.pictures.scene import scene_figure
from hapnet.ext.pictures.style import png
from hapnet.recording.samples import Recording
from hapnet.summary.structure import DIRECTIONS, read
from hapnet.summary.verdict import has_reservoirs
from hapnet.summary.words import number


@dataclass(frozen=True)
class PngPicture:
    """A PNG. `name` ends its file's name; `caption` explains how to read it, `alternative` describes it.

    zoomed : the same picture for plotly.js, which can zoom it; empty: there is none.
    """

    name: str
    png: bytes
    caption: str
    alternative: str
    zoomed: str = ""


def pictures(recording: Recording) -> dict[str, PngPicture]:
    """Pictures by name: ``run``, ``scene`` of solids, and ``link`` and ``servo`` if their histograms were recorded."""
    summary = read(recording.summary)
    full = has_reservoirs(summary["coupling"])
    panels = f"positions of device and proxy, forces, {'energy reservoirs, ' if full else ''}passivity margin"
    caption = _RUN.format(reservoirs=_RESERVOIRS if full else "")
    run = figure(recording, titled=False)  # the page has the verdict above it
    drawn = png(run)  # this also lays the panels out
    found = [
        PngPicture("run", drawn, caption, f"Against time: {panels}.", zoomed.zoomed(run) if zoomed.can_zoom() else "")
    ]
    if (scene := scene_figure(recording)) is not None:
        found.append(PngPicture("scene", png(scene), _SCENE, "The scene in 3-D, with the paths of device and proxy."))
    if (links := link_histogram(summary)) is not None:
        directions = [
            f"{direction}link p50 {number(link['delay_p50_ms'])} ms, p99 {number(link['delay_p99_ms'])} ms"
            for direction in DIRECTIONS
            if (link := summary["links"][direction]) is not None
        ]
        found.append(PngPicture("link", png(links), _LINK, f"Histogram of delays: {'; '.join(directions)}."))
    lateness, device = lateness_histogram(summary), summary["device"]
    if lateness is not None and device is not None:
        servo = device["servo"]
        late = (servo["late_p50_us"], servo["late_p99_us"], servo["late_max_us"])
        alternative = "Histogram of lateness: p50 {} µs, p99 {} µs, most {} µs.".format(*map(number, late))
        found.append(PngPicture("servo", png(lateness), _SERVO, alternative))
    return {picture.name: picture for picture in found}


_RUN = (
    "Positions: in contact (grey) the surface stops the proxy while the hand moves on. Forces: the coupling's force on "
    "the device, and the surface's force on the proxy. {reservoirs}Margin: the bound d² plus the energy put in, minus "
    "the energy that came out; in the red area, energy was created. A silence is shaded from its detection to its end."
)
_RESERVOIRS = (
    "Reservoirs: the energy that each side may use to move its spring; an empty reservoir holds the set-position back. "
)
_SCENE = (
    "The scene with the path of the hand (device) and the path of the world's proxy, which solids stop. Red: "
    "the proxy is in contact; the line is the largest force, 10 mm per newton, and around it the contact's friction "
    "cone. Moving bodies are shown at the time of the largest force, and faintly at other times."
)
_LINK = (
    "The delay of packets in each emulated link, from the offer to the release time by the profile, as counted by the "
    "link. Lost packets are not included, and neither is the real network."
)
_SERVO = (
    "The lateness of the servo's ticks after their deadlines; both axes are logarithmic. A tick that is late by a "
    "whole period is a missed deadline."
)
