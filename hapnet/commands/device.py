"""`hapnet device` and `hapnet world`: one side in this process."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from hapnet.commands import complete
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
) -> int:
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
) -> int:
    return one_side("world", model, side, zenoh, links, params)


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
