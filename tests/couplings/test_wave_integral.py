"""Wave integrals: what is lost on the way, or in the queue, comes out after all, and no energy with it."""

import math

import pytest
from hypothesis import given, settings, strategies as st

from hapnet.control.coupling import WaveSample
from hapnet.ext.laws.digital_wave import Replay
from hapnet.ext.laws.parts.wave_integral import IntegralLine, Recovery, WaveReceiver
from hapnet.ext.laws.wave import DelayLine
from hapnet.ext.metrics.motion import drift
from hapnet.params import Params
from hapnet.simulation.simulation import Simulation
from tests.support.wave_ports import Counted, put_in, reported

TOLERANCE_J = 1e-9

waves = st.lists(st.tuples(st.floats(-5.0, 5.0), st.floats(1e-3, 0.05)), min_size=1, max_size=30)


class Taken:
    """A line that keeps what it is given."""

    def __init__(self) -> None:
        self.waves: list[WaveSample] = []

    def push(self, wave: WaveSample) -> None:
        self.waves.append(wave)

    def take(self, dt: float) -> tuple[float, ...]:
        return (0.0,)

    def clear(self) -> None:
        self.waves.clear()


@given(sent=waves, data=st.data())
def test_whatever_arrives_the_displacement_is_the_newest_integrals_and_no_energy_is_gained(
    sent: list[tuple[float, float]], data: st.DataObject
) -> None:
    """Lost, repeated, in any order; only the first that arrives stands for itself alone."""
    messages = reported([WaveSample((value,), span) for value, span in sent])
    arrive = data.draw(st.lists(st.integers(0, len(sent) - 1), min_size=1, max_size=40))
    line = IntegralLine(taken := Taken())
    for number in arrive:
        line.push(messages[number])
    first, newest = arrive[0], max(arrive)
    since = sent[first : max(first, newest) + 1]
    moved = math.fsum(wave.value[0] * wave.span for wave in taken.waves)
    assert moved == pytest.approx(math.fsum(value * span for value, span in since), abs=1e-9)
    assert math.fsum(wave.span for wave in taken.waves) == pytest.approx(math.fsum(span for _, span in since))
    energy = math.fsum(wave.value[0] ** 2 * wave.span for wave in taken.waves) / 2.0
    assert energy <= math.fsum(value**2 * span for value, span in since) / 2.0 + TOLERANCE_J


def test_a_sender_that_tells_no_integrals_is_taken_at_its_word() -> None:
    line = IntegralLine(taken := Taken())
    for _ in range(3):
        line.push(WaveSample((1.0,), 0.02))
    assert taken.waves == [WaveSample((1.0,), 0.02)] * 3


def test_another_peer_counts_anew() -> None:
    line = IntegralLine(taken := Taken())
    first, second = reported([WaveSample((1.0,), 0.02)] * 2)
    line.push(second)
    line.clear()
    line.push(first)
    assert [wave[:2] for wave in taken.waves] == [((1.0,), 0.02)]


@pytest.mark.parametrize("recovery", [0.0, 0.05])
def test_what_a_queue_drops_comes_out_later(recovery: float) -> None:
    """An outage ends: half a second of waves comes at once. Without recovery most of it is lost."""
    line = Counted(DelayLine(1, 0.1, recovery=recovery))
    for number in range(25):
        line.push(WaveSample((1.0 + 0.1 * math.sin(number),), 0.02))
    for _ in range(2000):
        line.take(0.001)
    if recovery:
        assert line.moved_out == pytest.approx(line.moved_in, rel=1e-6)
    else:
        assert line.moved_out < 0.3 * line.moved_in


@settings(max_examples=200)
@given(lost=waves, then=st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=50), time=st.floats(1e-3, 1.0))
def test_recovery_never_spends_what_was_not_lost(
    lost: list[tuple[float, float]], then: list[float], time: float
) -> None:
    """At every instant, whatever the queue outputs beside it; and it never recovers more than was lost."""
    recovery = Recovery(1, time)
    for value, span in lost:
        recovery.lose(WaveSample((value,), span))
    owed, spare = recovery.owed[0], recovery.spare[0]
    dt = 0.001
    for z in then:
        (out,) = recovery.output(dt, (z,), (z * dt,), (z * z * dt,))
        spare -= (out**2 - z**2) / 2.0 * dt
        owed -= (out - z) * dt
        assert spare >= -1e-12
        assert recovery.owed[0] == pytest.approx(owed, abs=1e-9)
        assert math.copysign(1.0, recovery.owed[0]) == math.copysign(1.0, owed) or abs(owed) < 1e-9


def test_each_axis_recovers_by_itself() -> None:
    """As three of one axis do."""
    lost, waves, dt = (1.0, -2.0, 3.0), [(0.05, 0.1, -0.03), (-0.02, 0.04, 0.06)], 0.001
    together, alone = Recovery(3, 0.05), [Recovery(1, 0.05) for _ in range(3)]
    together.lose(WaveSample(lost, 0.02))
    for one, value in zip(alone, lost, strict=True):
        one.lose(WaveSample((value,), 0.02))
    for wave in waves:
        found = together.output(dt, wave, [z * dt for z in wave], [z * z * dt for z in wave])
        assert found == tuple(
            one.output(dt, (z,), (z * dt,), (z * z * dt,))[0] for one, z in zip(alone, wave, strict=True)
        )
        assert all(abs(out - z) > 0.1 for out, z in zip(found, wave, strict=True))


@pytest.mark.parametrize("make", [lambda: DelayLine(1, 0.3, recovery=0.05), lambda: Replay(1, 0.08)])
@pytest.mark.parametrize("loss", [0.1, 0.5])
def test_both_ports_together_are_passive_on_any_link(make: type[WaveReceiver], loss: float) -> None:
    for seed in range(2):
        result = put_in(IntegralLine(make()), IntegralLine(make()), seed, jitter=35, loss=loss, seconds=3.0)
        assert result.lowest >= -TOLERANCE_J


@pytest.mark.slow
@pytest.mark.parametrize(("coupling", "share"), [("wave", 0.1), ("digital-wave", 0.4)])
def test_the_ends_drift_apart_less(coupling: str, share: float) -> None:
    """Presses over a link that loses a tenth: how fast device and proxy drift apart, with and without integrals."""
    found = []
    for recovery_s in (0.1, 0.0):
        words = "delay 40ms 10ms loss 10%"
        simulation = Simulation(
            Params().set(
                {"coupling": coupling, "operator": "press", "duration_s": 12.0, "link.up": words, "link.down": words,
                 "wave.recovery_s": recovery_s}
            ), 1,
        )  # fmt: skip
        result = simulation.run()
        assert simulation.two_port.lowest >= -TOLERANCE_J
        slope = drift(result.recording, simulation.setup.scene.walls)
        found.append(abs(slope))
    assert found[0] < share * found[1]
