"""`hapnet view`: the page of a pair that runs elsewhere, or of a recording. It only watches."""

from __future__ import annotations

import os
import sys
import time
import webbrowser
from contextlib import ExitStack
from pathlib import Path

from hapnet.commands import output
from hapnet.commands.options import PageOptions, ZenohOptions
from hapnet.commands.progress import Progress
from hapnet.commands.side import zenoh_settings
from hapnet.errors import InvalidParameter
from hapnet.recording.mcap import read_recording
from hapnet.recording.samples import join
from hapnet.view.history import History
from hapnet.view.playback import Playback
from hapnet.view.server import serve
from hapnet.view.watcher import Watcher

LOOK_S = 0.5
PLAY_S = 0.01


def play_back(files: list[Path], options: PageOptions) -> int:
    """Serve the page of a recording, which is played at its own pace, until a signal ends it."""
    words = output.console(None)
    if len(files) > 2:
        raise InvalidParameter("FILE", [str(file) for file in files], "one recording, or the device's and the world's")
    with Progress(output.progress_console(), "reading"):
        recordings = [read_recording(file) for file in files]
        whole = recordings[0] if len(files) == 1 else join(*recordings)
    if whole.device is None and whole.world is None:
        raise InvalidParameter("FILE", str(files[0]), "a recording with samples")
    history = History(keeps_past=False)
    with serve(history, host=options.host, port=options.port) as page:
        words.print(f"open {page.url} to see {' and '.join(map(str, files))}; Ctrl-C ends", markup=False)
        if options.browser:
            show(page.url)
        playback = Playback(history.take, whole, files[0].stem, time.monotonic_ns())
        while True:
            playback.advance(time.monotonic_ns())
            time.sleep(PLAY_S)


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
    if watcher.undecrypted:
        text += "; it encrypts: --secret-file with the word of its sides lets you see it"
    if watcher.others:
        more = ", ".join(" ".join(pair) for pair in sorted(watcher.others))
        text += f"; others that --session and --name can choose: {more}"
    return text
