"""A page that lists the reports on several pairs of a graph, with the verdict on the whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import NamedTuple

from hapnet.ext.pictures.html import Html, element, table

_POLICY = "default-src 'none'; style-src 'unsafe-inline'"
_ROW, _LEFT, _RIGHT, _WIDE = 40, 150, 450, 600
_MEANS = {"good": "passive", "bad": "not passive", "unknown": "not known"}


class PairOf(NamedTuple):
    """A pair in the picture: its name, device and world; page, its own report (empty: there is none); outcome: good,
    bad or unknown."""

    name: str
    device: str
    world: str
    page: str
    outcome: str


class Listed(NamedTuple):
    """A table of the page: its title, the heads of its columns, and its rows."""

    title: str
    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


def several(title: str, verdict: str, outcome: str, pairs: Sequence[PairOf], tables: Sequence[Listed]) -> str:
    """The page as HTML. outcome : of the whole, as of a pair. All texts are escaped."""
    links = [
        element("li", element("a", pair.name, href=pair.page) if pair.page else pair.name, ": ",
                element("span", _MEANS[pair.outcome], class_=pair.outcome))
        for pair in pairs
    ]  # fmt: skip
    body = element(
        "main",
        element("h1", title),
        element("p", verdict, class_=f"verdict {outcome}"),
        element("section", element("h2", "The graph"), _picture(pairs)),
        element("section", element("h2", "The pairs' own reports"), element("ul", *links)),
        *(
            element("section", element("h2", one.title), table(one.head, one.rows, class_="numbers"))
            for one in tables
            if one.rows
        ),
    )
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=_POLICY),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", f"{title}: hapnet report"),
        element("style", Html((files("hapnet.ext.pictures") / "style.css").read_text("utf-8"))),
    )
    return f"<!doctype html>\n{element('html', head, element('body', body), lang='en')}\n"


def _picture(pairs: Sequence[PairOf]) -> Html:
    """Devices on the left, worlds on the right, and a line for each pair in the colour of its verdict."""
    devices, worlds = _places([pair.device for pair in pairs]), _places([pair.world for pair in pairs])
    high = _ROW * max(len(devices), len(worlds))
    step = high / len(worlds)
    at = {name: round(step * (number + 0.5)) for number, name in enumerate(worlds)}
    lines = [
        element("line", x1=str(_LEFT), y1=str(devices[pair.device]), x2=str(_RIGHT), y2=str(at[pair.world]),
                stroke_width="3", style=f"stroke: var(--{pair.outcome})")
        for pair in pairs
    ]  # fmt: skip
    names = [_name(name, _LEFT - 8, y, "end") for name, y in devices.items()]
    names += [_name(name, _RIGHT + 8, y, "start") for name, y in at.items()]
    said = "; ".join(f"{pair.name}: {_MEANS[pair.outcome]}" for pair in pairs)
    size = {"width": str(_WIDE), "height": str(high), "viewBox": f"0 0 {_WIDE} {high}"}
    return element("div", element("svg", *lines, *names, role="img", aria_label=said, **size), class_="wide")


def _places(names: Sequence[str]) -> Mapping[str, int]:
    """The middle of each name's row, each name once."""
    return {name: _ROW * number + _ROW // 2 for number, name in enumerate(dict.fromkeys(names))}


def _name(name: str, x: int, y: int, anchor: str) -> Html:
    style = "fill: var(--ink)"
    return element("text", name, x=str(x), y=str(y), text_anchor=anchor, dominant_baseline="middle", style=style)
