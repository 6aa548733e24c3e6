"""A world on one host and a device on another. The world listens, the device connects; start them in either order.

python examples/two_hosts.py world                          # on 192.168.0.2; Ctrl-C ends a side
python examples/two_hosts.py device 192.168.0.2             # on the other one
python examples/two_hosts.py                                # both on this machine, through an emulated link

Anyone who reaches the port may connect; "Who may connect" in hapnet/transport/README.md explains how to restrict this.
"""

from __future__ import annotations

import argparse
import asyncio
import signal
import subprocess
import sys
from typing import Literal

from hapnet import Params, RealtimeSide, ZenohSettings, prepare


async def run(role: Literal["world", "device"], endpoint: str, link: str) -> None:
    """Run one side until its time is over or a signal stops it, then print its result."""
    params = Params().set({"scene": "wall", "operator": "sine", "link.up": link, "link.down": link})
    stop, at = asyncio.Event(), (endpoint,)
    zenoh = ZenohSettings(listen=at) if role == "world" else ZenohSettings(connect=at)
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    print(f"{role}: {endpoint}", flush=True)
    summary = await RealtimeSide(prepare(params), role, zenoh).run(stop, 3.0)  # seconds from pairing; 0: no end
    own, sends = summary[role], summary["links"]["down" if role == "world" else "up"]
    if summary["duration_s"] is None or own is None or sends is None:
        sys.exit(f"{role}: no peer came")
    half = own["ledger"]
    print(
        f"{role}: {summary['duration_s']:.1f} s, emulated delay {sends['delay_p50_ms'] or 0.0:.1f} ms, "
        f"gave out at most {1e3 * (half['energy_out_J'] or 0):.2f} of {1e3 * (half['bound_J'] or 0):.2f} mJ, "
        f"energy sent {own['sent_nJ']} nJ, credited {own['credited_nJ']} nJ"
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("role", nargs="?", choices=("world", "device"))
    parser.add_argument("host", nargs="?", default="0.0.0.0", help="the world's address")
    parser.add_argument("--port", type=int, default=17447)
    parser.add_argument("--link", default="ideal", help="emulated besides the real link: tc-netem syntax or a profile")
    if (given := parser.parse_args()).role is not None:
        return asyncio.run(run(given.role, f"tcp/{given.host}:{given.port}", given.link))
    words = "127.0.0.1", "--port", str(given.port), "--link", "delay 20ms 5ms loss 1%"
    world, device = (subprocess.Popen([sys.executable, __file__, role, *words]) for role in ("world", "device"))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both, and ends them
    if world.wait():
        device.terminate()
    sys.exit(device.wait() or world.returncode)


if __name__ == "__main__":
    main()
