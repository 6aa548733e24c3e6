"""Safe HTML: elements are made only here, and every text in them is escaped."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

VOID = frozenset({"img", "meta"})


class Html(str):
    """Text that is already HTML; `element` and `join` make it from other text."""

    __slots__ = ()


def element(name: str, /, *children: str, **attributes: str) -> Html:
    """``<name attribute="...">children</name>``; attributes, and children that are not `Html`, are escaped.

    An underscore at the end of an attribute's name is dropped (``class_``), any other becomes a hyphen.
    """
    words = "".join(f' {key.rstrip("_").replace("_", "-")}="{escape(value)}"' for key, value in attributes.items())
    return Html(f"<{name}{words}>" if name in VOID else f"<{name}{words}>{join(*children)}</{name}>")


def join(*children: str) -> Html:
    """All `children` one after the other."""
    return Html("".join(child if isinstance(child, Html) else escape(child) for child in children))


def table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]], *, caption: str = "", class_: str = "") -> Html:
    """A table with headers for columns and rows: the first cell of a row is its header."""
    lines = [
        element("tr", element("th", row[0], scope="row"), *(element("td", cell) for cell in row[1:])) for row in rows
    ]
    header = element("thead", element("tr", *(element("th", cell, scope="col") for cell in head)))
    parts = [element("caption", caption)] if caption else []
    parts += [header] if any(head) else []
    return element(
        "div", element("table", *parts, element("tbody", *lines), class_=class_), class_="wide", tabindex="0"
    )
