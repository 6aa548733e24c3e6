"""The command `hapnet compile`: makes the machine code of runs and servos now, and shows the progress."""

from __future__ import annotations

import time
from typing import Annotated

import typer

from hapnet.commands import output
from hapnet.commands.progress import Progress
from hapnet.couplings.registry import COUPLINGS
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.compiled import catalogue, sources
from hapnet.records.machine_code import directory, no_compiler


def compile_couplings(
    couplings: Annotated[
        list[str] | None, typer.Argument(metavar="[COUPLING]...", help="Whose runs; `all`: every coupling's.")
    ] = None,
) -> int:
    """Without it plain Python runs the same, to the last bit, more slowly. A kind takes half a minute to a minute, once
    on a machine and for a version of hapnet: simulations of a coupling among walls, among solids, and the ends of
    set-positions in real time (with `pspm`, the default, and `zoh`).
    """
    if (why := no_compiler()) is not None:
        raise HapnetError(why)
    wanted = list(COUPLINGS) if couplings == ["all"] else couplings or ["pspm"]
    for name in wanted:
        if name not in COUPLINGS:
            raise InvalidParameter("COUPLING", name, f"all, or one of {', '.join(COUPLINGS)}", tuple(COUPLINGS))
    names = dict.fromkeys(kind for law in wanted for kind in catalogue.of_coupling(law))
    if any(COUPLINGS[law].compiled == (None, None) for law in wanted):
        names |= dict.fromkeys(catalogue.ends())
    words = output.console(None)
    makers, labels = catalogue.makers(), catalogue.labels()
    with Progress(output.progress_console(words), "compiling", len(names), "kinds") as progress:
        for done, name in enumerate(names):
            progress.update(done)
            if sources.are_compiled(name):
                words.print(f"{labels[name]}: was compiled before", markup=False)
                continue
            began_s = time.monotonic()
            makers[name]()
            words.print(f"{labels[name]}: {time.monotonic() - began_s:.0f} s", markup=False)
    words.print(f"kept in {directory()}", markup=False)
    return 0
