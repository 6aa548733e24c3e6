"""Digital waves: their replay, and the law over links that delay, lose, reorder and repeat."""

from collections.abc import Callable
from math import sqrt

import numpy as np
import pytest

from hapnet.control.coupling import WaveSample
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.registry import COUPLINGS
from hapnet.ext.laws.digital_wave import LOUDEST, Replay
from hapnet.params import Params
from hapnet.side.link_port import Packet
from hapnet.simulation.simulation import Result, Simulation
from netem import Link
from tests.support.wave_ports import put_in

TOLERANCE_J = 1e-9
ROUGH = "delay 40ms 25ms loss 20% reorder 25%"


# -- the replay ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [2, 5, 16])
def test_one_wave_over_n_slots_goes_out_as_u_over_root_n(n: int) -> None:
    replay = Replay(2, n * 0.001)
    replay.push(WaveSample((1.0, -3.0), 0.001))
    for _ in range(n):
        assert replay.take(0.001) == pytest.approx((1.0 / sqrt(n), -3.0 / sqrt(n)))
    assert replay.take(0.001) == (0.0, 0.0)


def test_a_slot_longer_than_what_is_left_gets_the_mean() -> None:
    replay = Replay(1, 0.02)
    replay.push(WaveSample((1.0,), 0.02))
    assert replay.take(0.015) == pytest.approx((1.0,))
    assert replay.take(0.01) == pytest.approx((0.5,))
    assert replay.take(0.01) == (0.0,)


def test_waves_in_time_pass_in_full_and_every_other_lost_leaves_one_in_root_two() -> None:
    """The gain of a steady wave: what is lost is lost of the lowest frequencies too, so the two ends drift apart."""

    def gain(every: int) -> float:
        replay = Replay(1, 0.04)
        out = []
        for tick in range(2000):
            if tick % (20 * every) == 0:
                replay.push(WaveSample((1.0,), 0.02))
            out.append(replay.take(0.001)[0])
        return float(np.mean(out[1000:]))

    assert gain(1) == pytest.approx(1.0)
    assert gain(2) == pytest.approx(1.0 / sqrt(2.0))


def test_a_burst_is_not_played_louder_than_root_two() -> None:
    replay = Replay(1, 0.05)
    for _ in range(100):
        replay.push(WaveSample((1.0,), 0.02))
    assert replay.take(0.001) == pytest.approx((sqrt(LOUDEST),))


# -- the law's claim -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("jitter", "loss"), [(0, 0.0), (35, 0.0), (0, 0.5), (35, 0.5)])
def test_it_is_passive_whatever_comes_late_or_not_at_all(jitter: int, loss: float) -> None:
    for seed in range(2):
        result = put_in(Replay(1, 0.08), Replay(1, 0.08), seed, jitter=jitter, loss=loss, seconds=3.0)
        assert result.lowest >= -TOLERANCE_J


def params(**changes: object) -> Params:
    base = {"coupling": "digital-wave", "duration_s": 4.0}
    return Params().set({**base, **{name.replace("__", "."): value for name, value in changes.items()}})


def run(
    params: Params, patch: pytest.MonkeyPatch | None = None, copies: int = 1, seed: int = 0
) -> tuple[Result, float]:
    """The result and the two-port margin [J]; with `patch`, every message sent several times."""
    simulation = Simulation(params, seed)
    if patch is not None:
        for link in (simulation.up, simulation.down):
            patch.setattr(link, "send", repeated(link, copies))
    return simulation.run(), simulation.two_port.lowest


def repeated(link: Link[Packet], copies: int) -> Callable[[int, Packet, int], None]:
    """Sending as the link does, but `copies` times: netem itself never repeats anything."""
    once = link.send

    def send(now_ns: int, parcel: Packet, size: int) -> None:
        for _ in range(copies):
            once(now_ns, parcel, size)

    return send


@pytest.mark.parametrize("operator", ["press", "sine"])
@pytest.mark.parametrize("link", ["lan", "4g", "wan-intercontinental", ROUGH])
def test_whole_runs_are_passive(link: str, operator: str) -> None:
    assert run(params(link__up=link, link__down=link, operator=operator))[1] >= -TOLERANCE_J


def test_duplicates_are_discarded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over a constant delay a run in which every message comes three times is the same run, to the last bit."""
    link = params(link__up="delay 40ms", link__down="delay 40ms")
    (once, _), (thrice, _) = run(link), run(link, monkeypatch, copies=3)
    for side in ("device", "world"):
        a, b = getattr(once.recording, side), getattr(thrice.recording, side)
        assert all(np.array_equal(a[name], b[name], equal_nan=True) for name in a)
    for seed in range(3):
        assert run(params(link__up=ROUGH, link__down=ROUGH), monkeypatch, copies=3, seed=seed)[1] >= -TOLERANCE_J


def test_the_rule() -> None:
    """The replay is spread over the longest time between two arrivals: a step and the jitter."""
    tuning = COUPLINGS["digital-wave"].tune(params(device__stiffness=100.0), Delays(0.035, 0.118))
    assert tuning.spread_s == pytest.approx(0.05 + 0.048)
    assert tuning.impedance_Ns_m == 5.0
