"""The servo's lateness while the pair is watched, in turns with the same pair without a watcher."""

from __future__ import annotations

import contextlib
import secrets
import shutil
import time
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from tempfile import TemporaryDirectory

from hapnet.ext.bench.row import Limit, Options, Row
from hapnet.ext.bench.servo import late_row
from hapnet.ext.bench.sides import beside_and_alone
from hapnet.params import Params
from hapnet.processes.child import Child, WaitForStart
from hapnet.processes.start import NOTHING, kill, started
from hapnet.transport.config import ZenohSettings, free_address

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
HEADLESS = ("--headless", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


def servo_watched(options: Options) -> Row:
    """The lateness beside a client that reads all telemetry; with --realtime, beside a browser that shows the page.

    Without --realtime no browser is started, as on the same cores it would delay a servo without priority.
    """
    browser = next(filter(None, map(shutil.which, BROWSERS)), None) if find_spec("viser") is not None else None
    browser = browser if options.realtime else None
    who = "a browser shows the page, on the same cores" if browser else "a client reads all telemetry"
    params = Params().set({"link.up": "", "link.down": "", "duration_s": options.seconds})
    watched, alone = beside_and_alone(params, options, partial(_watching, browser, options.seconds))
    note = "" if browser or not options.realtime else "no browser"
    against, limits = "the same pair without a watcher, in turns", (Limit("ratio_p99", 1.2),)
    return late_row("servo_watched", f"lateness while {who}", watched, against, alone, limits=limits, note=note)


@contextlib.contextmanager
def _watching(browser: str | None, seconds: float, address: str) -> Iterator[None]:
    """A context in which the pair whose world listens at `address` is watched."""
    port, token = int(free_address().rpartition(":")[2]), secrets.token_urlsafe(16)
    with contextlib.ExitStack() as stack:
        reader = stack.enter_context(Child(_watch, address, seconds, port if browser else None, token))
        if browser:
            profile = stack.enter_context(TemporaryDirectory(prefix="hapnet-bench-", ignore_cleanup_errors=True))
            command = [browser, *HEADLESS, f"--user-data-dir={profile}", "--remote-debugging-port=0"]
            program = started([*command, f"http://127.0.0.1:{port}/{token}/"], stdout=NOTHING, stderr=NOTHING)
            stack.callback(kill, program)
        reader.wait_ready()
        reader.go()
        yield


def _watch(wait_for_start: WaitForStart, address: str, seconds: float, port: int | None, token: str) -> None:
    """Read all telemetry and, at a `port`, serve the page to a browser."""
    from hapnet.ext.page.history import History
    from hapnet.ext.page.watcher import Watcher

    history = History()
    watcher = Watcher(ZenohSettings(connect=(address,)), history.take)
    watcher.open()
    with contextlib.ExitStack() as stack:
        if port is not None:
            from hapnet.ext.page.server import serve

            page = stack.enter_context(serve(history, port=port, token=token))
            while not page.watched:
                time.sleep(0.1)
        while watcher.pair is None:  # until then there is no telemetry
            time.sleep(0.05)
        wait_for_start()
        time.sleep(2.0 * seconds + 60.0)  # the benchmark ends this process earlier
