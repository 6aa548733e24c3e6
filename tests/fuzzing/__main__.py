"""Run storms of mutated messages, or one again: `python -m tests.fuzzing --target world --seed 7 --count 5000`."""

import argparse
import sys

from tests.fuzzing.storm import STORM, TARGETS, run_many


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzzing", description=__doc__)
    parser.add_argument("--target", choices=TARGETS, required=True)
    parser.add_argument("--seed", type=int, default=1, help="of the first storm")
    parser.add_argument("--count", type=int, default=STORM, help=f"messages, {STORM} to a storm and seed")
    options = parser.parse_args(argv)
    try:
        run_many(options.target, options.seed, options.count)
    except AssertionError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{options.count} messages into the {options.target}, from seed {options.seed} on: all that must hold held")
    return 0


if __name__ == "__main__":
    sys.exit(main())
