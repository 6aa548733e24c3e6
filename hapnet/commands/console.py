"""Receives commands from `hapnet play` in a running side: one JSON object per line, on standard input.

``{"do": "lead", "position": [x, ...]}``, ``{"do": "link", "words": "..."}``, ``{"do": "pause", "on": true}``,
``{"do": "record", "path": "..." or null}``, ``{"do": "let_go", "why": "..."}`` and
``{"do": "stop_force", "why": "..."}``; ``{"do": "leave_at_once"}`` before the signal to stop. The network
carries no commands: only the process that has started a side can command it.

A new command needs a case here and a method of `RealtimeSide`. A button for it needs a method of `Controls`
(hapnet/ext/page/controls.py) and a line in the panel; `hapnet play` passes the command on.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hapnet.errors import HapnetError
from hapnet.realtime.runner import RealtimeSide
from netem.errors import NetemError


async def run_console(side: RealtimeSide, complain: Callable[[str], None]) -> None:
    """Run the commands on standard input until it ends. A bad line is reported and has no other effect."""
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    async for line in reader:
        try:
            _do(side, json.loads(line))
        except (HapnetError, NetemError) as error:
            complain(str(error))
        except Exception as error:  # after any error in one command the next command is read
            complain(f"not a command: {line!r:.80} ({type(error).__name__}: {error})")


def _do(side: RealtimeSide, command: dict[str, Any]) -> None:
    match command["do"]:
        case "lead":
            side.lead(tuple(command["position"]))
        case "link":
            side.change_link(str(command["words"]))
        case "pause":
            side.pause(bool(command["on"]))
        case "record":
            side.record(None if command["path"] is None else Path(command["path"]))
        case "stop_force":
            side.stop_force(str(command["why"]))
        case "let_go":
            side.let_go(str(command["why"]))
        case "leave_at_once":
            side.leave_at_once()
        case other:
            raise ValueError(other)
