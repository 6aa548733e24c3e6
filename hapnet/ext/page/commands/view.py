"""`hapnet view`: serves the page of a pair that runs elsewhere, or of a recording. It only watches."""

from __future__ import annotations

import os
import sys
import time
import webbrowser
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapnet.commands import output
from hapnet.commands.options import ZenohOptions
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter
from hapnet.ext.page.commands.options import PageOptions
from hapnet.loading import only_imported, permitting
from netem.groups import Without

if TYPE_CHECKING:
    from hapnet.ext.page.watcher import Watcher

LOOK_S = 0.5
PLAY_S = 0.01


def view(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[FILE]", help="A recording to play back, or the device's and the world's; or a run's directory."
        ),
    ] = None,
    *,
    session: Annotated[str | None, typer.Option(help="Name of the session.", show_default="the first heard")] = None,
    name: Annotated[str | None, typer.Option(help="Name of the device.", show_default="the first heard")] = None,
    zenoh: Annotated[ZenohOptions, Without("users", "mutual_tls", "encrypt")],
    page: PageOptions,
) -> int:
    """Dial the side that listens. Its access control decides what others may see. With a recording
    (`hapnet view run.mcap`) the page plays it back, again and again.
    """
    if files:
        if session or name or zenoh.connect or zenoh.listen or zenoh.config:
            why = "a recording is played back alone; leave it out to watch a running pair"
            raise InvalidParameter("FILE", " ".join(map(str, files)), "", why=why)
        return play_back(files, page)
    from hapnet.commands.side import zenoh_settings
    from hapnet.ext.page.history import History
    from hapnet.ext.page.server import serve
    from hapnet.ext.page.watcher import Watcher

    words = output.console(None)
    history = History()
    watcher = Watcher(zenoh_settings(zenoh), history.take, session=session, name=name)
    with ExitStack() as closing:
        served = closing.enter_context(serve(history, host=page.host, port=page.port))
        closing.callback(watcher.close)
        watcher.open()
        words.print(f"open {served.url} to watch; Ctrl-C ends")
        if page.browser:
            show(served.url)
        shown = ""
        while True:
            if (text := _state(watcher)) != shown:
                shown = text
                words.print(text)
            time.sleep(LOOK_S)


@permitting(only_imported)
def play_back(files: list[Path], options: PageOptions) -> int:
    """Serve the page of a recording, which is played at its own pace, until a signal ends it."""
    from hapnet.ext.page.history import History
    from hapnet.ext.page.playback import Playback
    from hapnet.ext.page.server import serve
    from hapnet.recording.missing import all_missing
    from hapnet.recording.opened import fitting, opened
    from hapnet.summary.recorded import of_recordings

    words = output.console(None)
    with Progress(output.progress_console(words), "reading"):
        found = opened(files)
        whole = found.whole
    if whole.device is None and whole.world is None:
        raise InvalidParameter("FILE", str(files[0]), "a recording with samples")
    for line in all_missing(found.files, found.parts):
        output.complain(line)
    history = History(follows=False)
    with fitting(files[0]):
        history.judge_by(of_recordings(found.files, found.parts))
        playback = Playback(history.take, whole, files[0].stem, time.monotonic_ns())
    with serve(history, player=playback, host=options.host, port=options.port) as page:
        words.print(
            f"open {page.url} to see {' and '.join(map(str, files))}; Ctrl-C ends", markup=False, soft_wrap=True
        )
        if options.browser:
            show(page.url)
        while True:
            playback.advance(time.monotonic_ns())
            time.sleep(PLAY_S)


def show(url: str) -> None:
    """Open the page in a browser, if this runs in a graphical terminal."""
    if sys.stdout.isatty() and (sys.platform != "linux" or {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ)):
        webbrowser.open(url)


def _state(watcher: Watcher) -> str:
    """The state of the watched pair, as text."""
    if watcher.pair is None:
        problem = f" ({watcher.problem})" if watcher.problem else ""
        return f"waiting for a pair's telemetry: {watcher.where}{problem}"
    text = "watching session {} of device {}".format(*watcher.pair)
    if watcher.telemetry.undecrypted:
        text += "; its telemetry is encrypted: give the pair's --secret-file to see it"
    if watcher.others:
        more = ", ".join(" ".join(pair) for pair in sorted(watcher.others))
        text += f"; other pairs, to choose by --session and --name: {more}"
    return text
