"""`hapnet devices` and `hapnet emulate`: their flags. What they do is imported on demand."""

from __future__ import annotations

from typing import Annotated

import typer

from hapnet.commands import flags
from hapnet.commands.groups import Without, grouped
from hapnet.commands.options import ParamsOptions, json_target
from hapnet.params import Params


def devices(json_to: flags.Json = None) -> int:
    """List the devices that can be given to --device, what was found of each, and what is missing for it."""
    json_target(json_to)
    from hapnet.commands import emulating

    return emulating.show_devices(json_to)


@grouped
def emulate(
    *,
    device: Annotated[
        str, typer.Argument(metavar="NAME[:OPTIONS]", help="A device of `hapnet devices`, such as serial:noise=0.01.")
    ],
    operator: flags.Operator = None,
    duration: Annotated[float, typer.Option(help="Seconds; 0: until Ctrl-C.")] = 0.0,
    params: Annotated[ParamsOptions, Without("show_params", "schema")],
    json_to: flags.Json = None,
) -> int:
    """Stand in for a device: speak its protocol, with a simulated hand on the handle, in a process of its own.

    It says how to reach it, and at its end how much energy its actuators gave to the hand.
    """
    json_target(json_to)
    from hapnet.commands import emulating

    return emulating.emulate(device, params.over(Params(), {"operator": operator}), duration, json_to)
