"""The example of a linkage: its kinematics against bars and differences, its account against the joints' work."""

import math
from itertools import pairwise, product

import numpy as np
import pytest

from examples import pantograph
from examples.pantograph import ARM, BASE, CENTRE, FOREARM, Linkage, Pantograph, angles
from hapnet.assembly.build import device_session, device_side, prepare
from hapnet.checks import Array, Vector
from hapnet.side.endpoint import DeviceEndpoint
from hapnet.side.real_device import RealDeviceSide
from tests.conftest import ROOT, mostly_slow
from tests.support.paper import PAPER

PLACES = [(CENTRE[0] + x, CENTRE[1] + y) for x, y in product(np.linspace(-0.03, 0.03, 7), np.linspace(-0.03, 0.03, 7))]
FORCES: list[Vector] = [(1.0, 0.0), (0.0, 1.0), (-0.3, 0.8)]


def differences(turned: Vector, step: float = 1e-6) -> Array:
    """dx/dq by central differences."""
    columns = []
    for k in (0, 1):
        ends = [Linkage(*(q + sign * step * (j == k) for j, q in enumerate(turned))).handle for sign in (1.0, -1.0)]
        columns.append(np.subtract(*ends) / (2.0 * step))
    return np.column_stack(columns)


@pytest.mark.parametrize("place", PLACES)
def test_the_bars_have_their_lengths_and_the_way_back_is_the_way_there(place: tuple[float, float]) -> None:
    left, right = angles(*place)
    elbows = (ARM * math.cos(left), ARM * math.sin(left)), (BASE + ARM * math.cos(right), ARM * math.sin(right))
    assert [math.dist(elbow, place) for elbow in elbows] == pytest.approx([FOREARM, FOREARM], abs=1e-15)
    assert elbows[0][0] < place[0] < elbows[1][0]  # outwards
    assert Linkage(left, right).handle == pytest.approx(place, abs=1e-14)


@pytest.mark.parametrize("place", PLACES)
def test_the_jacobian_is_the_derivative_of_the_place(place: tuple[float, float]) -> None:
    turned = angles(*place)
    assert np.array(Linkage(*turned).jacobian) == pytest.approx(differences(turned), rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("force", FORCES)
def test_torques_do_the_force_s_work_and_come_back_as_it(place: tuple[float, float], force: Vector) -> None:
    """Virtual work: torques along small turns are the force along the small way that they make."""
    turned = angles(*place)
    link = Linkage(*turned)
    torques = link.torques(force)
    assert torques == pytest.approx(tuple(differences(turned).T @ force), rel=1e-7, abs=1e-9)
    assert link.force(torques) == pytest.approx(force, abs=1e-13)


def test_the_force_halfway_accounts_to_the_third_order() -> None:
    """Held torques over a turn: with the force of its middle the error falls eightfold where the turn is halved."""
    torques = (0.05, -0.03)

    def errors(size: float) -> tuple[float, float]:
        start, turn = angles(*CENTRE), (0.8 * size, -0.6 * size)
        end = tuple(q + d for q, d in zip(start, turn, strict=True))
        way = np.subtract(Linkage(*end).handle, Linkage(*start).handle)
        work = np.dot(torques, turn)
        middle = Linkage(*[(a + b) / 2 for a, b in zip(start, end, strict=True)])
        return abs(np.dot(middle.force(torques), way) - work), abs(np.dot(Linkage(*start).force(torques), way) - work)

    (halfway, at_the_start), (halfway_of_half, at_the_start_of_half) = errors(0.02), errors(0.01)
    assert halfway / halfway_of_half == pytest.approx(8.0, rel=0.05)
    assert at_the_start / at_the_start_of_half == pytest.approx(4.0, rel=0.05)
    assert halfway < 0.02 * at_the_start


class Timed(Pantograph):
    """By a time that the test has."""

    now_s = 0.0

    def __init__(self, dof: int) -> None:
        super().__init__(dof, lambda: Timed.now_s)


@pytest.mark.parametrize("count", mostly_slow([(one,) for one in [1e-12, pantograph.COUNT]], 1))
def test_the_account_of_a_run_is_the_joints_work(monkeypatch: pytest.MonkeyPatch, count: float) -> None:
    """4 s, the spring's end on a circle of 15 mm around a hand that goes 30 mm. The motors integrate their own work.

    Encoders that round by r at most put the account off by the sum of the forces' changes times r (Abel's summation).
    """
    monkeypatch.setattr(pantograph, "COUNT", count)
    monkeypatch.setattr(Timed, "now_s", 0.0)
    own = {"hardware": f"{__name__}:Timed", "dof": 2, "scene": "free"}
    setup = prepare(PAPER.set(own | {"device.self_test_N": 0.0, "device.force_ramp_s": 0.0}))
    endpoint = DeviceEndpoint(device_session(setup, 1))
    side = device_side(setup, endpoint, lambda: round(1e9 * Timed.now_s), lambda _: None)
    assert isinstance(side, RealDeviceSide)
    driver = side.device.device  # type: ignore[attr-defined]  # the user's, inside
    endpoint.paired = True
    forces: list[Vector] = [(0.0, 0.0)]
    for k in range(4000):
        Timed.now_s = 1e-3 * k
        side.tick(round(1e6 * k))
        if k % 20 == 0:
            phase = 2.0 * math.pi * Timed.now_s
            side.coupling.receive((0.015 * math.cos(phase), 0.015 * math.sin(phase)), 0.0, 1e-3)
        forces.append(driver.acted())
    rounded_J = 0.09 * count / math.sqrt(2.0) * sum(math.dist(a, b) for a, b in pairwise(forces))
    assert max(math.hypot(*force) for force in forces) > 0.5
    assert driver.motors.work > 0.01
    assert -side.coupling.ledger.work == pytest.approx(driver.motors.work, abs=1e-6 + rounded_J)


def test_the_page_shows_the_example() -> None:
    page = (ROOT / "hapnet" / "devices" / "pantograph.md").read_text("utf-8")
    source = (ROOT / "examples" / "pantograph.py").read_text("utf-8")
    kinematics = source[source.index("Vector = ") : source.index("class Pantograph")].strip()
    assert kinematics in page
    assert len(kinematics.splitlines()) <= 60
