"""Messages from a child process to its parent over a pipe, each after its length; what comes too fast is dropped."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Iterator
from struct import Struct
from typing import BinaryIO

_LENGTH = Struct(">L")

_MOST = 256
"""So many messages wait for the parent; then the oldest is dropped."""


class FrameWriter:
    """Writes to the pipe `file` from a thread of its own, so that `put` never waits for who reads."""

    def __init__(self, file: int) -> None:
        self._file = file
        self._frames: deque[bytes] = deque(maxlen=_MOST)
        self._some = threading.Event()
        threading.Thread(target=self._write, name="frames", daemon=True).start()

    def put(self, data: bytes) -> None:
        """Send a message, from any thread; returns at once."""
        self._frames.append(data)
        self._some.set()

    def _write(self) -> None:
        with os.fdopen(self._file, "wb") as pipe:
            while self._some.wait():
                self._some.clear()
                try:
                    while self._frames:
                        data = self._frames.popleft()
                        pipe.write(_LENGTH.pack(len(data)) + data)
                    pipe.flush()
                except OSError:  # nobody reads any more
                    return


def frames(pipe: BinaryIO) -> Iterator[bytes]:
    """The messages that come over `pipe`, until it is closed."""
    while len(head := pipe.read(_LENGTH.size)) == _LENGTH.size:
        yield pipe.read(_LENGTH.unpack(head)[0])
