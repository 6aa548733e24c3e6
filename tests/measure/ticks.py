"""Ticks of compiled runs, in the time of 1,000 bare float steps: what a coupling costs, on a machine of any speed."""

import os
import time
from collections.abc import Callable
from statistics import median

from hapnet.couplings.registry import COUPLINGS
from hapnet.ext.bench.references import plain_substeps
from hapnet.params import Params
from hapnet.simulation.simulation import Simulation

STEPS_PER_S = 4000


def main(couplings: str = "", duration_s: float = 20.0, rounds: int = 9, seed: int = 1) -> None:
    """A coupling over 4g at a wall, by CPU time, each round beside the steps; what is not compiled is compiled first.

    couplings: names with commas between them; without them all.
    """
    print(f"load {os.getloadavg()[0]:.1f}; {duration_s:g} s over 4g, medians of {rounds}; plain Python once")
    for name in couplings.split(",") if couplings else COUPLINGS:
        params = Params().set({"coupling": name, "duration_s": duration_s, "link.up": "4g", "link.down": "4g"})
        first_s = cpu_s(Simulation(params, seed, kernel=True).run)
        ticks = round(duration_s * params.device.servo_hz)

        def compiled(params: Params = params) -> None:
            Simulation(params, seed, kernel=True).run()

        found = []
        for _ in range(rounds):
            step_s = cpu_s(lambda: plain_substeps(1, duration_s)) / (STEPS_PER_S * duration_s)
            found.append(1000.0 * step_s * ticks / cpu_s(compiled))
        plain = 1000.0 * step_s * ticks / cpu_s(Simulation(params, seed, kernel=False).run)
        print(
            f"{name:13} {median(found):5.1f} compiled, {plain:4.1f} in plain Python; the first run took {first_s:.1f} s"
        )


def cpu_s(call: Callable[[], object]) -> float:
    """Of one call."""
    began_s = time.process_time()
    call()
    return time.process_time() - began_s


if __name__ == "__main__":
    main()
