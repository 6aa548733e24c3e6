"""The page of `hapnet play` as a moving picture: a mouse leads the hand into the wall, through two couplings
side by side.

The page is the real page, in a browser. Device and world run in virtual time, which stands still while a picture is
taken, so the film is the same on every machine, however slowly the browser draws.
"""

from __future__ import annotations

import io
import json
import math
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont
from playwright.sync_api import Browser, Page, expect, sync_playwright

from hapnet.checks import Vector
from hapnet.ext.page import page as live_page
from hapnet.ext.page.history import History
from hapnet.ext.page.server import serve
from hapnet.params import RELAXED_HAND, Params
from hapnet.plant.operator import Impedance
from hapnet.recording.samples import Event
from hapnet.recording.telemetry import KnownPlanes, Status
from hapnet.simulation.simulation import Simulation, simulate
from hapnet.summary.reported import values_of

LINK = "delay 40ms 10ms loss 2%"
FRAME_NS = 150_000_000
SECOND_NS = 1_000_000_000
SIZE = (560, 600)  # of each browser's window
GAP = 4  # between the windows
CAPTION = 40  # height of the words below it
COLOURS = 40
KEPT = bytes.fromhex(
    "ffffff111827 2563eb1e40af60a5fa ea580c9a3412fb923c 16a34a86efac dc2626fca5a5 93c5fd 15803d fa5252 228be6"
)
"""Colours of the page that the film keeps exactly: handle, proxy, force, verdict, buttons."""

REST_MS = 2500
LIMIT_MS = 240_000.0

POINTER = """
const dot = document.createElement('div');
dot.innerHTML = '<svg width="22" height="30"><path d="M2 2v22l6-5 4 9 4-2-4-9h8z" fill="#111" stroke="#fff"/></svg>';
dot.style.cssText = 'position:fixed;z-index:9999;pointer-events:none;left:-99px';
addEventListener('DOMContentLoaded', () => document.body.append(dot));
addEventListener('pointermove', e => { dot.style.left = e.clientX + 'px'; dot.style.top = e.clientY + 'px'; }, true);
"""
NOT_GREY = """
addEventListener('DOMContentLoaded', () => {
  const style = document.createElement('style');
  style.textContent = '.hapnet-drawn-0, .hapnet-drawn-1 { animation: none !important; filter: none !important; }';
  document.head.append(style);
});
"""
"""Numbers do not turn grey while the pair stands still for a picture."""

PAINTED = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"


@dataclass(frozen=True)
class Act:
    """A half of the film: a coupling, and the caption below the picture."""

    coupling: str
    rendering: str
    words: str


ACTS = (
    Act("pspm", "hapnet", "hapnet: the wall is felt, nothing shakes"),
    Act("zoh", "paper", "a plain spring: the hand shakes"),
)
SECONDS = 6  # the duration of both


class Mouse:
    """An operator (``module:Class``): the mouse leads the hand into the wall and out again."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        self.dof, self.impedance = dof, impedance

    def reference(self, t: float) -> Vector:
        place = 0.038 * (_eased((t - 0.4) / 0.9) - _eased((t - 2.7) / 0.9))
        return (place, *(0.0 for _ in range(self.dof - 1)))


class Untouched:
    """The page's controls; they are not used in the film."""

    fixed = ""

    def __getattr__(self, name: str) -> Any:
        return lambda *_: None


def film(file: Path, frame_ns: int = FRAME_NS) -> None:
    """Write the film as a GIF, with a frame every `frame_ns`: the acts side by side. Its comment has the page's words
    at the end of each act."""
    live_page.SILENT_S = math.inf  # the pair stands still while a picture is taken; this must not count as silence
    texts = set[str]()
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium") or shutil.which("google-chrome"),
            args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
        )
        acts = [_filmed(browser, act, frame_ns, texts) for act in ACTS]
        browser.close()
    pictures = [_beside(halves) for halves in zip(*acts, strict=True)]
    _save(file, pictures, frame_ns, json.dumps({"texts": sorted(texts), "curves": []}, ensure_ascii=False))


def _filmed(browser: Browser, act: Act, frame_ns: int, texts: set[str]) -> list[Image.Image]:
    """The pictures of an act, on a page of its own; adds the page's words to `texts`."""
    history, pictures = History(), list[Image.Image]()
    with serve(history, Untouched(), port=0, frame_s=0.1) as server:
        page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
        page.set_default_timeout(LIMIT_MS)
        page.add_init_script(POINTER)
        page.add_init_script(NOT_GREY)
        for seconds in _played(history, act, frame_ns):
            if not pictures:
                page.goto(server.url)
                expect(page.locator(".hapnet-state")).to_have_text("running", timeout=LIMIT_MS)
                page.wait_for_timeout(3000)
                page.locator(".mantine-Notification-closeButton").click()  # a warning about the browser's graphics
                page.wait_for_timeout(1000)
            _point(page, Mouse(1, Impedance(0.0, 0.0, 0.0)).reference(seconds)[0])
            if len(pictures) == 1:  # the handle is held to the end
                page.mouse.down()
            page.wait_for_timeout(400)
            page.evaluate(PAINTED)
            pictures.append(_framed(page.screenshot(), act.words))
        page.wait_for_timeout(2000)
        texts |= {act.words, *_words(page.locator("body").inner_text())}
        page.close()
    return pictures


def _beside(halves: Sequence[Image.Image]) -> Image.Image:
    """The pictures side by side, with a line between them."""
    width, height = halves[0].size
    whole = Image.new("RGB", ((width + GAP) * len(halves) - GAP, height), "#111827")
    for number, half in enumerate(halves):
        whole.paste(half, (number * (width + GAP), 0))
    return whole


def _words(text: str) -> set[str]:
    """The lines of a text that have letters, without their numbers."""
    lines = (re.sub(r"[-−+]?\d[\d.,]*", "#", line).strip() for line in text.splitlines())
    return {line for line in lines if re.search(r"[a-z]{2}", line)}


def _played(history: History, act: Act, frame_ns: int) -> Iterator[float]:
    """Send the pair's samples to the page, frame by frame; yields the time of each frame [s]."""
    changes = {
        "coupling": act.coupling,
        "rendering": act.rendering,
        "operator": f"{__name__}:Mouse",
        "device.servo": "sampled",
    }
    links = {"link.up": LINK, "link.down": LINK, "duration_s": float(SECONDS), "record_hz": 60.0}
    params = Params().set({**RELAXED_HAND, **changes, **links})
    run = Simulation(params, seed=1, kernel=False)
    recording = run.run().recording
    accounts = [simulate(params.set({"duration_s": second + 1.0}), seed=1).summary for second in range(SECONDS)]
    samples = [sample for sample in recording.samples() if not isinstance(sample, Event)]
    first_ns, due_ns = samples[0].time_ns, frame_ns
    history.take(KnownPlanes(run.device_endpoint.planes if act.rendering == "hapnet" else None))
    for sample in samples:
        if sample.time_ns - first_ns > due_ns:
            for role in ("device", "world"):
                account = {} if due_ns < SECOND_NS else values_of(accounts[due_ns // SECOND_NS - 1], role)
                history.take(_status(recording.meta, role, act, account))
            yield due_ns / 1e9
            due_ns += frame_ns
        history.take(sample)


def _status(meta: Any, role: Any, act: Act, account: Mapping[str, Any]) -> Status:
    about = {**meta, "role": role, "clock": "virtual", "name": "device", "session": "play"}
    link = {"profile": LINK, "delay_now_ms": 40.0, "loss_now": 0.02}
    heard = {"up": {"loss": 0.02}, "down": None} if role == "world" else {"up": None, "down": {"loss": 0.02}}
    path = {"round_trip_p50_ms": 80.0, **heard}
    return Status(role, 0, 1, True, False, "", about, link, path, account)


def _eased(share: float) -> float:
    share = min(max(share, 0.0), 1.0)
    return (3.0 - 2.0 * share) * share**2


def _point(page: Page, x_m: float) -> None:
    """Move the pointer to a place on the first axis, 24 units of 10 mm away, with a field of view of 30 degrees."""
    left, top, width, height = page.evaluate(
        "() => { const b = document.querySelector('canvas[data-engine]').getBoundingClientRect();"
        " return [b.x, b.y, b.width, b.height]; }"
    )
    per_m = height / 2.0 / (0.24 * math.tan(math.radians(15.0)))
    page.mouse.move(left + width / 2.0 + x_m * per_m, top + height / 2.0)


def _framed(data: bytes, words: str) -> Image.Image:
    """The picture with its caption below."""
    seen = Image.open(io.BytesIO(data)).convert("RGB")
    whole = Image.new("RGB", (seen.width, seen.height + CAPTION), "#111827")
    whole.paste(seen, (0, 0))
    font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), 18)
    place = (seen.width // 2, seen.height + CAPTION // 2)
    ImageDraw.Draw(whole).text(place, words, fill="white", font=font, anchor="mm")
    return whole


def _save(file: Path, pictures: list[Image.Image], frame_ns: int, description: str) -> None:
    """Write a GIF with one palette; the last picture stays longer."""
    few = [pictures[round(share * (len(pictures) - 1))] for share in (0.0, 0.25, 0.4, 0.75, 1.0)]
    width, height = pictures[0].size
    sample = Image.new("RGB", (width, height * len(few)))
    for row, picture in enumerate(few):
        sample.paste(picture, (0, row * height))
    found = sample.quantize(COLOURS - len(KEPT) // 3, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    palette = Image.new("P", (1, 1))
    palette.putpalette([*KEPT, *(found.getpalette() or [])[: 3 * COLOURS - len(KEPT)]])
    first, *rest = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    lasting = [frame_ns // 1_000_000] * len(rest) + [REST_MS]
    first.save(
        file, save_all=True, append_images=rest, duration=lasting, loop=0, optimize=False, comment=description.encode()
    )
