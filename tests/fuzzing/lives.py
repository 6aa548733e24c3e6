"""What atheris feeds: bytes as a frame, and bytes as the life of a device (see coverage_guided.py)."""

import random

from hapnet.assembly.build import prepare
from tests.fuzzing import corpus
from tests.fuzzing.decoder import decoded, hold
from tests.fuzzing.rig import MS, Rig
from tests.support.paper import PAPER

_WAITS_NS = tuple(100_000 << power for power in range(10))  # to 51 ms
_HEADER = 3
_SETUPS = tuple(
    prepare(PAPER.set({"operator": "rest", "wire.accept_stale": stale, "wire.admission_W": watts}), "sampled")
    for stale, watts in ((False, 5.0), (True, 0.05))
)


def one_frame(data: bytes) -> None:
    """The decoder, against what the protocol's page allows."""
    decoded(data)


def one_life(data: bytes) -> None:
    """A device, its servo and its honest peer, while these frames arrive; then the same pair or a new one works."""
    if len(data) <= _HEADER:
        return
    rig = Rig("device", random.Random(0), _SETUPS[data[0] & 1], corpus.DEVICE)
    rig.restart(corpus.WORLD)
    rig.run(2 * MS)
    rig.run(1 * MS)
    hold(rig.paired, "the honest pair did not come about")
    rig.honest_position()
    for wait, frame in split(data[1:]):
        rig.run(_WAITS_NS[wait % len(_WAITS_NS)])
        rig.attack(frame)
        rig.talk()
        if wait >= 128:
            rig.honest_position()
            rig.honest.shuffle(1e-6 * wait)
    rig.watch.check_memory()
    if data[0] == data[-1] == 255:
        rig.recover()


def split(data: bytes) -> list[tuple[int, bytes]]:
    """(how long to wait, frame) of each frame in the input; the last may be cut short."""
    found, at = [], 0
    while at + _HEADER <= len(data):
        length = int.from_bytes(data[at + 1 : at + _HEADER], "big") & 0x1FFF
        found.append((data[at], data[at + _HEADER : at + _HEADER + length]))
        at += _HEADER + length
    return found


def joined(frames: list[tuple[int, bytes]]) -> bytes:
    """What `split` takes apart."""
    return b"".join(bytes((wait,)) + len(frame).to_bytes(2, "big") + frame for wait, frame in frames)


def starts(target: str) -> list[bytes]:
    """Inputs to begin with, from the corpus: its frames alone, and as lives of one frame, of some, and of many."""
    frames = list(corpus.seeds().values())
    if target == "decoder":
        return frames
    rng = random.Random(1)
    lives = [[frame] for frame in frames] + [rng.sample(frames, 8) for _ in range(40)]
    return [bytes((index % 2,)) + joined([(rng.randrange(256), f) for f in life]) for index, life in enumerate(lives)]
