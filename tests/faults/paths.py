"""What `path` says of a network, beside what irtt and the network itself say; and what each transport makes of loss.

``python -m tests.faults.paths --seconds 60`` starts a pair in two network namespaces, for each transport and each
profile of the cable between them, with irtt on the same cable. Only for root, on a machine with nothing else to do.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from examples.secure.make_certificates import main as make_certificates
from tests.faults.namespaces import Host, two_hosts
from tests.processes import HAPNET, Program

PROFILES = ("delay 5ms", "delay 40ms 10ms", "delay 40ms 10ms loss 5%", "delay 40ms 10ms loss 15%",
            "delay 100ms 30ms", "delay 150ms 10ms loss 15%")  # fmt: skip
TRANSPORTS = ("tcp", "udp", "udp --encrypt", "quic", "quic mixed_rel")
PORT = 17447
SLOW_TO_OPEN = ("--cfg", "transport/unicast/open_timeout:10000", "--cfg", "transport/unicast/accept_timeout:10000")


def flags(transport: str, role: str, directory: Path) -> list[str]:
    """The flags of one side for this transport."""
    protocol, _, more = transport.partition(" ")
    address = f"{protocol}/10.117.0.1:{PORT}" + ("?mixed_rel=1" if more == "mixed_rel" else "")
    found = ["-l" if role == "world" else "-e", address, *SLOW_TO_OPEN]
    if more.startswith("--"):
        found.append(more)
    if protocol == "quic":
        if not (directory / "ca.pem").exists():
            make_certificates(device=["alice"], host=["10.117.0.1"], out=directory)
        stem = directory / ("world" if role == "world" else "alice")
        found += ["--tls-ca", f"{directory / 'ca.pem'}", "--tls-cert", f"{stem}.pem", "--tls-key", f"{stem}.key"]
        found += ["--mutual-tls"] if role == "world" else []
    return found


def measured_by_irtt(server: Host, client: Host, seconds: float) -> subprocess.Popen[bytes]:
    """Start irtt's client, 100 packets a second; its report is on standard output."""
    command = ["irtt", "client", "-i", "10ms", "-d", f"{seconds}s", "-Q", "-o", "-", server.address]
    return subprocess.Popen([*client.enter, *command], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)


def one(transport: str, profile: str, seconds: float, seed: int, more: list[str]) -> dict[str, Any]:
    """One run: what the device's side says of the path, what the world's says, and irtt's report."""
    with tempfile.TemporaryDirectory() as name, two_hosts(profile, seed) as (a, b):
        directory = Path(name)
        server = subprocess.Popen([*a.enter, "irtt", "server"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        sides = {
            role: Program(
                role,
                *flags(transport, role, directory / "certificates"),
                "--duration",
                seconds,
                "--seed",
                seed,
                "--no-files",
                "--json",
                directory / f"{role}.json",
                *more,
                command=(*host.enter, *HAPNET),
            )
            for role, host in (("world", a), ("device", b))
        }
        try:
            sides["device"].until(
                "pairing", lambda: any("paired" in line for line in sides["device"].err + sides["device"].out)
            )
            time.sleep(3.0)
            probe = measured_by_irtt(a, b, seconds - 8.0)
            report = json.loads(probe.communicate(timeout=seconds + 60.0)[0])
            for side in sides.values():
                side.process.wait(seconds + 60.0)
            found = {role: json.loads((directory / f"{role}.json").read_text()) for role in sides}
        finally:
            server.terminate()
            server.wait()
            for side in sides.values():
                side.process.kill()
    found["irtt"] = report["stats"]
    return found


def row(found: dict[str, Any]) -> dict[str, Any]:
    """The figures of one run, in ms and percent."""
    path, irtt = found["device"]["path"], found["irtt"]
    up, down = found["world"]["path"]["up"], path["down"]
    return {
        "round trip": path["round_trip_p50_ms"],
        "irtt's": irtt["rtt"]["median"] * 1e-6,
        "lost up": 100.0 * up["loss"],
        "irtt's up": irtt["upstream_loss_percent"],
        "lost down": 100.0 * down["loss"],
        "irtt's down": irtt["downstream_loss_percent"],
        "age p99 up": up["age_p99_ms"],
        "age p99 down": down["age_p99_ms"],
        "silence": max(up["longest_stall_ms"] or 0.0, down["longest_stall_ms"] or 0.0),
        "verdict": found["device"]["verdict"]["passive"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--transport", action="append", choices=TRANSPORTS)
    parser.add_argument("--profile", action="append")
    parser.add_argument("more", nargs="*", help="behind --: flags for both sides")
    given = parser.parse_args()
    head = None
    for profile in given.profile or PROFILES:
        for transport in given.transport or TRANSPORTS:
            rows = []
            for number in range(given.rounds):
                try:
                    rows.append(row(one(transport, profile, given.seconds, number + 1, given.more)))
                except (AssertionError, KeyError, TypeError, subprocess.TimeoutExpired) as error:
                    what = " ".join(str(error).split())
                    print(f"| {profile} | {transport} | {type(error).__name__}: {what} |", flush=True)
            if not rows:
                continue
            if head is None:
                head = list(rows[0])
                print("| below | transport | " + " | ".join(head) + " |\n|" + "---|" * (len(head) + 2), flush=True)
            cells = []
            for name in head:
                values = [each[name] for each in rows]
                numbers = [value for value in values if isinstance(value, int | float) and not isinstance(value, bool)]
                cells.append(f"{statistics.median(numbers):.1f}" if numbers else str(values))
            print(f"| {profile} | {transport} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
