"""`hapnet view`: the page of a pair that runs elsewhere. It only watches."""

from __future__ import annotations

import os
import sys
import time
import webbrowser
from contextlib import ExitStack

from hapnet.commands import output
from hapnet.commands.options import PageOptions, ZenohOptions
from hapnet.commands.side import zenoh_settings
from hapnet.view.history import History
from hapnet.view.server import serve
from hapnet.view.watcher import Watcher

LOOK_S = 0.5


def main(zenoh: ZenohOptions, session: str | None, name: str | None, options: PageOptions) -> int:
    """Serve the page until a signal ends it."""
    words = output.console(None)
    history = History()
    watcher = Watcher(zenoh_settings(zenoh), history.take, session=session, name=name)
    with ExitStack() as closing:
        page = closing.enter_context(serve(history, host=options.host, port=options.port))
        closing.callback(watcher.close)
        watcher.open()
        words.print(f"open {page.url} to watch; Ctrl-C ends")
        if options.browser:
            show(page.url)
        told = ""
        while True:
            if (text := _state(watcher)) != told:
                told = text
                words.print(text)
            time.sleep(LOOK_S)


def show(url: str) -> None:
    """Open the page in a browser, if this runs in a graphical terminal."""
    if sys.stdout.isatty() and (sys.platform != "linux" or {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ)):
        webbrowser.open(url)


def _state(watcher: Watcher) -> str:
    """What the page watches, in words."""
    if watcher.pair is None:
        problem = f" ({watcher.problem})" if watcher.problem else ""
        return f"waiting for a pair's telemetry: {watcher.where}{problem}"
    text = "watching session {} of device {}".format(*watcher.pair)
    if watcher.others:
        more = ", ".join(" ".join(pair) for pair in sorted(watcher.others))
        text += f"; others that --session and --name can choose: {more}"
    return text
