"""The flags that several commands of the page share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

Host = Annotated[
    str,
    typer.Option(
        metavar="ADDRESS", help="Serve the page here.\n\nWith 0.0.0.0 others can open it too, and press every button."
    ),
]
Port = Annotated[int, typer.Option(min=0, max=65535, metavar="N", help="Port of the page, or the next free one.")]
Browser = Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")]


@dataclass(frozen=True)
class PageOptions:
    """The address and the port of the live page, and whether a browser opens it."""

    host: Host = "127.0.0.1"
    port: Port = 8080
    browser: Browser = True
