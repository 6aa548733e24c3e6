"""An FR3 follows a hand that moves and turns a tool, with the numbers of the example."""

import pytest

from tests.measure.franka_pose import follow


@pytest.mark.slow
def test_it_turns_with_a_hand_within_a_degree_and_stays_passive_while_the_network_is_pulled() -> None:
    """Over 4g, whose delay is 35 ms; its own lag is predicted. The stand-in's joints are masses by themselves."""
    found = follow("hand-25", 10.0, (4.0, 6.0))
    assert found.error_deg(0.05) < 1.0
    assert found.error_mm(0.05) < 5.0
    assert found.largest_step_N < 0.75
    assert found.least_margin_J >= 0.0
    assert found.least_slack_J >= -1e-12
    assert len(found.robot) > 900  # in every hundredth of a second; it never stopped
