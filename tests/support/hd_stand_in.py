"""The stand-in of OpenHaptics' library (`tests/sketch/hd.c`), compiled, and ticked by hand."""

import ctypes
import subprocess
from pathlib import Path

from hapnet.checks import Vector
from hapnet.ext.devices import open_haptics as oh
from tests.conftest import ROOT

OPEN, RUNNING, OUTPUT, OFF_AT_END, FRAMES, UNSET, ERRORS = range(7)
NOTHING = (0.0, 0.0, 0.0)
TICK_S = 0.001
Three = ctypes.c_double * 3


def built(folder: Path) -> str:
    flags = ["-std=gnu11", "-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    source, library = ROOT / "tests" / "sketch" / "hd.c", folder / "libHD.so"
    subprocess.run(["gcc", *flags, source, "-o", library, "-lm", "-lpthread"], check=True)
    return str(library)


class Stub:
    """The stand-in, by hand: nothing happens between two ticks, and its clock is the driver's."""

    def __init__(self, library: str) -> None:
        self.library = library
        self.c = ctypes.CDLL(library)
        for name in ("stub_now", "stub_work", "stub_most"):
            getattr(self.c, name).restype = ctypes.c_double
        self.c.stub_tick.argtypes = self.c.stub_hot.argtypes = [ctypes.c_double]
        self.c.hdGetError.restype = oh.ErrorInfo
        self.c.stub_by_hand(1)

    def now(self) -> float:
        return float(self.c.stub_now())

    def tick(self, count: int = 1, seconds: float = TICK_S) -> None:
        for _ in range(count):
            self.c.stub_tick(seconds)

    def put(self, position: Vector, velocity: Vector = NOTHING) -> None:
        self.c.stub_put(Three(*position), Three(*velocity))

    @property
    def force(self) -> Vector:
        """What the motors make now, in the library's axes [N]."""
        force = Three()
        self.c.stub_force(force)
        return tuple(force)

    @property
    def commanded(self) -> Vector:
        """The force that was set last, in the library's axes [N]."""
        force = Three()
        self.c.hdGetDoublev(oh.FORCE, force)
        return tuple(force)

    @property
    def work_J(self) -> float:
        return float(self.c.stub_work())

    def state(self, which: int) -> int:
        return int(self.c.stub_state(which))
