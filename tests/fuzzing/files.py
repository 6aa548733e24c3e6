"""Broken files into the readers of hapnet: each is read, or refused in one line; with little memory, and soon.

``python -m tests.fuzzing.files --count 100000`` reads so many, and says how they were refused.
"""

import argparse
import random
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from hapnet.errors import HapnetError
from hapnet.ext.arms.parameters import table_of
from hapnet.ext.solids.mesh_file import read_mesh
from hapnet.ext.solids.volume_file import read_volume
from hapnet.ext.study.journal import Journal
from hapnet.ext.study.spec import Spec
from hapnet.loading import permitting
from hapnet.params import Params
from hapnet.plant.worlds.registry import make_scene
from hapnet.recording.export import write
from hapnet.recording.mcap import read_recording
from hapnet.recording.opened import fitting, opened
from hapnet.simulation.replay import read_original
from hapnet.summary.recorded import of_recordings
from netem import NetemError
from tests.fuzzing.file_mutator import FileMutator
from tests.fuzzing.file_seeds import seeds

SHARES: Mapping[str, float] = {
    "recording": 0.35, "mesh": 0.15, "urdf": 0.15, "toml": 0.15, "npy": 0.1, "mujoco": 0.05, "journal": 0.05,
}  # fmt: skip
MOST_S, MOST_MB = 10, 300


def _recording(file: Path) -> None:
    read_recording(file).samples()
    found = opened(file)
    with fitting(file):
        of_recordings(found.files, found.parts)
    read_original([file])
    with fitting(file):
        write(found.whole, file.parent, ["out"], ["csv"])


def _toml(file: Path) -> None:
    with suppress(HapnetError):
        Params().load(file)
    Spec.read(file)


def _journal(file: Path) -> None:
    journal = Journal.look(file.parent)
    try:
        journal.count()
        list(journal.rows())
    finally:
        journal.close()


READERS: Mapping[str, Callable[[Path], object]] = {
    "recording": _recording,
    "mesh": lambda file: read_mesh(str(file), 1e-3),
    "urdf": lambda file: table_of(f"arm:{file}?tip=tip"),
    "toml": _toml,
    "npy": lambda file: read_volume(str(file), 1e-3, 1e-3, None),
    "mujoco": lambda file: make_scene(f"mujoco:{file}"),
    "journal": _journal,
}


def refuse_imports(parameter: str, name: str) -> None:
    raise HapnetError(f"{parameter} is {name}, which a file names")


def tried(kind: str, file: Path) -> str:
    """ "read", or the line with which the file is refused. Anything else that is raised is a fault."""
    try:
        with permitting(refuse_imports):
            READERS[kind](file)
    except (HapnetError, NetemError) as error:
        line = str(error)
        assert line.strip(), "a refusal without a word"
        assert not set(line) & set("\n\r"), f"more than one line: {line!r}"
        assert len(line) < 2000, f"a line of {len(line)} characters"
        return line
    return "read"


def run(kind: str, seed: int, count: int) -> Counter[str]:
    """Try `count` broken files; returns how many were read, and how many refused. A fault names its seed and number."""
    found: Counter[str] = Counter()
    rng = random.Random(f"{kind} {seed}")
    mutator = FileMutator(rng, kind, seeds(kind))
    modules = set(sys.modules)
    with tempfile.TemporaryDirectory() as room:
        for number in range(count):
            ending, data = mutator.next()
            file = Path(room) / (ending if kind == "journal" else f"broken{ending}")
            file.write_bytes(data)
            began = time.process_time()
            signal.setitimer(signal.ITIMER_PROF, MOST_S)
            try:
                line = tried(kind, file)
            except BaseException as error:
                kept = Path(tempfile.gettempdir()) / f"broken-{kind}-{seed}-{number}{ending}"
                kept.write_bytes(data)
                raise AssertionError(f"{kind}, seed {seed}, number {number}: {kept}") from error
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0)
            found["read" if line == "read" else "refused"] += 1
            took = time.process_time() - began
            found["slowest_ms"] = max(found["slowest_ms"], round(1e3 * took))
            peak_mb = peak_memory_mb()
            assert peak_mb < MOST_MB, f"{kind}, seed {seed}, number {number}: {peak_mb} MB"
    found["peak_mb"] = peak_mb
    new = {name for name in set(sys.modules) - modules if name.partition(".")[0] in ("evilmod", "x", "a")}
    assert not new, f"imported: {new}"
    return found


def peak_memory_mb() -> int:
    """The most memory that this process has held [MB].

    `ru_maxrss` would not do: a new process inherits that of the one that started it.
    """
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) // 1024


def _late(*_: object) -> None:
    raise TimeoutError(f"more than {MOST_S} s of processor time")


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000, help="of all kinds together")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=SHARES, default=None)
    given = parser.parse_args(argv)
    signal.signal(signal.SIGPROF, _late)
    warnings.simplefilter("ignore")  # numpy's, about numbers that are not finite
    for kind, share in SHARES.items():
        if given.kind in (None, kind):
            found = run(kind, given.seed, max(1, round(given.count * (share if given.kind is None else 1.0))))
            print(f"{kind}: {dict(found)}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
