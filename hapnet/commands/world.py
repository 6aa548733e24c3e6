"""`hapnet world`: one side in this process."""

from __future__ import annotations

from typing import Annotated

from hapnet.commands.device import one_side
from hapnet.commands.options import ModelOptions, OneWay, ParamsOptions, SideFlags, ZenohOptions
from netem.groups import Without


def world(
    *,
    model: Annotated[ModelOptions, Without("operator", "hardware", "servo", "servo_hz")],
    side: Annotated[SideFlags, Without("realtime")],
    zenoh: ZenohOptions,
    links: OneWay,
    params: ParamsOptions,
) -> int:
    return one_side("world", model, side, zenoh, links, params)
