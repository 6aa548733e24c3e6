"""The world's thread: a step begins when the time of the last one is over."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from hapnet.realtime.servo import set_timer_slack

_MAX_SLEEP_S = 0.1
"""`stop` takes effect within this time [s], however long a step is."""


class Stepper:
    """A thread that calls ``step(now_ns)`` again and again: each call returns the next step's length [ns].

    A late step is one longer step. The next one is counted from it, so there is never a burst.
    """

    def __init__(
        self, step: Callable[[int], int], on_error: Callable[[BaseException], None], clock: Callable[[], int]
    ) -> None:
        self._step, self._on_error, self._clock = step, on_error, clock
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._main, name="world", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End the thread and wait for it."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _main(self) -> None:
        set_timer_slack()
        try:
            deadline_ns = self._clock()
            while not self._stopping.is_set():
                now_ns = self._clock()
                if now_ns < deadline_ns:
                    time.sleep(min((deadline_ns - now_ns) * 1e-9, _MAX_SLEEP_S))
                else:
                    deadline_ns = now_ns + self._step(now_ns)
        except BaseException as error:
            self._on_error(error)
