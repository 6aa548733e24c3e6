"""What `path` says of a network, beside what irtt says of it; and what each transport makes of loss.

``python -m tests.faults.paths --seconds 60`` starts a pair in two network namespaces, for each transport and each
profile of the cable between them, with irtt on the same cable at the same time. With ``--check`` it names what misses
a limit, and ends with exit code 1 if anything does:

* Loss, there and back, is irtt's within a point, beyond what chance does to samples of that size. A transport that
  repeats what is lost loses nothing. (How irtt's loss splits into the two ways is wrong where packets overtake.)
* A tcp or quic that jams, and is silent for a second, is shown and not judged: Zenoh drops messages at their sender
  then, which looks like loss.
* The median of round trips is irtt's within 5 %. Where something is lost or jitters that holds of udp only: tcp and
  quic wait for what they repeat, and quic holds datagrams back too, so that a message really takes longer than irtt's.
* Encrypted by hapnet, at 15 % loss, nothing is silent for 0.5 s, and the age's p99 is below 1.5 times udp's.

Only for root, on a machine with nothing else to do.
"""

import argparse
import contextlib
import json
import math
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from examples.secure.make_certificates import main as make_certificates
from hapnet.transport.sampled import SPACING_S
from tests.faults.namespaces import Host, two_hosts
from tests.support.processes import HAPNET, Program

PROFILES = ("delay 5ms", "delay 40ms 10ms", "delay 40ms 10ms loss 5%", "delay 40ms 10ms loss 15%",
            "delay 100ms 30ms", "delay 150ms 10ms loss 15%")  # fmt: skip
TRANSPORTS = ("tcp", "udp", "udp --encrypt", "quic", "quic mixed_rel")
CHANNELS = {"udp": 8, "udp --encrypt": 8, "quic mixed_rel": 2}
"""Of the transports that repeat nothing: how many channels their sample has (hapnet/transport/sampled.py)."""
JAMMED_MS = 1000.0
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


def measured_by_irtt(server: Host, client: Host, seconds: float) -> dict[str, Any]:
    """What irtt's client reports of 100 packets a second."""
    command = [*client.enter, "irtt", "client", "-i", "10ms", "-d", f"{seconds}s", "-Q", "-o", "-", server.address]
    said = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=seconds + 60.0).stdout
    return json.loads(said)["stats"]


def one(transport: str, profile: str, seconds: float, seed: int, more: list[str]) -> dict[str, Any]:
    """One run: what the device's side says of the path, what the world's says, and irtt's report."""
    with contextlib.ExitStack() as stack:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        a, b = stack.enter_context(two_hosts(profile, seed))
        server = subprocess.Popen([*a.enter, "irtt", "server"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        stack.enter_context(server)
        stack.callback(server.terminate)
        sides = {}
        for role, host in (("world", a), ("device", b)):
            words = [role, *flags(transport, role, directory / "certificates"), "--duration", seconds, "--seed", seed]
            words += ["--no-files", "--json", directory / f"{role}.json", *more]
            sides[role] = stack.enter_context(Program(*words, command=(*host.enter, *HAPNET)))
        device = sides["device"]
        device.until("pairing", lambda: any("paired" in line for line in device.err + device.out))
        time.sleep(3.0)
        report = measured_by_irtt(a, b, seconds - 8.0)
        for side in sides.values():
            side.process.wait(seconds + 60.0)
        return {"irtt": report} | {role: json.loads((directory / f"{role}.json").read_text()) for role in sides}


def row(found: dict[str, Any]) -> dict[str, Any]:
    """The figures of one run, in ms and percent."""
    path, irtt = found["device"]["path"], found["irtt"]
    up, down = found["world"]["path"]["up"], path["down"]
    return {
        "round trip": path["round_trip_p50_ms"],
        "irtt's": irtt["rtt"]["median"] * 1e-6,
        "sent up": up["sent"],
        "lost up": 100.0 * up["loss"],
        "sent down": down["sent"],
        "lost down": 100.0 * down["loss"],
        "lost": 100.0 * (1.0 - (1.0 - up["loss"]) * (1.0 - down["loss"])),
        "irtt's lost": irtt["packet_loss_percent"],
        "age p99 up": up["age_p99_ms"],
        "age p99 down": down["age_p99_ms"],
        "silence": max(up["longest_stall_ms"] or 0.0, down["longest_stall_ms"] or 0.0),
        "verdict": found["device"]["verdict"]["passive"],
    }


def misses(profile: str, transport: str, cells: dict[str, Any], seconds: float, udp: dict[str, Any]) -> list[str]:
    """The figures that miss a limit, in words. udp : the cells of plain udp over the same cable; empty: not known."""
    found: list[str] = []
    if not transport.startswith("udp") and cells["silence"] >= JAMMED_MS:
        return found
    lost, known, chance = cells["lost"], 0.0, 0.0
    if transport in CHANNELS:
        known = cells["irtt's lost"]
        counts = [min(cells[f"sent {way}"], seconds * CHANNELS[transport] / SPACING_S) for way in ("up", "down")]
        chance = 3.0 * math.sqrt(
            known * (100.0 - known) * (0.5 * sum(1.0 / n for n in counts) + 0.01 / (seconds - 8.0))
        )
    if abs(lost - known) > 1.0 + chance:
        found.append(f"lost {lost:.1f} %, and not {known:.1f} within {1.0 + chance:.1f}")
    trip, known = cells["round trip"], cells["irtt's"]
    if abs(trip / known - 1.0) > 0.05 and (transport.startswith("udp") or len(profile.split()) == 2):
        found.append(f"round trip {trip:.1f} ms, and not {known:.1f} within 5 %")
    if "loss 15%" in profile and transport == "udp --encrypt":
        if cells["silence"] >= 500.0:
            found.append(f"silent for {cells['silence']:.0f} ms, and not below 500")
        older = [name for name in ("age p99 up", "age p99 down") if udp and cells[name] >= 1.5 * udp[name]]
        found += [f"{name} {cells[name]:.0f} ms, and not below 1.5 times {udp[name]:.0f}" for name in older]
    if cells["verdict"] is not True:
        found.append(f"verdict {cells['verdict']}, and not passive")
    return found


def several(transport: str, profile: str, given: argparse.Namespace) -> dict[str, Any]:
    """The median figures of the rounds; a run that fails counts as none."""
    rows = []
    for number in range(given.rounds):
        try:
            rows.append(row(one(transport, profile, given.seconds, number + 1, given.more)))
        except (AssertionError, KeyError, TypeError, ValueError, subprocess.TimeoutExpired) as error:
            print(f"{profile}, {transport}: {type(error).__name__}: {' '.join(str(error).split())}", file=sys.stderr)
    cells = {name: statistics.median(each[name] for each in rows) for name in rows[0]} if rows else {}
    if cells:
        cells["verdict"] = all(each["verdict"] for each in rows)
    return cells


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--transport", action="append", choices=TRANSPORTS)
    parser.add_argument("--profile", action="append")
    parser.add_argument("--check", action="store_true", help="name what misses a limit; exit code 1 if anything does")
    parser.add_argument("more", nargs="*", help="behind --: flags for both sides")
    given = parser.parse_args()
    missed, head = [], False
    for profile in given.profile or PROFILES:
        udp: dict[str, Any] = {}
        for transport in given.transport or TRANSPORTS:
            cells = several(transport, profile, given)
            if not cells:
                missed.append(f"{profile}, {transport}: no run came to its end")
                continue
            udp = cells if transport == "udp" else udp
            missed += [
                f"{profile}, {transport}: {what}" for what in misses(profile, transport, cells, given.seconds, udp)
            ]
            if not head:
                head = True
                print("| below | transport | " + " | ".join(cells) + " |\n|" + "---|" * (len(cells) + 2))
            shown = " | ".join(str(cell) if isinstance(cell, bool | int) else f"{cell:.1f}" for cell in cells.values())
            print(f"| {profile} | {transport} | {shown} |", flush=True)
    if given.check:
        print("\n".join(missed) or "nothing misses a limit")
    return int(given.check and bool(missed))


if __name__ == "__main__":
    sys.exit(main())
