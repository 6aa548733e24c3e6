"""The checks of this folder under atheris, which looks for inputs that reach new branches. Run by hand.

    python -m tests.fuzzing.coverage_guided --target decoder -- -max_total_time=120
    python -m tests.fuzzing.coverage_guided --target session -- -runs=200000 DIRECTORY

What follows ``--`` goes to libFuzzer; inputs that reached something new are left in the DIRECTORY, if one is named.
The input of `decoder` is a frame. That of `session` is a device's life: a byte of settings; then a byte that says how
long to wait, two that say how long a frame is, the frame, and so on. The device is the golden frames' "pen", paired
with their "wall".
"""

import argparse
import sys
import tempfile
from pathlib import Path


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzzing.coverage_guided")
    parser.add_argument("--target", choices=("decoder", "session"), required=True)
    at = argv.index("--") if "--" in argv else len(argv)
    target, theirs = parser.parse_args(argv[:at]).target, argv[at + 1 :]
    try:
        import atheris
    except ImportError:
        print("atheris is not installed: pip install -e '.[fuzz]'", file=sys.stderr)
        return 2
    with atheris.instrument_imports(include=["hapnet.wire", "hapnet.side.endpoint"]):
        from tests.fuzzing import lives
    with tempfile.TemporaryDirectory() as folder:
        new, seeds = Path(folder) / "new", Path(folder) / "seeds"
        new.mkdir()
        seeds.mkdir()
        for index, start in enumerate(lives.starts(target)):
            (seeds / str(index)).write_bytes(start)
        found = [] if any(not word.startswith("-") for word in theirs) else [str(new)]
        maximum = 4200 if target == "decoder" else 2000
        words = [f"-max_len={maximum}", *theirs, *found, str(seeds)]
        atheris.Setup([sys.argv[0], *words], lives.one_frame if target == "decoder" else lives.one_life)
        atheris.Fuzz()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
