"""The stages before laws of others: they choose the set-position, and what a law claims of a port still holds."""

from typing import Any

import numpy as np
import pytest

from examples.pictures.lying import lying_planes
from hapnet.assembly.build import prepare
from hapnet.couplings.registry import COUPLINGS, coupling
from hapnet.errors import InvalidParameter
from hapnet.params import Params
from hapnet.simulation.simulation import Simulation, simulate
from tests.conftest import mostly_slow
from tests.support.hand_port import LIGHT_HAND

FAR: dict[str, object] = {"link.up": "intercontinental", "link.down": "intercontinental", "rendering": "hapnet"}
TOUCHING: dict[str, object] = {**FAR, "scene": "wall", "operator": "press", "duration_s": 4.0, "record_hz": 1000.0}


def stiffnesses(name: str) -> tuple[float, float]:
    """K and K' of a law with the stages [N/m]."""
    setup = prepare(Params().set({**TOUCHING, "coupling": name}))
    if setup.coupling.scaled:
        return float(setup.params.device.stiffness), float(setup.params.world.stiffness)  # type: ignore[arg-type]
    return setup.tuning.stiffness_N_m, setup.tuning.stiffness_N_m


@pytest.mark.parametrize("name", mostly_slow(["popc", "eba", "pd"], 1))
def test_a_wall_is_felt_at_once_however_long_the_link(name: str) -> None:
    """A proxy K' in the wall K_w, and the device's spring K to where it rests: F = K K_w / (K' + K_w) depth."""
    K, K_world = stiffnesses(name)
    off = {}
    for rendering in ("hapnet", "paper"):
        found = simulate({**TOUCHING, "coupling": name, "rendering": rendering}, seed=1).recording.device
        depth, force = found["position_m"][:, 0] - 0.02, found["force_N"][:, 0]
        inside = (depth > 2e-3) & (found["time_s"] < 2.0)  # it goes in, and rests
        own = K * 3000.0 / (K_world + 3000.0) * depth[inside]
        assert inside.sum() > 300
        off[rendering] = float(np.median(np.abs(-force[inside] - own)) / np.median(own))
    assert off["hapnet"] < min(0.05, 0.5 * off["paper"])


def lowest(name: str, link: str, lies: bool, seed: int) -> float:
    """The least energy that the hand has put in so far, in a hand that damps little [J]."""
    changes = {
        **LIGHT_HAND,
        "coupling": name,
        "rendering": "hapnet",
        "scene": "moving",
        "link.up": link,
        "link.down": link,
    }
    run = Simulation(Params().set(changes), seed, kernel=False)
    scene: Any = run.world.scene
    if lies:
        scene.planes = lying_planes(np.random.default_rng(seed))
    device = run.device.device
    advance, energies = device.advance, [0.0]

    def counted() -> float:
        work = advance()
        energies.append(energies[-1] + work)
        return work

    device.advance = counted  # type: ignore[method-assign]
    run.run()
    return min(energies)


@pytest.mark.parametrize("lies", [False, True], ids=["true", "lying"])
@pytest.mark.parametrize("link", mostly_slow(["lan", "4g", "intercontinental"], 1))
def test_ebas_port_is_passive_whatever_the_stages_choose(link: str, lies: bool) -> None:
    """Its bound holds for any force that is asked for (Kim, Ryu 2004)."""
    assert lowest("eba", link, lies, 2) >= -1e-9


@pytest.mark.parametrize("link", mostly_slow(["lan", "4g", "intercontinental"], 1))
def test_popcs_port_is_passive_but_for_a_tick_of_its_force(link: str) -> None:
    """At most 3.3 N for 1 ms at 1 m/s: the controller acts one tick later."""
    assert lowest("popc", link, False, 2) >= -3.3e-3


def test_where_the_world_lies_popc_takes_nine_tenths_of_what_a_spring_gives_out() -> None:
    """The rest is what its limits leave: it damps by no more than 5 Ns/m, and only while the hand moves."""
    assert lowest("popc", "4g", True, 2) > 0.1 * lowest("zoh", "4g", True, 2)
    assert lowest("zoh", "4g", True, 2) < -0.1


def test_with_the_stages_pd_claims_nothing() -> None:
    """Its proof needs the other side's real position."""
    params = Params().set({"coupling": "pd", "link.up": "delay 5ms", "link.down": "delay 5ms", "device.own_damping": 9})
    for rendering, claims in (("auto", True), ("paper", True), ("hapnet", False)):
        setup = prepare(params.set({"rendering": rendering}))
        assert setup.coupling.covers(setup.params, setup.tuning, virtual=True) is claims


@pytest.mark.parametrize(("name", "sends"), [("tdpa", "Port"), ("wave", "Wave"), ("digital-wave", "Wave")])
def test_a_law_without_a_set_position_says_so(name: str, sends: str) -> None:
    says = rf"^rendering is 'hapnet'; allowed: auto or paper with the coupling {name}: it sends {sends}, so it has no"
    with pytest.raises(InvalidParameter, match=says):
        prepare({"coupling": name, "rendering": "hapnet"})


def test_auto_is_the_laws_own() -> None:
    staged = {name for name in COUPLINGS if prepare({"coupling": name}).params.rendering == "hapnet"}
    assert staged == {"pspm", "zoh"}
    assert prepare({"coupling": "popc"}).params.rendering == "auto"
    assert prepare({"coupling": "popc"}).params.device.stiffness == 100.0
    assert prepare({"coupling": "popc", "rendering": "hapnet"}).params.device.stiffness == 600.0  # by rule, as of zoh


def test_an_older_recording_of_a_law_without_set_positions_can_be_run_again() -> None:
    """Every law's feel was hapnet by default."""
    assert Params.recorded({"coupling": "wave", "rendering": "hapnet"}).rendering == "auto"
    assert Params.recorded({"coupling": "wave"}).rendering == "paper"
    assert Params.recorded({"coupling": "zoh", "rendering": "hapnet"}).rendering == "hapnet"


def test_a_strangers_law_has_them_too() -> None:
    changes = {**TOUCHING, "coupling": "examples.own_law:Mine"}
    assert coupling("examples.own_law:Mine").takes_positions
    found = simulate(changes, seed=1)
    assert found.world.endpoint.coupling is not None
    plain = simulate({**changes, "rendering": "paper"}, seed=1)
    moved = [run.summary["motion"]["free_rms_m"] or 0.0 for run in (found, plain)]
    assert moved[0] < 0.7 * moved[1]


def test_the_former_name_is_read() -> None:
    former = prepare({"feel": "paper"}).params
    assert former == prepare({"rendering": "paper"}).params
    assert former.feel == former.get("feel") == "paper"
