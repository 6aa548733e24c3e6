"""A device that answers until it shall render a force, and then no more."""

import pytest

from hapnet.assembly.build import device_session, device_side, prepare
from hapnet.errors import HapnetError
from hapnet.side.endpoint import DeviceEndpoint
from hapnet.side.real_device import RealDeviceSide
from hapnet.side.real_device_state import FIRST_READING_S
from tests.support.paper import PAPER

MS = 1_000_000


def test_a_device_that_is_silent_from_its_first_force_on_fails_and_the_line_says_what_is_missing() -> None:
    """Its first readings came, before it had a force to render; a silence before that may last."""
    setup, now_ns = prepare(PAPER.set({"hardware": "tests.side.test_real_device:Arm", "scene": "free"})), 0
    side = device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: now_ns, lambda sample: None)
    assert isinstance(side, RealDeviceSide)
    arm = side.device.device
    side.tick(now_ns)
    arm.silent = True  # type: ignore[attr-defined]
    for now_ns in range(0, round(3 * FIRST_READING_S * 1e9), 100 * MS):
        side.tick(now_ns)
    arm.silent = False  # type: ignore[attr-defined]
    side.endpoint.paired = True
    for _ in range(3):
        now_ns += 2 * MS
        side.tick(now_ns)
    assert side.origin_ns is None, "the handle is still pushed"
    arm.silent, heard_ns = True, now_ns  # type: ignore[attr-defined]
    while now_ns < heard_ns + round(FIRST_READING_S * 1e9) - 100 * MS:
        now_ns += 100 * MS
        side.tick(now_ns)
    now_ns += 200 * MS
    with pytest.raises(HapnetError, match="Arm failed: no reading for 10 s, and the force had not begun: no answer"):
        side.tick(now_ns)
