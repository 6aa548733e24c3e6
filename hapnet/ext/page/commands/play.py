"""`hapnet play`: a pair of processes whose hand follows the mouse, and the page that shows and controls the pair."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Annotated

import typer

from hapnet.commands import flags, output
from hapnet.commands.options import NO_LINK, LinkOptions, ModelOptions, ParamsOptions, ZenohOptions
from hapnet.errors import InvalidParameter
from hapnet.ext.page.commands.options import PageOptions
from hapnet.loading import extension
from hapnet.param_sources import COMMAND, FLAG
from hapnet.params import RELAXED_HAND, Params, is_simulated
from netem.groups import Without


def play(
    *,
    model: Annotated[ModelOptions, Without("operator", "duration")],
    seed: flags.Seed = 0,
    links: LinkOptions,
    params: ParamsOptions,
    out: Annotated[
        Path | None, typer.Option(help="Directory for recordings.", show_default="runs/<UTC time>-<seed>")
    ] = None,
    files: flags.Files = True,
    json_to: flags.Json = None,
    session: flags.Session = "default",
    name: flags.Name = "device",
    zenoh: ZenohOptions,
    realtime: flags.Realtime = False,
    page: PageOptions,
    seats: Annotated[
        str | None,
        typer.Option(metavar="N|NAMES", help="One hand a browser: 4, or alice,bob."),
    ] = None,
) -> int:
    """Drag the handle into the wall, make the link worse, or choose another coupling and see it shake: `zoh` has no
    PSPM.

    Each coupling is a new pair with its own verdict; --json writes the summary of the last pair. The page
    shows the parts of the force, and can also pause, restart and record. The hand is relaxed unless
    `operator_model` is set.

    With -e or -l only the hand runs here. The world is `hapnet world` on another host, which this side dials
    (`hapnet play -e tcp/HOST:17447`) or listens for. Axes and coupling are taken from the world. Ctrl-C ends it as it
    ends `hapnet device`.
    """
    far = zenoh.leave_this_host
    base = Params().set(NO_LINK, COMMAND) if far else Params()
    chosen = params.over(base, model.named("device", "world"), links)
    for own, why in (("operator", "the mouse is the hand here"), ("duration_s", "it runs until Ctrl-C")):
        if chosen.source(own) == FLAG:  # a file may be for other commands too
            raise InvalidParameter(own, chosen.get(own), "", why=f"{why}; leave it out")
    chosen = led(chosen)
    if seats is not None:
        _check_seats(seats, far=far)
        if not chosen.asked("scene"):
            chosen = chosen.set({"scene": BLOCK}, COMMAND)
    if params.show_params:
        return params.show(chosen)
    if not is_simulated(chosen.hardware):
        allowed = "simulated: the mouse is the hand here; `hapnet view` shows a pair with your own device"
        raise InvalidParameter("hardware", chosen.hardware, allowed)
    if not chosen.telemetry_hz:
        raise InvalidParameter("telemetry_hz", chosen.telemetry_hz, "above 0, as the page shows telemetry")
    if not far:
        for flag, given in (
            ("--session", session != "default"), ("--name", name != "device"), ("--no-files", not files),
            ("Zenoh's flags", zenoh != ZenohOptions()),
        ):  # fmt: skip
            if given:
                raise InvalidParameter(flag, "alone", "", why="it needs -e or -l, for a world on another host")
        if seats is not None:
            return _play_seats(chosen, seats, seed, out, page, json_to, realtime=realtime)
        return _play_here(chosen, seed, out, page, json_to, realtime=realtime)
    from hapnet.ext.page.commands import far_world

    if chosen.asked("scene"):
        why = f"the world's host chooses it: hapnet world --scene {chosen.scene}"
        raise InvalidParameter("--scene", chosen.scene, "", why=why)
    world = far_world.FarWorld(zenoh, session, name, seed, out, files, realtime, json_to)
    return far_world.play(chosen, world, page)


BLOCK = "shared:block?mass=0.2&size=30mm,60mm,30mm&at=30mm,0,0"
"""The world of several hands, unless another is given: a block that one can go around on the page."""


def _check_seats(seats: str, *, far: bool) -> None:
    """Raise InvalidParameter: these are no seats, or the world would not be here."""
    if far:
        why = "the world with the seats is here; on another host it is hapnet world --seats, and here play --name free"
        raise InvalidParameter("--seats", seats, "", why=f"{why}; leave -e and -l out")
    extension("seats").graph_of_seats(seats)


def _play_seats(
    chosen: Params, seats: str, seed: int, out: Path | None, page: PageOptions, json_to: str | None, *, realtime: bool
) -> int:
    """A world with several seats on this machine, and a hand for each browser."""
    from hapnet.ext.page.commands.seats import play as play_seats

    live = extension("seats")
    setups = live.seat_setups(seats, lambda pair: pair.set(chosen.changes(), dict(chosen.sources)))
    output.show_warnings(output.console(json_to), live.warnings_of(setups.values()))
    return play_seats(chosen, seats, setups, seed, out, page, json_to, realtime=realtime)


def _play_here(
    chosen: Params, seed: int, out: Path | None, page: PageOptions, json_to: str | None, *, realtime: bool
) -> int:
    """Both sides on this machine."""
    import asyncio

    from hapnet.assembly.build import prepare
    from hapnet.commands.run import check_sides
    from hapnet.ext.page.commands.stage import SESSION, PairSequence, run
    from hapnet.ext.page.commands.view import show
    from hapnet.ext.page.history import History
    from hapnet.ext.page.server import serve
    from hapnet.ext.page.watcher import Watcher
    from hapnet.transport.config import ZenohSettings, free_address

    setup = prepare(chosen, "sampled")
    check_sides(setup)
    words = output.console(json_to)
    output.show_warnings(words, setup.warnings)
    history = History(follows=False)
    address = free_address()
    stage = PairSequence(chosen, seed, out, address, words, history, realtime=realtime)
    watcher = Watcher(ZenohSettings(connect=(address,)), history.take, session=SESSION, name="device")
    with contextlib.ExitStack() as closing:
        served = closing.enter_context(serve(history, stage, host=page.host, port=page.port))
        watcher.open()
        closing.callback(watcher.close)
        words.print(f"open {served.url} and drag the handle; Ctrl-C ends")
        words.print(
            "the browser shares this machine's cores with the servo: --realtime gives the servo priority; "
            f"`hapnet view -e {address}` shows the same page to more people",
            style="dim",
        )
        if page.browser:
            show(served.url)
        written = output.Written()
        try:
            code = asyncio.run(run(stage))
        finally:
            if stage.summary is not None:
                with written.part():
                    output.write_json(stage.summary, json_to)
        return written.code(code)


def led(params: Params) -> Params:
    """`params` for a hand that follows the mouse, without a duration; the default hand becomes relaxed."""
    from hapnet.assembly.operators import LIVE

    given = any(name.startswith("operator_model.") for name in params.given)
    return params.set({**({} if given else RELAXED_HAND), "operator": LIVE, "duration_s": 0.0}, COMMAND)
