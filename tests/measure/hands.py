"""Several hands at one block: what they feel beside a link without delay, and what each hand costs."""

import time

import numpy as np

from hapnet.ext.many.run import GraphSimulation, _World
from hapnet.simulation.simulation import Simulation
from tests.many.test_blocks import pressed
from tests.many.test_carrying import FROM_S, LINKS, forces, hands_around, run_of, steps_of_force, two_carry
from tests.support.pushed_blocks import pushed

CARRIED = ("delay 0ms", "delay 5ms", "delay 40ms 10ms loss 2%", "delay 100ms 30ms loss 10%")


def main(counts: str = "1,2,8", duration_s: float = 8.0) -> None:
    """Two hands carry 0.2 kg over each of some links; then as many hands as `counts` says push it over mixed links.

    counts: numbers with commas between them. duration_s: of each of the latter runs, in simulated time.
    """
    ideal = forces(two_carry("delay 0ms", (0.001, 0.001)).run())
    print(f"two hands carry 0.2 kg, {np.abs(ideal).mean():.2f} N each, beside 0 ms at 1,000 steps a second:")
    for link in CARRIED:
        result = two_carry(link).run()
        error = np.sqrt(np.mean((forces(result) - ideal) ** 2))
        steps = [steps_of_force(result, from_s) for from_s in (0.0, FROM_S)]
        shares = [pair.summary["world"]["modulated_share"] for pair in result.pairs.values()]
        modulated = ", ".join(f"{share or 0:.1%}" for share in shares)
        print(f"  {link:26} force error {error:.3f} N rms; 99 % of its steps below {steps[0]:.3f} N, once they carry "
              f"{steps[1]:.3f} N; modulated at the world {modulated}")  # fmt: skip
    for count in map(int, counts.split(",")):
        run = run_of(hands_around(count), LINKS, duration_s=duration_s)
        total, step_s = cpu_of(run)
        print(f"{count:3} hands, {duration_s:g} s: {total / count / duration_s:.3f} s of CPU a hand and second; "
              f"{1e6 * step_s / count:.0f} us a hand and step of the world; contacts alone, with the test's own "
              f"proxies, {1e6 * contacts_s(count) / count:.0f} us")  # fmt: skip


class Timed(_World):
    """A world that counts its steps, and their CPU time [s]."""

    def __init__(self, pairs: list[Simulation]) -> None:
        super().__init__(pairs)
        self.count, self.spent_s = 0, 0.0

    def step(self, now_ns: int) -> None:
        began = time.process_time()
        super().step(now_ns)
        self.count, self.spent_s = self.count + 1, self.spent_s + time.process_time() - began


def cpu_of(run: GraphSimulation) -> tuple[float, float]:
    """CPU time of a run, and of a step of its world with all hands [s]."""
    world = Timed(list(run.pairs.values()))
    run._world_of = dict.fromkeys(run._world_of, world)
    began = time.process_time()
    run.run()
    return time.process_time() - began, world.spent_s / world.count


def contacts_s(count: int, rounds: int = 200) -> float:
    """CPU time of the contacts of a step in which as many hands press a block [s]."""
    hands = [hand for _ in range((count + 1) // 2) for hand in pressed().proxies][:count]
    world = pressed().world
    for _ in range(20):
        pushed(world, hands, 0.01)
    began = time.process_time()
    for _ in range(rounds):
        pushed(world, hands, 0.01)
    return (time.process_time() - began) / rounds
