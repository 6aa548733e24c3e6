"""hapnet inside an asyncio program: while the world runs, another task monitors it and degrades its link.

python examples/asyncio_program.py
"""

from __future__ import annotations

import asyncio
import tempfile

from hapnet import ConnectedWorld, connect_device, connect_world

SETTINGS = {"scene": "wall", "operator": "press", "link.up": "wifi", "link.down": "delay 10ms"}


async def report_all(world: ConnectedWorld) -> None:
    """Print the world's events as they happen."""
    async for event in world.events():
        print(f"world: {event.text}")


async def report(world: ConnectedWorld, times: int) -> None:
    """Print a summary twice a second. Like every task, this one must not block the event loop."""
    for _ in range(times):
        await asyncio.sleep(0.5)
        now, sample = world.summary(), world.sample
        link, margin = now["links"]["down"], 0.0 if sample is None else sample.margin_J
        assert link is not None
        print(
            f"{now['duration_s']:.1f} s: delay up to {link['delay_p99_ms'] or 0.0:4.1f} ms (p99), "
            f"{link['lost']} of {link['offered']} messages lost, passivity margin now {1e3 * margin:.2f} mJ"
        )


async def main() -> None:
    with tempfile.TemporaryDirectory() as directory:
        endpoint = f"unixsock-stream/{directory}/world"  # between hosts: tcp/0.0.0.0:17447, and the device dials it
        async with connect_world(SETTINGS, listen=endpoint) as world:
            reporting = asyncio.create_task(report_all(world))
            async with connect_device(SETTINGS, connect=endpoint) as device:  # in the same program, as a demonstration
                await world.wait_paired()
                await report(world, 3)
                world.change_link("delay 50ms loss 5%")
                await report(world, 3)
        await reporting  # ends with the world's last event
    for role, own in (("world", world.summary()["world"]), ("device", device.summary()["device"])):
        assert own is not None
        print(f"{role}: energy sent {own['sent_nJ']} nJ, credited {own['credited_nJ']} nJ")


if __name__ == "__main__":
    asyncio.run(main())
