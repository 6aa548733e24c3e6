"""Measures the cost of one call: subject and reference take turns, so that a disturbance affects both."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable

from hapnet.ext.bench.row import Distribution, Options

_TURN = 50  # calls in one turn
_SHARE = 0.1  # of a round's length: costs vary less than lateness does


class Call:
    """Something to time: `prepare` runs before each call, untimed."""

    def __init__(self, call: Callable[[], object], prepare: Callable[[], object] | None = None) -> None:
        self.call: Callable[[], object] = call
        self.prepare: Callable[[], object] | None = prepare

    def turn(self, into: list[int]) -> None:
        call, prepare, clock = self.call, self.prepare, time.perf_counter_ns
        for _ in range(_TURN):
            if prepare is not None:
                prepare()
            began = clock()
            call()
            into.append(clock() - began)


def cost(subject: Call, reference: Call, options: Options) -> tuple[list[Distribution], list[Distribution]]:
    """Microseconds per call, one distribution for each round."""
    rounds: tuple[list[Distribution], list[Distribution]] = ([], [])
    automatic = gc.isenabled()
    try:
        for _ in range(options.rounds):
            gc.collect()
            gc.disable()
            for call in (subject, reference):
                call.turn([])  # warm
            times: tuple[list[int], list[int]] = ([], [])
            end = time.perf_counter() + _SHARE * options.seconds
            while time.perf_counter() < end or not times[0]:
                subject.turn(times[0])
                reference.turn(times[1])
            for kept, measured in zip(rounds, times, strict=True):
                kept.append(Distribution.of(measured, 1e-3))
    finally:
        if automatic:
            gc.enable()
    return rounds
