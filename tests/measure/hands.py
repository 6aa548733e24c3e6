"""Several hands at one block: what they feel beside a link without delay, what each hand costs, and every account."""

import time
from collections.abc import Callable
from functools import partial
from resource import RUSAGE_SELF, getrusage

import numpy as np

from hapnet.ext.many.run import GraphResult, GraphSimulation, _World
from hapnet.side.endpoint import NANO
from hapnet.simulation.simulation import Simulation
from tests.many.test_blocks import pressed
from tests.many.test_carrying import FROM_S, forces, pushed_over, steps_of_force, two_carry
from tests.many.test_robots import ROBOT, SERVED, robots
from tests.support.pushed_blocks import pushed

CARRIED = ("delay 0ms", "delay 5ms", "delay 40ms 10ms loss 2%", "delay 100ms 30ms loss 10%")


def main(counts: str = "1,2,8", duration_s: float = 8.0, first: int = 0, carry: bool = True) -> None:
    """Two hands, with a robot each too, carry 0.2 kg over some links; then as many as `counts` says push it over mixed
    links.

    counts: numbers with commas between them. duration_s: of each of the latter runs, in simulated time. first: the
    number of the first hand's link among those of tests/many/test_carrying.py. carry: whether to make the first runs.
    """
    if carry:
        carried()
    for count in map(int, counts.split(",")):
        pushed_by(count, first, duration_s)


def carried() -> None:
    """Print what two hands feel that carry a block: with proxies, and with robots of two kinds."""
    _felt("two hands carry 0.2 kg", two_carry, two_carry("delay 0ms", (0.001, 0.001)))
    for name, kind in (("two robots", ROBOT), ("two robots of 0.5 kg with position servos", SERVED)):
        make = partial(robots, follower=kind)
        _felt(f"{name} carry 0.2 kg, a hand leads each", make, make("delay 0ms"))


def _felt(name: str, make: Callable[[str], GraphSimulation], best: GraphSimulation) -> None:
    """Print the hands' forces in the runs over each link, beside the `best` run."""
    ideal = forces(best.run())
    print(f"{name}, {np.abs(ideal).mean():.2f} N each, beside 0 ms at 1,000 steps a second:")
    for link in CARRIED:
        result = make(link).run()
        error = np.sqrt(np.mean((forces(result) - ideal) ** 2))
        steps = [steps_of_force(result, from_s) for from_s in (0.0, FROM_S)]
        shares = [pair.summary["world"]["modulated_share"] for pair in result.pairs.values()]
        modulated = ", ".join(f"{share or 0:.1%}" for share in shares)
        print(f"  {link:26} force error {error:.3f} N rms; 99 % of its steps below {steps[0]:.3f} N, once they carry "
              f"{steps[1]:.3f} N; modulated at the world {modulated}")  # fmt: skip


def pushed_by(count: int, first: int, duration_s: float) -> None:
    """Print what as many hands cost, and the least values of all accounts."""
    run = pushed_over(count, first, duration_s)
    minutes, early = [time.process_time()], 0

    def see(simulated_s: float) -> None:
        nonlocal early
        early += sum(max(0, beyond) for beyond in credited_beyond_sent(run))
        if simulated_s >= 60.0 * len(minutes):
            minutes.append(time.process_time())

    total, step_s, result = cpu_of(run, see)
    simulated_s = run.now_ns * NANO
    print(f"{count:3} hands, {duration_s:g} s after {simulated_s - duration_s:.1f} s until all were paired: "
          f"{total / count / simulated_s:.3f} s of CPU a hand and second; "
          f"{1e6 * step_s / count:.0f} us a hand and step of the world; contacts alone, with the test's own "
          f"proxies, {1e6 * contacts_s(count) / count:.0f} us")  # fmt: skip
    slacks = [side.coupling.ledger.slack_min for pair in result.pairs.values() for side in (pair.device, pair.world)]
    margins = [pair.summary["theorem"]["margin_J"] for pair in result.pairs.values()]
    nodes = result.summary["nodes"].values()
    beyond = max(node["sent_nJ"] * NANO - node["ledger_sent_J"] for node in nodes)
    shared = next(iter(run.pairs.values())).setup.scene.shared
    blocks = shared.account.slack_min if count > 1 else next(iter(result.pairs.values())).world.environment.slack_min
    print(f"    least slack of a half {min(slacks):.0e} J, of the blocks {blocks:.0e} J; least margin of a pair "
          f"{1e3 * min(margins):.4g} mJ of 150; credited beyond sent {early} nJ; a node sent at most {beyond:.0e} J "
          f"more than its ledgers count; {result.summary['verdict']['passive']}")  # fmt: skip
    costs = np.diff(minutes)
    if len(costs) > 1:
        most_MB = getrusage(RUSAGE_SELF).ru_maxrss / 1024.0
        print(f"    the last minute took {costs[-1] / costs[0]:.2f} of the first's CPU time; {most_MB:.0f} MB at most")


def credited_beyond_sent(run: GraphSimulation) -> list[int]:
    """For each direction of each pair, the energy credited less the energy sent [nJ]."""
    ends = [(pair.device_endpoint.session, pair.world_endpoint.session) for pair in run.pairs.values()]
    return [one.credited_nJ - other.sent_nJ for two in ends for one, other in (two, two[::-1])]


class Timed(_World):
    """A world that counts its steps, and their CPU time [s]."""

    def __init__(self, pairs: list[Simulation]) -> None:
        super().__init__(pairs)
        self.count, self.spent_s = 0, 0.0

    def step(self, now_ns: int) -> None:
        began = time.process_time()
        super().step(now_ns)
        self.count, self.spent_s = self.count + 1, self.spent_s + time.process_time() - began


def cpu_of(run: GraphSimulation, progress: Callable[[float], None]) -> tuple[float, float, GraphResult]:
    """CPU time of a run, and of a step of its world with all hands [s], and its result."""
    world = Timed(list(run.pairs.values()))
    run._world_of = dict.fromkeys(run._world_of, world)
    began = time.process_time()
    result = run.run(progress)
    return time.process_time() - began, world.spent_s / world.count, result


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
