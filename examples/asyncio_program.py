"""hapnet inside an asyncio program that does other things too: beside the world, a task watches it and spoils its link.

python examples/asyncio_program.py
"""

from __future__ import annotations

import asyncio
import tempfile

from hapnet import Notice, Params, RealtimeSide, ZenohSettings, prepare

GOOD, BAD = "delay 10ms", "delay 50ms loss 5%"  # from the world to the device


async def report(world: RealtimeSide, times: int) -> None:
    """The program's own task; like any, it must not keep the loop busy."""
    for _ in range(times):
        await asyncio.sleep(0.5)
        now = world.summary()
        link, margin = now["links"]["down"], now["world"]["ledger"]["margin_end_J"]
        print(
            f"{now['duration_s']:.1f} s: delay up to {link['delay_p99_ms'] or 0.0:4.1f} ms (p99), "
            f"{link['lost']} of {link['offered']} messages lost, passivity margin now {1e3 * margin:.2f} mJ"
        )


async def main() -> None:
    setup = prepare(Params().set({"scene": "wall", "operator": "press", "link.up": "wifi", "link.down": GOOD}))
    paired, stop = asyncio.Event(), asyncio.Event()

    def tell(notice: Notice) -> None:
        """What happens at the world, as it happens; called on the event loop."""
        if notice.kind == "paired":
            paired.set()
        if notice.kind != "progress":
            print(f"world: {notice.text}")

    with tempfile.TemporaryDirectory() as directory:
        endpoint = (f"unixsock-stream/{directory}/world",)  # between hosts: tcp/0.0.0.0:17447, and the device dials it
        world = RealtimeSide(setup, "world", ZenohSettings(listen=endpoint), notify=tell)
        device = RealtimeSide(setup, "device", ZenohSettings(connect=endpoint))  # here too, so that this can be tried
        async with asyncio.TaskGroup() as group:  # if one fails, all end
            sides = {side.role: group.create_task(side.run(stop, 0.0)) for side in (world, device)}
            await paired.wait()
            await report(world, 3)
            world.change_link(BAD)
            await report(world, 3)
            stop.set()  # no force any more; energy in flight is waited for; then both tasks end
    for role, side in sides.items():
        own = side.result()[role]
        print(f"{role}: energy sent {own['sent_nJ']} nJ, credited {own['credited_nJ']} nJ")


if __name__ == "__main__":
    asyncio.run(main())
