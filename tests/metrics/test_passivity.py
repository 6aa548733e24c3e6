"""The margin of both ports together, of columns whose sums are known by hand."""

from typing import Any

import numpy as np
import pytest

from hapnet.recording.samples import Columns, Recording
from hapnet.summary.from_samples import min_total_margin, total_margin


def columns(*samples: tuple[float, float]) -> Columns:
    time_s, margin_J = np.array(samples).T
    return {"time_s": time_s, "margin_J": margin_J}


def recording(device: Columns | None, world: Columns | None, **meta: Any) -> Recording:
    return Recording(meta, device, world, [], None)


DEVICE = columns((0, 5), (1, -4), (2, 3), (3, 2), (4, 1))
WORLD = columns((0.5, 5), (1.5, 8), (3.5, -1))


def test_each_side_counts_with_its_last_sample_as_far_as_both_go() -> None:
    total = total_margin(recording(DEVICE, WORLD))
    assert total["time_s"].tolist() == [0.5, 1, 1.5, 2, 3, 3.5]
    assert total["margin_J"].tolist() == [10, 1, 4, 11, 10, 1]


def test_the_least_is_not_the_sum_of_the_least() -> None:
    assert min_total_margin(recording(DEVICE, WORLD)) == 1.0  # and -4 + -1 = -5
    assert min_total_margin(recording(WORLD, DEVICE)) == 1.0


def test_what_comes_out_of_both_at_once_shows() -> None:
    assert min_total_margin(recording(DEVICE, columns((0, 2), (1, 1), (5, 9)))) == -3.0


def test_what_is_not_known_is_left_out() -> None:
    world = columns((0.5, 5), (1.0, np.nan), (1.5, 8), (3.5, 2))
    assert min_total_margin(recording(DEVICE, world)) == 4.0
    assert min_total_margin(recording(DEVICE, columns((0, np.nan), (4, np.nan)))) is None


@pytest.mark.parametrize(
    "alone",
    [
        recording(DEVICE, None),
        recording(None, WORLD),
        recording(DEVICE, WORLD, aligned=False),
        recording(DEVICE, columns((5, 1), (6, 1))),
    ],
)
def test_none_without_both_at_one_time(alone: Recording) -> None:
    assert total_margin(alone) is None
    assert min_total_margin(alone) is None
