"""`hapnet bridge`: publishes a running pair on the topics of ROS 2."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack
from typing import Annotated

import typer

from hapnet.commands import complete, flags, output
from hapnet.commands.options import ZenohOptions
from hapnet.errors import InvalidParameter, TransportError
from netem.groups import Without

LOOK_S = 0.1
AGAIN_S = 1.0


def bridge(
    to: Annotated[
        str,
        typer.Argument(metavar="ros2", help="Where to publish: ros2.", autocompletion=complete.words("ros2")),
    ],
    *,
    session: Annotated[str | None, typer.Option(help="Name of the session.", show_default="the first heard")] = None,
    name: Annotated[str | None, typer.Option(help="Name of the device.", show_default="the first heard")] = None,
    router: Annotated[
        str, typer.Option(metavar="ENDPOINT", help="Of ROS 2: where `ros2 run rmw_zenoh_cpp rmw_zenohd` listens.")
    ] = "tcp/localhost:7447",
    domain: Annotated[int | None, typer.Option(help="Domain of ROS 2.", show_default="ROS_DOMAIN_ID, or 0")] = None,
    namespace: Annotated[str, typer.Option(help="Of the topics, such as /left.")] = "/",
    duration: Annotated[float, typer.Option(help="Seconds; 0: until Ctrl-C.")] = 0.0,
    zenoh: Annotated[ZenohOptions, Without("users", "mutual_tls", "encrypt")],
    json_to: flags.Json = None,
) -> int:
    """Poses, twists, wrenches, joint states and diagnostics, as `hapnet view` would show them. It only watches; the
    other direction is a device or robot: --device ros2:/target_pose, --follower
    ros2:/current_pose,command=/target_wrench.
    """
    from hapnet import checks
    from hapnet.commands.side import zenoh_settings
    from hapnet.ext.page.ros2 import RosBridge
    from hapnet.ext.page.watcher import Watcher
    from hapnet.transport.ros2 import RosNode

    if to != "ros2":
        raise InvalidParameter("bridge", to, "ros2", ("ros2",))
    checks.non_negative("--duration", duration)
    words = output.console(json_to)
    node = RosNode("hapnet_bridge", namespace=namespace, domain=_domain(domain), router=router)
    bridged = RosBridge(node.types.classes, node.publish, namespace, node.wall_ns)
    watcher = Watcher(zenoh_settings(zenoh), bridged.take, session=session, name=name)
    end_s = time.monotonic() + (duration or float("inf"))
    shown = ""
    with ExitStack() as closing:
        closing.callback(node.close)
        closing.callback(watcher.close)
        while time.monotonic() < end_s:
            try:
                node.open()
                break
            except TransportError as error:
                if str(error) != shown:
                    words.print(f"{error}; trying again", markup=False)
                shown = str(error)
                time.sleep(AGAIN_S)
        watcher.open()
        while time.monotonic() < end_s:
            bridged.publish_next(LOOK_S)
            if watcher.pair is None:
                text = f"waiting for a pair's telemetry: {watcher.where} {watcher.problem}".rstrip()
            else:
                text = "session {} of device {}".format(*watcher.pair) + f" is on ROS 2's domain {node.domain}"
            if text != shown:
                words.print(text, markup=False)
                shown = text
    output.write_json({"published": bridged.published, "dropped": bridged.dropped}, json_to)
    return 0


def _domain(given: int | None) -> int:
    """The domain of ROS 2: as given, or from the environment."""
    if given is not None:
        return given
    value = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not value.isdecimal():
        raise InvalidParameter("ROS_DOMAIN_ID", value, "a whole number")
    return int(value)
