"""Couplings whose world predicts the device though PSPM does not pay for it: where they do, and what still holds."""

import math

import pytest

from hapnet.assembly.build import prepare
from hapnet.control.coupling import LawState, PortSample
from hapnet.control.prediction import MotionPredictor
from hapnet.params import Params
from hapnet.simulation.simulation import Simulation
from tests.conftest import mostly_slow
from tests.support.hand_port import LIGHT_HAND, lowest_energies
from tests.support.tdpa_ends import world


def tuned(coupling: str, link: str, **changes: object) -> object:
    changes = {name.replace("__", "."): value for name, value in changes.items()}
    return prepare(Params().set({"coupling": coupling, "link.up": link, "link.down": link, **changes})).tuned[
        "predicts"
    ]


@pytest.mark.parametrize("coupling", ["popc", "eba"])
def test_a_law_at_the_device_predicts_over_short_delays_only(coupling: str) -> None:
    """B'/K' = 28 ms and half of the longest step, 25 ms, leave 7 ms of the 60."""
    assert tuned(coupling, "delay 6ms") is True
    assert tuned(coupling, "delay 8ms") is False
    assert tuned(coupling, "delay 8ms", **{f"{coupling}__predict_s": 0.1}) is True
    assert tuned(coupling, "delay 1ms", **{f"{coupling}__predict_s": 0.0}) is False
    assert tuned(coupling, "delay 1ms", rendering="paper") is False


def test_tdpa_predicts_if_asked_and_not_with_the_papers_feel() -> None:
    assert tuned("tdpa", "lan") is False
    assert tuned("tdpa", "lan", tdpa__predict=True) is True
    assert tuned("tdpa", "lan", tdpa__predict=True, rendering="paper") is False


@pytest.mark.parametrize(("coupling", "left_J"), mostly_slow([("popc", 2e-3), ("eba", 1e-9)], 1))
def test_free_motion_is_freer_and_the_hands_port_stays_passive(coupling: str, left_J: float) -> None:
    """The proxy lags by B'/K' and half a mean step, 43 ms. Prediction takes most of that away.

    popc leaves what its limits do not let it damp: a tick of the force, at most 3.3 N at 0.5 m/s.
    """
    error = {}
    for name, rendering in (("without", "paper"), ("with", "auto")):
        params = Params().set(
            {"coupling": coupling, "rendering": rendering, "scene": "free", "operator": "sine", "duration_s": 5.0,
             "device.servo": "sampled", "link.up": "lan", "link.down": "lan"}
        )  # fmt: skip
        error[name] = Simulation(params, 1).run().summary["motion"]["free_rms_m"]
    assert error["with"] < 0.4 * error["without"]
    light = Params().set({**LIGHT_HAND, "coupling": coupling, "link.up": "lan", "link.down": "lan"})
    assert lowest_energies(light, 2)[0] >= -left_J


def test_ebas_port_is_passive_however_far_the_world_predicts() -> None:
    """Over a delay the two ports together are not: eba claims nothing for them."""
    params = Params().set({**LIGHT_HAND, "coupling": "eba", "eba.predict_s": 1.0, "link.up": "4g", "link.down": "4g"})
    hand, _, both = lowest_energies(params, 2)
    assert hand >= -1e-9
    assert both < -0.1


@pytest.mark.parametrize("age", [0.0, 0.04])
def test_tdpas_world_is_where_the_device_is_at_a_steps_end(age: float) -> None:
    """The device moves on a parabola; its positions come `age` late, stamped by its own clock."""

    def x(t: float) -> float:
        return 0.05 * t - 0.02 * t * t

    law = world((x(0.0),), speed_limit_m_s=10.0, predictor=MotionPredictor())
    state = LawState(law, 0.05, law.stamped)
    now = reported = 0.0
    for step in range(60):
        dt = 0.01 + 0.02 * (step % 2)
        while reported <= now - age:
            state.receive(PortSample((x(reported),), 1.0), 100.0 + reported, now - reported)
            reported += 0.005
        law.begin()
        law.impedance(dt)
        now += dt
        goes = (x(now) - law.set_position[0]) / dt  # the mass goes along: nothing pulls
        law.moved(dt, (goes,), (x(now),), (goes,))
        if now > 0.3:
            assert law.set_position[0] == pytest.approx(x(now), abs=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("link", ["4g", "delay 40ms 10ms loss 20%"])
def test_tdpa_that_predicts_owes_no_more_than_it_claims(link: str) -> None:
    params = Params().set({**LIGHT_HAND, "coupling": "tdpa", "tdpa.predict": True, "link.up": link, "link.down": link})
    _, _, both = lowest_energies(params, 2)
    assert both >= -2.0 * params.tdpa.debt_limit_J
    assert math.isfinite(both)
