"""A hundred switches between couplings: the page, the terminal and the summary say the same of each pair.

The page's live word may be another one than the verdict at the end, as it is of an earlier time. By hand, with a line
for each: ``pytest -n 0 -s -m soak tests/view/test_switches.py``. A pair is two processes, as in `hapnet play`, or two
sides in this process, which start ten times as fast.
"""

from __future__ import annotations

import asyncio
import json
import math
import random
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")

from hapnet.assembly.build import prepare
from hapnet.checks import Vector
from hapnet.commands.console import _do
from hapnet.commands.standby import Reserve
from hapnet.ext.page.choices import CHOICES, label_of
from hapnet.ext.page.commands import stage
from hapnet.ext.page.numbers import _front
from hapnet.params import Params
from hapnet.realtime.runner import RealtimeSide
from hapnet.summary.words import headline
from hapnet.transport.config import ZenohSettings
from hapnet.wire.messages import Role
from tests.view.test_play import Playing, playing

LABELS = ("hapnet", "paper", "zoh", "wave")
WORDS = {True: "passive", False: "NOT passive", None: "not known"}
BUSY = "import os\nos.nice(19)\nwhile True: pass"
LINK = "delay 60ms 20ms loss 2%"
WAIT_S = 240.0


@contextmanager
def load(loops: int) -> Iterator[None]:
    """So many processes that do nothing but compute, at the lowest priority."""
    busy = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(loops)]
    try:
        yield
    finally:
        for each in busy:
            each.kill()
            each.wait()


class PairHere:
    """In the place of `hapnet.commands.pair.Pair`: both sides in this process, over Zenoh as there."""

    def __init__(
        self, params: Params, seed: int, directory: Path, on_notice: object, *, session: str, address: str,
        place: Vector | None, **more: object,
    ) -> None:  # fmt: skip
        self.parts: dict[str, Any] = {}
        self.failure: str | None = None
        self.failed: dict[str, str] = {}
        self._stop = asyncio.Event()
        self._tasks: dict[str, asyncio.Task[Any]] = {}
        self._sides: dict[str, RealtimeSide] = {}
        setup = prepare(params, "sampled")
        roles: tuple[Role, ...] = ("world", "device")
        for role in roles:
            where = ZenohSettings(listen=(address,)) if role == "world" else ZenohSettings(connect=(address,))
            self._sides[role] = RealtimeSide(setup, role, where, session=session, seed=seed)
            if place is not None:
                self._sides[role].place(place)

    async def start(self, ready: object) -> None:
        self._tasks = {role: asyncio.create_task(side.run(self._stop, 0.0)) for role, side in self._sides.items()}

    async def run(self, over: asyncio.Event) -> None:
        await over.wait()
        self._stop.set()
        for role, task in self._tasks.items():
            self.parts[role] = json.loads(json.dumps(await task))

    def stop(self) -> None:
        for side in self._sides.values():
            side.leave_at_once()

    def send(self, role: str, **command: Any) -> None:
        _do(self._sides[role], command)


def lines(play: Playing) -> list[str]:
    """What the terminal said of pairs that have ended."""
    return [line for line in play.said.getvalue().splitlines() if re.match(r"\d+: ", line)]


def word(play: Playing) -> str:
    """The verdict on the page, or "none"."""
    found = re.search('hapnet-passive">([^<]*)<', _front(play.history.snapshot(), "", (), ()))
    return "none" if found is None else found[1]


def incarnations(play: Playing) -> set[int]:
    snapshot = play.history.snapshot()
    return {side.incarnation for side in (snapshot.device_status, snapshot.world_status) if side is not None}


async def met(play: Playing, condition: Callable[[], bool], meanwhile: Callable[[], None] = lambda: None) -> None:
    async with asyncio.timeout(WAIT_S):
        while not condition():
            if play.task.done():
                play.task.result()
            meanwhile()
            await asyncio.sleep(0.005)


async def switched(play: Playing, label: str, new: str, rng: random.Random, ended: set[int]) -> tuple[list[str], str]:
    """A pair that runs for a while, and its end; what does not agree, and the page's word before it ended.

    ended : the incarnations of earlier pairs, to which it adds this pair's.
    """
    coupling = CHOICES[label][0]
    await met(play, lambda: play.coupled(coupling) and not incarnations(play) & ended)
    end, hz = time.monotonic() + rng.uniform(0.3, 2.0), rng.uniform(0.5, 2.5)
    while time.monotonic() < end:  # the hand moves to and fro
        play.stage.lead((0.04 * math.sin(2 * math.pi * hz * time.monotonic()),))
        await asyncio.sleep(0.02)
    live, before, old, wrong, gone = word(play), play.stage.summary, incarnations(play), list[str](), list[bool]()
    ended |= old

    def look() -> None:
        snapshot = play.history.snapshot()
        shows, of_old = _front(snapshot, "", (), ()), incarnations(play) & old
        if "hapnet-passive" not in shows:
            gone.append(True)
        elif gone and len(of_old) == 2:
            wrong.append("the old pair's verdict came back")

    play.stage.coupling(*CHOICES[new])
    await met(play, lambda: play.stage.summary is not before, look)
    assert play.stage.summary is not None
    verdict, kept, line = play.stage.summary["verdict"], play.history.snapshot().past[-1], lines(play)[-1]
    first = headline(play.stage.summary)[0]
    if not gone:
        wrong.append("the old pair's verdict was shown to its end")
    if line.partition(" s: ")[2] != first or kept.verdict != verdict:
        wrong.append(f"page {kept.verdict!r}, terminal {line!r}, summary {verdict!r}")
    if not line.split(": ")[1].startswith(f"{label}, ") or label_of(kept.coupling, kept.rendering) != label:
        wrong.append(f"{line!r} and {kept} are of {label}")
    return wrong, "" if live in ("none", WORDS[verdict["passive"]]) else f"; before that {live}"


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("processes", [True, False])
@pytest.mark.parametrize(("loops", "limit_s"), [(0, 900.0), (20, 360.0)])
async def test_page_terminal_and_summary_agree_on_each_pair(
    loops: int, limit_s: float, processes: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not processes:
        monkeypatch.setattr(stage, "Pair", PairHere)
        monkeypatch.setattr(Reserve, "prepare", lambda self: None)
    rng, count, wrong, label, ended = random.Random(loops), 0, list[str](), "hapnet", set[int]()
    deadline = time.monotonic() + limit_s
    with load(loops):
        async with playing(tmp_path, link__up=LINK, link__down=LINK) as play:
            play.stage._words.width = 10_000  # a line of the terminal is one line
            while count < 100 and time.monotonic() < deadline:
                new = rng.choice([each for each in LABELS if each != label])
                differs, live = await switched(play, label, new, rng, ended)
                count += 1
                print(f"{lines(play)[-1][:90]}{live}{differs or ''}", flush=True)
                wrong += [f"{count}: {one}" for one in differs]
                label = new
    print(f"{loops} busy loops: {count} switches; wrong: {wrong or 'none'}")
    assert not wrong
    assert count >= 20
