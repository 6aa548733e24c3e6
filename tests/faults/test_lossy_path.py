"""Both sides on hosts of their own, and packets lost below the transport: what TCP, UDP and QUIC make of it is real."""

from functools import partial
from pathlib import Path

import pytest

from examples.secure.make_certificates import main as make_certificates
from hapnet.errors import RecordingError
from hapnet.recording.mcap import read_recording
from hapnet.wire.messages import Role
from tests.conftest import mostly_slow
from tests.faults.support import Side
from tests.faults.test_namespaces import BLOCKED_MS, LITTLE, assert_all_credited, joined
from tests.support.processes import assert_side_passive

LOSSY = "delay 40ms 10ms loss 5%"
ROLES: tuple[Role, Role] = ("world", "device")


def secured(directory: Path, role: Role) -> tuple[str, ...]:
    """What quic needs: flags for certificates that are made at the first call."""
    if not directory.exists():
        make_certificates(device=["alice"], host=["10.117.0.1"], out=directory)
    stem = directory / ("world" if role == "world" else "alice")
    flags = ("--tls-ca", f"{directory / 'ca.pem'}", "--tls-cert", f"{stem}.pem", "--tls-key", f"{stem}.key")
    return (*flags, *(("--mutual-tls",) if role == "world" else ()))


def has_credited(side: Side) -> bool:
    try:
        recording = read_recording(side.recording)
    except RecordingError:  # nothing there yet
        return False
    columns = recording.device or recording.world
    return columns is not None and bool(columns["credited_J"][-1] > 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("protocol", mostly_slow(["udp", "tcp", "quic"], 0, 2))
def test_packets_are_lost_below_the_transport(protocol: str, tmp_path: Path) -> None:
    """Nothing is lost for good, the servo never waits, and both sides keep their half of the theorem."""
    with joined(tmp_path, protocol, cable=LOSSY) as pair:
        sides = [
            pair.start(role, *LITTLE, *(secured(tmp_path / "certificates", role) if protocol == "quic" else ()))
            for role in ROLES
        ]
        for side in sides:
            side.until_said("paired")
        for side in sides:
            side.until("energy from the other side", partial(has_credited, side))
        world, device = pair.stop()
    assert_all_credited(world, device)
    for end in (world, device):
        assert_side_passive(end)
        assert end["incarnations"] == 1
    assert device["servo"]["longest_ms"] < BLOCKED_MS
