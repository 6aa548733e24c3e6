"""`hapnet device` and `hapnet world`: one side in this process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapnet.commands import complete, flags
from hapnet.commands.options import (
    NO_LINK,
    ModelOptions,
    OneWay,
    ParamsOptions,
    SideFlags,
    ZenohOptions,
    no_out_without_files,
)
from hapnet.errors import InvalidParameter
from hapnet.loading import extension
from hapnet.param_sources import COMMAND
from hapnet.params import Params
from netem.groups import Without

if TYPE_CHECKING:
    from hapnet.wire.messages import Role


def device(
    *,
    model: Annotated[ModelOptions, Without("follower")],
    side: SideFlags,
    zenoh: ZenohOptions,
    links: OneWay,
    params: ParamsOptions,
    role: Annotated[
        str,
        typer.Option(
            metavar="leader|follower",
            help="follower: this device is a robot that follows the leader's, in place of `hapnet world`.",
            autocompletion=complete.words("leader", "follower"),
        ),
    ] = "leader",
    graph: flags.Graph = None,
    node: flags.Node = None,
) -> int:
    _check_several(graph, node, None, side, params)
    if graph is not None:
        if role != "leader":
            raise InvalidParameter("--role", role, "", why="a node of a graph has its kind: leave --role out")
        code: int = extension("seats").device(graph, node, _over(params, model, links, "device"), side, zenoh)
        return code
    if role == "leader":
        return one_side("device", model, side, zenoh, links, params)
    if role != "follower":
        raise InvalidParameter("--role", role, "leader or follower")
    follows = replace(model, hardware=None, follower=model.hardware or "simulated")
    return one_side("world", follows, side, zenoh, links, params)


def world(
    *,
    model: Annotated[ModelOptions, Without("operator", "hardware", "servo", "servo_hz")],
    side: Annotated[SideFlags, Without("realtime")],
    zenoh: ZenohOptions,
    links: OneWay,
    params: ParamsOptions,
    graph: flags.Graph = None,
    node: flags.Node = None,
    seats: Annotated[
        str | None,
        typer.Option(metavar="N|NAMES", help="Several hands: 4, or names such as alice,bob (hapnet device --name)."),
    ] = None,
) -> int:
    over, code = _over(params, model, links, "world"), 0
    _check_several(graph, node, seats, side, params)
    if graph is not None:
        if seats is not None:
            raise InvalidParameter("--seats", seats, "", why="the graph has the seats: leave --seats out")
        code = extension("seats").world_of_graph(graph, node, over, side, zenoh)
    elif seats is not None:
        code = extension("seats").world_of_seats(seats, over, side, zenoh)
    else:
        code = one_side("world", model, side, zenoh, links, params)
    return code


def _check_several(
    graph: Path | None, node: str | None, seats: str | None, side: SideFlags, params: ParamsOptions
) -> None:
    """Raise InvalidParameter for a flag that a graph or seats leave without meaning, or --node without a graph."""
    if graph is None and node is not None:
        raise InvalidParameter("--node", node, "", why="it names a node of a graph; give --graph FILE.toml too")
    if graph is None and seats is None:
        return
    if params.show_params:
        why = "each pair has its own; leave --graph and --seats out"
        raise InvalidParameter("--show-params", "with several hands", "", why=why)
    if side.name != "device":
        why = "the graph, or --seats, names each device; leave --name out"
        raise InvalidParameter("--name", side.name, "", why=why)
    no_out_without_files(side.out, side.files)


def _over(params: ParamsOptions, model: ModelOptions, links: OneWay, role: Role) -> Callable[[Params], Params]:
    """The change of a pair's parameters by this command's flags. In a graph a link is the graph's."""

    def change(pair: Params) -> Params:
        bare = {name: text for name, text in NO_LINK.items() if not pair.asked(name)}
        return params.over(pair.set({**bare, **({} if pair.asked("duration_s") else {"duration_s": 0.0})}, COMMAND),
                           model.named(role), links)  # fmt: skip

    return change


def one_side(
    role: Role, model: ModelOptions, side: SideFlags, zenoh: ZenohOptions, links: OneWay, params: ParamsOptions
) -> int:
    """`hapnet device` or `hapnet world`; returns the exit code."""
    chosen = params.over(Params().set({**NO_LINK, "duration_s": 0.0}, COMMAND), model.named(role), links)
    if params.show_params:
        return params.show(chosen)
    no_out_without_files(side.out, side.files)
    from hapnet.commands import known_devices, output
    from hapnet.commands.side import main

    if role == "device":
        chosen = known_devices.introduced(chosen, output.asker())
    return main(role, chosen, side, zenoh)
