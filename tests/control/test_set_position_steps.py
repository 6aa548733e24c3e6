"""The limits of y for a tool that touches something, by their rules."""

import pytest

from hapnet.control.predicted_device import PredictedDevice
from hapnet.control.prediction import MotionPredictor
from hapnet.control.set_position_steps import FADE_S, ToolInContact

LAG_S, AGE_S, SPEED = 0.02, 0.05, 0.3


def moving() -> PredictedDevice:
    """A device that moves with 0.3 m/s along the first of twelve axes, and is at 0 at its newest stamp, 1 s."""
    predicted = PredictedDevice((0.0,) * 12, LAG_S, MotionPredictor(0.06, 0.2, 0.1))
    for k in range(13):
        before = 0.005 * (k - 12)
        predicted.receive((SPEED * before, *(0.0,) * 11), 1.0 + before, AGE_S)
    return predicted


@pytest.mark.parametrize(("touching_s", "share"), [(0.0, 1.0), (0.25 * FADE_S, 0.75), (FADE_S, 0.0), (5 * FADE_S, 0.0)])
def test_in_contact_the_hand_is_predicted_less_far(touching_s: float, share: float) -> None:
    """y is the constant speed times the used part of the time, and the proxy then stands for an earlier time."""
    tool, predicted, dt = ToolInContact(1.0), moving(), 0.005
    for _ in range(round(touching_s / dt)):
        tool.predict_less(dt, True, predicted)
    assert predicted.share == pytest.approx(share)
    ahead = share * (AGE_S + LAG_S + dt / 2.0)
    assert predicted.step(dt, (0.0,) * 12)[0] == pytest.approx(SPEED * ahead, abs=1e-9)
    assert predicted.stands_for(dt) == pytest.approx(1.0 + ahead - LAG_S + dt / 2.0)


def test_without_contact_the_whole_prediction_returns() -> None:
    tool, predicted = ToolInContact(1.0), moving()
    tool.predict_less(2.0 * FADE_S, True, predicted)
    for share in (0.4, 0.8, 1.0):
        tool.predict_less(0.4 * FADE_S, False, predicted)
        assert predicted.share == pytest.approx(share)


def test_y_stays_near_the_tool() -> None:
    tool = ToolInContact(0.01)
    x, y = (0.1, *(0.0,) * 11), [0.13, 0.04, *[0.0] * 10]
    tool.keep_near(x, y)
    assert y == pytest.approx([0.106, 0.008, *[0.0] * 10])
    tool.keep_near(x, y)
    assert y == pytest.approx([0.106, 0.008, *[0.0] * 10])
