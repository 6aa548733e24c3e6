"""The thread that steps the world: each length is kept, and an error ends it."""

import threading
import time

from hapnet.realtime.servo import Stepper
from tests.support.pairs import WAIT_S


class Steps:
    """A step function with lengths given, which remembers when it was called."""

    def __init__(self, lengths_ns: list[int], then: BaseException | None = None) -> None:
        self.called_ns: list[int] = []
        self.done = threading.Event()
        self.error: BaseException | None = None
        self._lengths, self._then = iter(lengths_ns), then

    def step(self, now_ns: int) -> int:
        self.called_ns.append(now_ns)
        length = next(self._lengths, None)
        if length is None:
            self.done.set()
            if self._then is not None:
                raise self._then
            return 1_000_000
        return length

    def on_error(self, error: BaseException) -> None:
        self.error = error
        self.done.set()


def test_stepper_keeps_each_length_it_is_told() -> None:
    lengths = [3_000_000, 1_000_000, 7_000_000, 2_000_000]
    steps = Steps(lengths)
    stepper = Stepper(steps.step, steps.on_error, time.monotonic_ns)
    stepper.start()
    assert steps.done.wait(WAIT_S)
    stepper.stop()
    gaps = [b - a for a, b in zip(steps.called_ns, steps.called_ns[1:], strict=False)]
    assert all(gap >= length for gap, length in zip(gaps, lengths, strict=False))
    assert steps.error is None
    assert not stepper._thread.is_alive()  # stop has waited for it


def test_a_late_step_is_followed_by_a_whole_one_and_no_burst() -> None:
    """The clock jumps by a second during the first step: the next deadline counts from when a step was made."""
    jump = 0
    lengths = [1_000_000, 2_000_000, 2_000_000]
    steps = Steps(lengths)

    def clock() -> int:
        return time.monotonic_ns() + jump

    def step(now_ns: int) -> int:
        nonlocal jump
        length = steps.step(now_ns)
        jump = 1_000_000_000
        return length

    stepper = Stepper(step, steps.on_error, clock)
    stepper.start()
    assert steps.done.wait(WAIT_S)
    stepper.stop()
    gaps = [b - a for a, b in zip(steps.called_ns, steps.called_ns[1:], strict=False)]
    assert gaps[0] >= 1_000_000_000
    assert all(gap >= 2_000_000 for gap in gaps[1:3])


def test_an_error_in_a_step_ends_the_stepper_and_is_told() -> None:
    error = ArithmeticError("the world broke")
    steps = Steps([], then=error)
    stepper = Stepper(steps.step, steps.on_error, time.monotonic_ns)
    stepper.start()
    assert steps.done.wait(WAIT_S)
    stepper.stop()
    assert steps.error is error
    assert len(steps.called_ns) == 1
