"""What a step of a soft body costs, and how a device feels it.

``python -m tests.measure soft_figures`` prints the figures of hapnet/ext/soft/soft.md; set OMP_NUM_THREADS=1, since
times are of one core. ``--flex`` adds MuJoCo's flex of that size, ``--felt press hand-21`` prints
the error of the force over links instead.
"""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.sparse.linalg import spsolve

from hapnet.checks import Array
from hapnet.ext.soft import soft_mesh
from hapnet.ext.soft.soft_body import Body, Material
from hapnet.ext.soft.soft_contacts import Skin, SoftContacts
from hapnet.ext.soft.soft_linear import stiffness_at_rest
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.simulation.simulation import simulate

LTE = Path(__file__).parents[2] / ".." / "shared" / "data" / "links"
TRACES = ("ATT-LTE-driving-2016", "Verizon-LTE-short")


def median_ms(work: Callable[[], object], count: int) -> float:
    """CPU time."""
    found = []
    for _ in range(count):
        before = time.process_time()
        work()
        found.append(1e3 * (time.process_time() - before))
    return float(np.median(found))


def twisted(nodes: int, degrees: float, ball: float = 0.01) -> SoftContacts:
    """A block whose front face is held, twisted against its back, which is held too; a ball beside it, along -y."""
    places, tets = soft_mesh.block((0.06, 0.06, 0.06), nodes)
    front = places[:, 0] < places[:, 0].min() + 1e-9
    back = places[:, 0] > places[:, 0].max() - 1e-9
    contacts = SoftContacts(Body(places, tets, front | back, Material(gravity=(0.0, 0.0, 0.0))), Skin(radius=ball), 3)
    body = contacts.body
    for share in np.linspace(0.0, 1.0, 11)[1:]:
        x, y, z = contacts.body.x.T
        turn = np.radians(degrees) * 0.1 * (x - x.min()) / np.ptp(x) * np.ones_like(share)
        body.x = np.stack([x, np.cos(turn) * y - np.sin(turn) * z, np.sin(turn) * y + np.cos(turn) * z], axis=1)
        body.strains[:] = body.true_strains()
    return contacts


def step_ms(nodes: int, degrees: float) -> tuple[float, float, float, int]:
    """Median and 95th percentile of a step's CPU time, rounds, and points that touch, of a ball that slides."""
    contacts = twisted(nodes, degrees)
    mass, rng = PassiveIntegrator(0.02, 14.0, 500.0, (0.0, -0.06, 0.0)), np.random.default_rng(1)
    contacts.stored_J(())
    clock, times, rounds, touching = 0.0, [], [], []
    for k in range(90):
        dt = float(rng.uniform(0.01, 0.05))
        clock += dt
        aim = (0.004 * np.sin(4.0 * clock), -0.06 + min(0.037, 0.05 * clock), 0.004 * np.cos(3.0 * clock))
        before = time.process_time()
        mass.step(dt, aim, contacts)
        if k >= 40:
            times.append(1e3 * (time.process_time() - before))
            rounds.append(contacts.rounds)
            touching.append(int(contacts.forces.any(axis=1).sum()))
    return float(np.median(times)), float(np.quantile(times, 0.95)), float(np.mean(rounds)), int(np.median(touching))


def bare_solve_ms(nodes: int) -> float:
    """One sparse solve of the body's matrix at rest, which is assembled already."""
    body = twisted(nodes, 0.0).body
    whole = stiffness_at_rest(body)[: 3 * body.free, : 3 * body.free]
    b = np.ones(3 * body.free)
    return median_ms(lambda: spsolve(whole.tocsc(), b, permc_spec="MMD_AT_PLUS_A"), 3)


def flex_ms(nodes: int) -> tuple[float, float]:
    """MuJoCo's flex with as many nodes: CPU time of one step of 2 ms, and of the 15 that 30 ms need."""
    import mujoco

    side = round(nodes ** (1.0 / 3.0))
    spacing = 0.06 / (side - 1)
    mujoco.set_mju_user_warning(lambda _: None)  # of an unstable body it would write a file here
    model = mujoco.MjModel.from_xml_string(f"""
      <mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody>
        <geom name="ball" type="sphere" size=".01" pos="0 -.035 0"/>
        <flexcomp name="soft" type="grid" dim="3" count="{side} {side} {side}" spacing="{spacing} {spacing} {spacing}"
          mass=".216" radius=".001"><contact selfcollide="none"/><edge damping="1"/>
          <elasticity young="20000" poisson=".4" damping=".01"/><pin id="0 1 2 3 4 5"/></flexcomp>
      </worldbody></mujoco>""")
    data = mujoco.MjData(model)
    one = median_ms(lambda: mujoco.mj_step(model, data), 30)
    return one, 15.0 * one


def felt(
    scene: str, operator: str, links: tuple[str, ...], seconds: float, step_s: float = 0.001
) -> dict[str, tuple[float, float, float]]:
    """Of each link: the force's error, of its rms in contact and of its peak [%], and the least slack [J].

    Against the same body without a link in steps of 1 ms, or as long as given: they differ by 0.4 % from those of 5 ms,
    which take a fifth of the time. A link is a profile, or the name of a recorded one.
    """

    def course(link: str, **given: float) -> tuple[Array, Array, float]:
        up, down = (f"trace {LTE / link}.{way}" if link in TRACES else link for way in ("up", "down"))
        names = {"scene": scene, "operator": operator, "duration_s": seconds, "link.up": up, "link.down": down}
        result = simulate({**names, **given}, seed=1)
        device, summary = result.recording.device, result.summary
        slack = min(float(summary[side]["ledger"]["slack_J"] or 0.0) for side in ("device", "world"))
        assert float(summary["environment"]["env_slack_J"] or 0.0) >= -1e-12
        return (device["time_ns"] - device["time_ns"][0]) * 1e-9, device["force_N"], slack

    true_s, true, _ = course("", **{"world.step_min_s": step_s, "world.step_max_s": step_s})
    found = {}
    for link in links:
        time_s, force, slack = course(link)
        whole = np.stack([np.interp(time_s, true_s, part) for part in true.T], axis=1)
        size = np.linalg.norm(whole, axis=1)
        touches = (size > 0.05) & (time_s > 1.0)
        error = float(np.sqrt((np.linalg.norm(force - whole, axis=1)[touches] ** 2).mean()))
        rms = float(np.sqrt((size[touches] ** 2).mean()))
        found[link] = 100.0 * error / rms, 100.0 * error / float(size.max()), slack
    return found


def main(flex: bool = False, felt_by: str = "", reference_s: float = 0.001) -> None:
    """felt_by : operators; nothing else is printed then. reference_s : the steps without a link."""
    for nodes in () if felt_by else (1000, 4913):
        for degrees in (0.0, 50.0):
            middle, late, rounds, touching = step_ms(nodes, degrees)
            print(
                f"{nodes} nodes, {degrees:g} deg: {middle:.1f} ms (95 %: {late:.1f}), {rounds:.1f} rounds, {touching}"
            )
        print(f"{nodes} nodes: one bare sparse solve {bare_solve_ms(nodes):.0f} ms")
    if flex:
        print("MuJoCo's flex, 1000 nodes: {:.1f} ms a step of 2 ms, {:.0f} ms for 30 ms".format(*flex_ms(1000)))
    for operator in felt_by.split(",") if felt_by else ():
        found = felt("soft", operator, ("wifi", "4g", *TRACES), 8.0, reference_s)
        for link, (error, of_peak, slack) in found.items():
            print(f"{operator} {link}: {error:.1f} % of rms, {of_peak:.1f} % of peak, slack {slack:.0e} J", flush=True)
