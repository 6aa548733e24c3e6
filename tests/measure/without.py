"""Which extensions a run at a flat wall needs, and what it loads.

Each extension is blocked in turn, then all of them together: a simulation must run without.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXTENSIONS = sorted(one.name for one in (ROOT / "hapnet" / "ext").iterdir() if (one / "__init__.py").exists())
_RUN = """
import importlib.abc, sys

class Blocked(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if any(name == one or name.startswith(one + ".") for one in sys.argv[1:]):
            raise ImportError(f"{name} is blocked")

sys.meta_path.insert(0, Blocked())
from hapnet import simulate
result = simulate({"duration_s": 0.3}, seed=1)
assert result.summary["verdict"]["passive"] is True, result
files = [module.__file__ for name, module in sys.modules.items() if name.partition(".")[0] in ("hapnet", "netem")]
print(len(files), sum(len(open(file, encoding="utf-8").readlines()) for file in files))
"""


def loaded_without(*packages: str) -> tuple[int, int]:
    """How many modules, with how many lines, of hapnet and netem a simulation at the default wall loads.

    packages : those that cannot be imported meanwhile.

    Raises RuntimeError: it does not run; the message is the last line of its error.
    """
    done = subprocess.run(
        [sys.executable, "-c", _RUN, *packages], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(done.stderr.strip().rpartition("\n")[2])
    modules, lines = done.stdout.split()
    return int(modules), int(lines)


def main() -> int:
    """Print a line for each extension; returns how many the run needs."""
    needed = 0
    cases = [(name, (f"hapnet.ext.{name}",)) for name in EXTENSIONS]
    for name, packages in [*cases, ("all of them", ("hapnet.ext",))]:
        try:
            modules, lines = loaded_without(*packages)
            print(f"without {name:12} it runs: {modules} modules, {lines:,} lines")
        except RuntimeError as error:
            needed += 1
            print(f"without {name:12} it fails: {error}")
    return needed


if __name__ == "__main__":
    sys.exit(main())
