"""Endpoints that are paired in memory: several benchmarks start from them."""

from __future__ import annotations

from hapnet.side.endpoint import Endpoint
from hapnet.wire.session import Session


def pair(device: Session | Endpoint, world: Session | Endpoint) -> None:
    """Hand each side's hellos and welcomes to the other until neither has any left."""
    for _ in range(4):
        for sender, receiver in ((device, world), (world, device)):
            for message in sender.poll(0)[0]:
                receiver.receive(0, message.data)
