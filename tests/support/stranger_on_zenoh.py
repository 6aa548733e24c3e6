"""The stranger on a true network: `python -m tests.support.stranger_on_zenoh ENDPOINT '{"early_nJ": 40000000}'`.

He says "ready" once he is connected to the world's endpoint, and at SIGTERM or SIGINT what came of it. Over udp
Zenoh may not close then, as the world is gone: kill him.
"""

from __future__ import annotations

import json
import queue
import signal
import sys
import threading
import time
from functools import partial

import zenoh

from hapnet.transport.entities import KINDS, direct, publisher
from hapnet.wire.control_sender import Outgoing
from hapnet.wire.messages import Role
from tests.support.stranger import Plan, Stranger

DIRECTION: dict[Role, str] = {"device": "up", "world": "down"}
KEY = "hapnet/default/device"


def main(endpoint: str, plan: Plan) -> None:
    config = zenoh.Config()
    for name, value in (
        ("mode", "client"), ("connect/endpoints", [endpoint]), ("scouting/multicast/enabled", False),
    ):  # fmt: skip
        config.insert_json5(name, json.dumps(value))
    ended = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ended.set())
    with zenoh.open(config) as session:
        ways = {(role, kind): publisher(session, f"{KEY}/{way}/{kind}", kind)
                for role, way in DIRECTION.items() for kind in KINDS}  # fmt: skip
        heard: queue.SimpleQueue[tuple[Role, bytes]] = queue.SimpleQueue()

        def hear(role: Role, sample: zenoh.Sample) -> None:
            heard.put((role, bytes(sample.payload)))

        subscribers = [
            session.declare_subscriber(
                f"{KEY}/{way}/{kind}", direct(partial(hear, role)), allowed_origin=zenoh.Locality.REMOTE
            )
            for role, way in DIRECTION.items() for kind in KINDS
        ]  # fmt: skip

        def say(role: Role, frames: list[Outgoing]) -> None:
            for frame in frames:
                ways[role, frame.kind].put(frame.data)

        stranger = Stranger(plan, say)
        print("ready", flush=True)
        while not ended.is_set():
            try:
                sender, data = heard.get(timeout=0.001)
                if data:  # a keep-alive is empty
                    stranger.hear(sender, data, time.monotonic_ns())
            except queue.Empty:
                pass
            stranger.speak(time.monotonic_ns())
        print(json.dumps({"heard": sorted(stranger.faces), "believed": sorted(stranger.believed)}), flush=True)
        for subscriber in subscribers:
            subscriber.undeclare()


if __name__ == "__main__":
    main(sys.argv[1], Plan(**json.loads(sys.argv[2])))
