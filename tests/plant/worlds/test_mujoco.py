"""MuJoCo as the world: what is put in, what it makes of it, what it pays; over random links, at any step."""

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet import cli
from hapnet.errors import HapnetError, InvalidParameter, MissingLibrary
from hapnet.ext.engines.engine_account import CEILING_J, EngineAccount
from hapnet.ext.engines.engine_world import MAX_S, EngineWorld
from hapnet.ext.engines.mujoco_engine import mujoco_world
from hapnet.params import Params
from hapnet.simulation.simulation import Result, Simulation
from hapnet.summary.structure import Environment
from tests.conftest import mostly_slow
from tests.support.engines import check_account, over_random_link
from tests.support.mujoco_models import BALL, BLOCK, BOX, DOOR, FLEX, engine_of, found_of, made, model

mujoco: Any = pytest.importorskip("mujoco", reason="MuJoCo is not installed: hapnet-haptics[mujoco]")

SCENES = {
    "block": BLOCK,
    "box": BOX,
    "door": DOOR,
    "ball and box": BALL + BOX,
    "flex": FLEX,
    "all": BLOCK + DOOR + BALL,
}


def over_a_link(scene: str, index: int, **changes: object) -> Result:
    hand = {"operator": ("sine", "press", "rest")[index % 3], "operator_model.frequency_hz": 0.3 + 0.2 * (index % 5)}
    steps = ((0.001, 0.001), (0.01, 0.05), (0.1, 0.1), (0.004, 0.02))
    return over_random_link(scene, index, steps, {**hand, "duration_s": 1.2, **changes})


def check(result: Result) -> None:
    check_account(result, 1e-9)


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "flex")) for name in SCENES])
def test_a_passive_scene_over_a_link(name: str, tmp_path: Path) -> None:
    result = over_a_link(model(tmp_path / "m.xml", SCENES[name]) + "?at=0,0,0.03", 4 + list(SCENES).index(name))
    check(result)


@pytest.mark.parametrize("index", mostly_slow(range(100), 0, 8))
def test_passive_scenes_over_a_hundred_random_links(index: int, tmp_path: Path) -> None:
    content = list(SCENES.values())[index % len(SCENES)]
    proxy = "?proxy=handle" if "handle" in content and index % 5 == 2 else "?at=0,0,0.03"
    result = over_a_link(model(tmp_path / "m.xml", content) + proxy, index)
    check(result)


# -- a scene that makes energy -----------------------------------------------------------------------------------------


def bouncing(tmp_path: Path, content: str = BLOCK) -> tuple[Result, Environment]:
    """Undamped direct contacts under Euler, at a step that is long for them."""
    scene = model(tmp_path / "m.xml", content, solref="-3000 0", option='timestep="0.005" integrator="Euler"')
    result = over_a_link(scene + "?at=0,0,0.02", 4, operator="sine", duration_s=2.0)
    return result, result.summary["environment"]


@pytest.mark.parametrize(
    "content", mostly_slow([(one,) for one in [BLOCK, BALL]], 1), ids=["the proxy", "a ball far away"]
)
def test_energy_that_the_engine_makes_is_seen_paid_and_said(content: str, tmp_path: Path) -> None:
    result, own = bouncing(tmp_path, content)
    assert own["env_given_J"] > 1e-5
    assert own["env_paid_J"] > 1e-5  # what nothing could pay for was undone
    check(result)
    assert "the world would have given" in result.summary["verdict"]["reason"]
    assert any("a direct solref" in line and "EULER" in line for line in result.warnings)


@pytest.mark.parametrize(
    "content", mostly_slow([(one,) for one in [BLOCK, BALL]], 1), ids=["the proxy", "a ball far away"]
)
def test_without_the_observer_it_is_active(content: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unobserved(account: EngineAccount, work: float, supplied: float) -> bool:
        account.supplied_J += supplied
        return True

    monkeypatch.setattr(EngineAccount, "_settle", unobserved)
    result, own = bouncing(tmp_path, content)
    assert own["env_slack_J"] < -1e-3
    assert result.summary["verdict"]["passive"] is True  # the coupling is, whatever the world gives
    assert "energy came from" in result.summary["verdict"]["reason"]
    assert "the world itself" in result.summary["verdict"]["reason"]


# -- the account, from MuJoCo's own figures ----------------------------------------------------------------------------


def energy_of(world: EngineWorld) -> float:
    """Kinetic and potential energy, computed anew from positions and velocities; the proxy has no weight."""
    found = found_of(world)
    m, fresh = found.model, mujoco.MjData(found.model)
    fresh.qpos[:], fresh.qvel[:] = found.data.qpos, found.data.qvel
    mujoco.mj_forward(m, fresh)
    weight = -float(m.opt.gravity @ (m.body_mass * (1.0 - m.body_gravcomp) @ fresh.xipos))
    M = np.zeros((m.nv, m.nv))
    mujoco.mj_fullM(m, fresh, M)
    springs = 0.5 * sum(
        float(k) * float(fresh.qpos[m.jnt_qposadr[j]] - m.qpos_spring[m.jnt_qposadr[j]]) ** 2
        for j, k in enumerate(np.ravel(m.jnt_stiffness)[: m.njnt])
        if k
    )
    return weight + springs + 0.5 * float(fresh.qvel @ M @ fresh.qvel)


@pytest.mark.parametrize("proxy", ["?at=0,0,0.03", "?proxy=handle", "?proxy=door"])
def test_what_is_stored_and_put_in_is_what_mujoco_has(proxy: str, tmp_path: Path) -> None:
    """U is the engine's, and the work is F . dx of the force that it got, whatever step and pose."""
    world, mass = made(model(tmp_path / "m.xml", DOOR + BOX) + proxy)
    work, seen = 0.0, []
    substep = world.account.substep

    def witness(h: float, force: Any, most_J: float) -> Any:
        nonlocal work
        before = np.array(world.engine.position())
        applied, done = substep(h, force, most_J)
        work += float(np.dot(applied, np.array(world.engine.position()) - before))
        return applied, done

    world.account.substep = witness  # type: ignore[method-assign]  # to see each substep
    total = 0.0
    for k, dt in enumerate([0.02, 0.003, 0.05, 0.011] * 10):
        done = mass.step(dt, (0.03 * np.sin(0.3 * k), 0.01, -0.01))
        total -= done.work_J
        assert world.stored_J(done.position) == pytest.approx(energy_of(world), rel=1e-9, abs=1e-9)
        seen.append(abs(done.work_J))
    assert total == pytest.approx(work, abs=1e-12)
    assert max(seen) > 1e-4


def test_the_spring_keeps_what_the_engine_did_not_get(tmp_path: Path) -> None:
    """D = -sum F . dx - dphi, so the coupling's account closes: W = D + dphi."""
    _, mass = made(model(tmp_path / "m.xml", BLOCK) + "?at=0,0,0.03")
    for goal in ((0.04, 0.0, 0.0), (0.04, 0.02, 0.0), (-0.02, 0.0, 0.01)):
        before = 250.0 * float(np.sum((np.array(mass.position) - goal) ** 2))
        done = mass.step(0.03, goal)
        after = 250.0 * float(np.sum((np.array(done.position) - goal) ** 2))
        assert done.dissipated_J == pytest.approx(done.work_J - (after - before), abs=1e-15)


def test_a_motors_work_is_counted_at_a_port_of_its_own(tmp_path: Path) -> None:
    """A constant force on a slide, far from the proxy: S = force times way, and it takes back when it brakes."""
    piston = (
        '<body name="piston" pos="0.3 0 0.5" gravcomp="1"><joint name="rod" type="slide" axis="1 0 0"/>'
        '<geom type="box" size=".01 .01 .01" mass="0.2"/></body>'
    )
    motor = '<actuator><motor joint="rod"/></actuator>'
    world, mass = made(model(tmp_path / "m.xml", piston, more=motor) + "?at=0,0,0.03")
    data = found_of(world).data
    rod = found_of(world).model.joint("rod").qposadr[0]
    for control in (0.5, -0.5):
        data.ctrl[0] = control
        start, before = float(data.qpos[rod]), world.supplied_J
        for _ in range(10):
            mass.step(0.02, (0.0, 0.0, 0.0))
        way = float(data.qpos[rod]) - start
        assert world.supplied_J - before == pytest.approx(control * way, rel=1e-9)
        assert abs(way) > 0.01
    assert world.observed.given_J < 1e-12  # it pays for all that moves


STRUCK = (
    '<body name="ram" pos="0.06 0 0.05" gravcomp="1"><joint name="rod" type="slide" axis="1 0 0"/>'
    '<geom type="box" size=".02 .05 .05" mass="0.5"/></body>'
)


def test_a_ram_that_strikes_the_proxy_takes_nothing_that_the_reservoir_does_not_have(tmp_path: Path) -> None:
    more = '<actuator><position joint="rod" kp="200" kv="5"/></actuator>'
    world, mass = made(model(tmp_path / "m.xml", STRUCK, more=more) + "?at=0,0,0.05")
    minimum = 1.0
    for k in range(200):
        found_of(world).data.ctrl[0] = -0.08 if k % 20 < 10 else 0.0
        mass.limit_energy(1e-6)
        goal = (0.02 * np.sin(0.7 * k), 0.0, 0.0)
        before = 250.0 * float(np.sum((np.array(mass.position) - goal) ** 2))
        done = mass.step(0.02, goal)
        after = 250.0 * float(np.sum((np.array(done.position) - goal) ** 2))
        minimum = min(minimum, 1e-6 + done.dissipated_J + after)  # what PSPM has at hand at the next onset
        assert -done.work_J <= before + 1e-6
    assert minimum >= 0.0
    assert world.supplied_J > 1e-3


def test_a_debt_is_paid_by_what_moves_to_the_joule(tmp_path: Path) -> None:
    """Velocities are scaled: the kinetic energy falls by the debt, as far as there is any."""
    world, mass = made(model(tmp_path / "m.xml", BALL) + "?at=0,0,0.03")
    account, data = world.account, found_of(world).data
    for _ in range(3):
        mass.step(0.02, (0.0, 0.0, 0.0))
    before = float(data.energy[1])
    paid = account._pay(0.25 * before, *engine_of(world).energy_J())
    assert paid == pytest.approx(0.25 * before, rel=1e-12)
    assert float(data.energy[1]) == pytest.approx(0.75 * before, rel=1e-12)
    assert account._pay(10.0 * before, *engine_of(world).energy_J()) == pytest.approx(0.75 * before, rel=1e-12)
    assert 0.0 <= account.account_J <= CEILING_J


# -- steps, proxies, words ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("dt", "count"), [(0.001, 1), (0.004, 1), (0.0041, 2), (0.03, 8), (0.1, 25)])
def test_a_step_takes_as_long_as_it_took(dt: float, count: int, tmp_path: Path) -> None:
    """Substeps of equal length, no longer than the model's own: simulated time is the step's."""
    world, mass = made(model(tmp_path / "m.xml", BLOCK))
    mass.step(dt, mass.position)
    assert found_of(world).data.time == pytest.approx(dt, rel=1e-12)
    assert float(found_of(world).model.opt.timestep) == pytest.approx(dt / count, rel=1e-12)
    mass.step(10.0, mass.position)
    assert found_of(world).data.time == pytest.approx(dt + MAX_S, rel=1e-9)


def test_at_rest_the_block_holds_the_force_that_the_spring_needs(tmp_path: Path) -> None:
    """K' (ybar - x) = F: the contact's force on the proxy is the coupling's reaction."""
    _, mass = made(model(tmp_path / "m.xml", BLOCK) + "?at=0,0,0.03")
    for _ in range(60):
        done = mass.step(0.02, (0.035, 0.0, 0.0))
    face = 0.05 - 0.02 - 0.005
    assert face < done.position[0] < face + 0.005  # a contact of MuJoCo's is as soft as the sphere is light
    assert done.force[0] == pytest.approx(-500.0 * (0.035 - done.position[0]), rel=1e-3)
    assert done.penetration_m == pytest.approx(max(0.0, done.position[0] - face), abs=1e-6)


def test_a_sphere_is_put_where_it_is_free_and_led_as_far_as_it_goes(tmp_path: Path) -> None:
    world, mass = made(model(tmp_path / "m.xml", BLOCK) + "?radius=0.01")
    assert world.engine.depth() == 0.0
    assert float(found_of(world).data.body("hapnet_proxy").xpos[2]) > 0.01
    there = made(model(tmp_path / "m.xml", BLOCK) + "?at=0,0,0.03")[0]
    reached = there.towards((0.05, 0.0, 0.0))
    assert reached[0] == pytest.approx(0.025, abs=1e-3)
    mass.place((0.0, 0.0, 0.02))
    assert mass.position == (0.0, 0.0, 0.02)


def test_with_fewer_axes_the_others_stay(tmp_path: Path) -> None:
    _, mass = made(model(tmp_path / "m.xml", BLOCK) + "?at=0,0,0.03", dof=1)
    done = mass.step(0.05, (0.01,))
    assert len(done.position) == len(done.force) == 1
    assert done.position[0] > 1e-3


def test_a_world_that_diverges_ends_with_one_line(tmp_path: Path) -> None:
    world, mass = made(model(tmp_path / "m.xml", BALL))
    found_of(world).data.qvel[-1] = np.nan
    with pytest.raises(HapnetError, match=r"the scene mujoco:.* failed: its position is .*nan"):
        mass.step(0.01, mass.position)


@pytest.mark.parametrize("integrator", ["RK4", "implicit"])
def test_an_integrator_that_is_not_passive_is_told(integrator: str, tmp_path: Path) -> None:
    world = mujoco_world(model(tmp_path / "m.xml", BLOCK, option=f'integrator="{integrator}"'))
    assert any(f"the integrator {integrator.upper()} is not passive" in line for line in world.warnings)
    assert not mujoco_world(model(tmp_path / "m.xml", BLOCK)).warnings


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        ("mujoco:nowhere.xml", "there is no file nowhere.xml"),
        ("mujoco:", "mujoco:FILE.xml"),
        ("mujoco:{}?size=3", "mujoco:FILE.xml"),
        ("mujoco:{}?at=1,2", "mujoco:FILE.xml"),
        ("mujoco:{}?radius=-1", "a positive number"),
        ("mujoco:{}?proxy=nobody", "a body or site of the model, not nobody (bodies: door; sites: handle)"),
        ("mujoco:{}?proxy=world", "a body that can move"),
        ("mujoco:{}?proxy=door&at=0,0,0", "either proxy=NAME"),
        ("mujoco:" + __file__, "a model that MuJoCo can load"),
    ],
)
def test_what_is_no_scene_is_refused_in_one_line(
    scene: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = model(tmp_path / "m.xml", DOOR).removeprefix("mujoco:")
    assert cli.main(["simulate", "--scene", scene.format(file), "--duration", "1", "--no-files"]) == 2
    complaint = capsys.readouterr().err
    assert words in complaint
    assert len(complaint.strip().splitlines()) == 1


def test_without_the_extra_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingLibrary, match="of the extra `mujoco`, which is not installed"):
        mujoco_world(model(tmp_path / "m.xml", BLOCK))
    assert cli.main(["simulate", "--scene", model(tmp_path / "m.xml", BLOCK), "--no-files"]) == 2


def test_a_law_without_a_spring_at_the_world_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidParameter, match="one whose virtual mass has a spring"):
        Simulation(Params().set({"scene": model(tmp_path / "m.xml", BLOCK), "coupling": "wave"}))


@pytest.mark.slow
@pytest.mark.realtime  # beside other tests, which take of the cores' cache, both are slower, but not alike
def test_thirty_boxes_take_little_longer_than_with_bare_mujoco(tmp_path: Path) -> None:
    """Steps a second beside bare `mj_step` in the same state, interleaved, in the thread's CPU time."""
    boxes = "".join(
        f'<body pos="{0.1 * (i % 6)} {0.1 * (i // 6)} .03"><freejoint/>'
        '<geom type="box" size=".02 .02 .02" density="300"/></body>'
        for i in range(30)
    )
    scene = model(tmp_path / "m.xml", boxes, option='timestep="0.002"') + "?at=0,0,0.1"
    (_, mass), bare = made(scene), found_of(made(scene)[0])
    goal = (0.0, 0.0, -0.06)
    for _ in range(50):
        force = mass.step(0.03, goal).coupling_force
    for push in ((0.0, 0.0, -0.05), force):
        bare.data.qfrc_applied[list(bare.dofs)] = push
        for _ in range(600):
            mujoco.mj_step(bare.model, bare.data)
    theirs, ours = [], []
    for _ in range(25):
        start = time.thread_time()
        for _ in range(150):
            mujoco.mj_step(bare.model, bare.data)
        between = time.thread_time()
        for _ in range(10):
            mass.step(0.03, goal)
        theirs.append(between - start)
        ours.append(time.thread_time() - between)
    print(f"steps per second beside bare MuJoCo: {min(theirs) / min(ours):.2f}")
    assert min(theirs) / min(ours) >= 0.7  # the least of each is what other processes disturbed least
