"""What several benchmarks start from: endpoints that are paired in memory, and an address nobody uses."""

from __future__ import annotations

import socket

from hapnet.endpoint import Endpoint
from hapnet.wire.session import Session


def pair(device: Session | Endpoint, world: Session | Endpoint) -> None:
    """Hand each side's greetings to the other until neither has any."""
    for _ in range(4):
        for sender, receiver in ((device, world), (world, device)):
            for message in sender.poll(0)[0]:
                receiver.receive(0, message.data)


def free_address() -> str:
    """A Zenoh endpoint on this machine."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"
