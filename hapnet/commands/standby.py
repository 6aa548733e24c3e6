"""A process that has loaded all that a side needs, and waits for its command: so another pair begins at once.

Its standard input has one line of JSON, ``{"argv": [...], "environment": {...}}``; what follows is the side's own
(console.py). If that ends before the line has come, the process ends too.
"""

from __future__ import annotations

import json
import os
import sys
from contextlib import redirect_stdout
from io import StringIO


def load() -> None:
    """Do once what a side does first, so that all of it is loaded."""
    import rich.console

    from hapnet import cli
    from hapnet.assembly.build import prepare
    from hapnet.commands.options import ZenohOptions
    from hapnet.commands.side import zenoh_settings
    from hapnet.laws import COUPLING_NAMES, built_in
    from hapnet.params import Params
    from hapnet.summary.run import versions
    from hapnet.wire.secret import Secret

    for name in COUPLING_NAMES:
        built_in(name)
    rich.console.Console(file=StringIO())
    prepare(Params())
    zenoh_settings(ZenohOptions())
    Secret(bytes(32))
    versions()
    with redirect_stdout(StringIO()):
        cli.main(["world", "--show-params"])


def main() -> int:
    """Load, wait, and run the command; returns its exit code."""
    from hapnet import cli

    load()
    line = bytearray()
    while not line.endswith(b"\n"):
        if not (byte := os.read(0, 1)):  # not more than the line: what follows is not ours
            return 0
        line += byte
    command = json.loads(line)
    os.environ.update(command["environment"])
    return cli.main(command["argv"])


if __name__ == "__main__":
    sys.exit(main())
