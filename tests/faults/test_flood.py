"""A stranger that sends as fast as it can: the pair goes on, the servo ticks, the log stays short."""

import sys
from pathlib import Path

import pytest

from hapnet.wire.messages import Role
from tests.conftest import mostly_slow
from tests.faults.support import pair
from tests.support.processes import Program

SECONDS = 3.0
ALLOWED_HZ, ALLOWED_AT_ONCE = 10_000, 2_000  # as the protocol's page says
ATTACK = """
import json, sys, time, zenoh
from hapnet.wire.messages import Energy, Hello, Position, encode
address, way, seconds = sys.argv[1], sys.argv[2], float(sys.argv[3])
config = zenoh.Config()
for key, value in (("connect/endpoints", [address]), ("listen/endpoints", []), ("scouting/multicast/enabled", False)):
    config.insert_json5(key, json.dumps(value))
session = zenoh.open(config)
here = "device" if way == "up" else "world"
frames = [b"garbage" * 400, encode(Position(77, 5, 0, (1e6,))), encode(Energy(77, 78, 2**62, 0)),
          encode(Hello(77, 1, here, 1, "me", {}))]
kinds = ("position", "position", "energy", "control")
publishers = [session.declare_publisher(f"hapnet/default/device/{way}/{kind}", express=True,
    congestion_control=zenoh.CongestionControl.DROP) for kind in kinds]
time.sleep(0.3)  # until it is known who listens
end, sent = time.monotonic() + seconds, 0
while time.monotonic() < end:
    for _ in range(50):
        for publisher, frame in zip(publishers, frames):
            publisher.put(frame)
        sent += len(frames)
print(sent)
session.close()
"""


@pytest.mark.parametrize(
    ("way", "more"), mostly_slow([("down", ("--realtime",)), ("up", ()), ("down", ()), ("up", ("--realtime",))], 0, 2)
)
def test_a_flood_does_not_keep_the_servo_from_its_work(way: str, more: tuple[str, ...], tmp_path: Path) -> None:
    """The device is hit (down), or the world is (up), and the flood takes a core."""
    hits: Role = "device" if way == "down" else "world"  # a stranger reaches only who listens
    with pair(tmp_path, device=("--operator", "sine", *more), listener=hits) as sides:
        sides.until_paired()
        attack = Program(sides.address, way, SECONDS, command=(sys.executable, "-c", ATTACK))
        try:
            code, out, errors = attack.end()
        finally:
            attack.kill()
        assert code == 0, errors
        sides.stop()
    sent = int(out)
    hit = sides.lives[hits][0]
    dropped = hit.summary[hits]["dropped"]
    print(f"{sent} sent, dropped: {dropped}")
    assert dropped["rival"] > 1_000
    assert dropped.get("flood", 0) >= sum(dropped.values()) - (ALLOWED_HZ * (SECONDS + 1.0) + ALLOWED_AT_ONCE)
    assert len(hit.said("dropped")) <= 5
    summary = sides.accounts()  # passive, and energy to the nanojoule
    servo = summary["device"]["servo"]
    print("servo:", {name: servo[name] for name in ("ticks", "skipped", "overruns", "late_p99_us", "longest_ms")})
    share = servo["skipped"] / (servo["ticks"] + servo["skipped"])
    assert share < 0.5  # the attacker takes a core, and other tests may run beside it; alone it is below 0.05
    assert summary["device"]["incarnations"] == summary["world"]["incarnations"] == 1
