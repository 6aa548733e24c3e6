"""The servo's lateness under load: a device and a world process over Zenoh, as `hapnet run` starts them.

Positions are sent at 1 kHz in each direction over an empty link, and both sides record. Meanwhile a bare deadline loop
runs in a process of its own with the same scheduling.
"""

from __future__ import annotations

import contextlib

from hapnet.ext.bench.row import Limit, Options, Row
from hapnet.ext.bench.servo import BARE, PERIOD_NS, Lateness, bare_loop, late_row
from hapnet.ext.bench.sides import lateness, start_pair
from hapnet.params import Params
from hapnet.processes.child import Child, busy

KILOHERTZ = {"world.step_min_s": 0.001, "world.step_max_s": 0.001, "device.pspm_period_s": 0.001}
LATE_EXCESS = 0.0003
"""The amount by which the share of ticks late by a period may exceed the bare loop's: 0.03 percentage points."""


RATES_KHZ = (2, 5, 10)
"""Faster rates of the servo that are measured too; positions are still sent at 1 kHz."""


def servo_traffic(options: Options, khz: int = 1) -> Row:
    """The lateness of the device's servo with 1 kHz in each direction and recording."""
    subject, bare = [], []
    rates: list[float] = []
    for _ in range(options.rounds):
        ours, theirs, rate = _round(options, khz)
        subject.append(ours)
        bare.append(theirs)
        rates.append(rate)
    what = "lateness with 1 kHz in each direction over Zenoh, both sides recording, from pairing"
    at = "" if khz == 1 else f", the servo at {khz} kHz"
    beside = f", beside {options.beside} busy processes" if options.beside else ""
    usual = Limit("ratio", 1.3), Limit("ratio_p99", 1.5 if options.realtime else 2.0)
    limits = {1: (*usual, Limit("late_period_excess", LATE_EXCESS)), 5: (Limit("ratio_p99", 2.0),)}
    name = "servo_traffic" if khz == 1 else f"servo_traffic_{khz}khz"
    against = BARE + ", same time, from pairing" + (", same rate" if at else "")
    note = f"{min(rates):.0f} messages/s in the slower direction"
    more = {"messages_per_s": min(rates)}
    return late_row(name, what + at + beside, subject, against, bare, more, limits.get(khz, ()), note)


def _round(options: Options, khz: int) -> tuple[Lateness, Lateness, float]:
    """Lateness of the servo and of the bare loop, and the slower direction's messages a second."""
    seconds, period_ns = options.seconds, PERIOD_NS // khz
    with contextlib.ExitStack() as stack:
        stack.enter_context(busy(options.beside))
        loop = stack.enter_context(Child(bare_loop, seconds, options.realtime, period_ns))
        loop.wait_ready()
        own = {"link.up": "", "link.down": "", "duration_s": seconds, "device.servo_hz": 1e9 / period_ns}
        params = Params().set({**KILOHERTZ, **own})
        device, world = start_pair(stack, params, realtime=options.realtime)
        loop.go()
        bare = loop.result(seconds + 30.0)
        summaries = [side.summary(seconds + 30.0) for side in (device, world)]
    # the uplink's count includes a few energy messages; the world sends one position per step
    sent = (summaries[0]["links"]["up"]["offered"], summaries[1]["world"]["step"]["count"])
    rate = min(count / summary["duration_s"] for count, summary in zip(sent, summaries, strict=True))
    return lateness(summaries[0], device, period_ns), bare, rate
