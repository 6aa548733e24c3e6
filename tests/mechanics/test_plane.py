"""What a user's world may send as planes."""

import math

import numpy as np
import pytest

from hapnet.errors import InvalidParameter
from hapnet.mechanics.plane import Plane, checked
from hapnet.wire.messages import Proxy, decode
from hapnet.wire.stream import PositionStream

FLOOR = Plane((0.0, 0.6, 0.8), 0.02, 300.0, 1.0, 0.1)


def test_numbers_of_any_kind_are_sent() -> None:
    reported = checked([Plane(np.array(FLOOR.normal), np.float32(0.5), 300, 0)], 3)  # type: ignore[arg-type]  # a user's
    assert reported == (Plane((0.0, 0.6, 0.8), 0.5, 300.0, 0.0, 0.0),)
    still = (0.0, 0.0, 0.0)
    message = decode(PositionStream(1).proxy(3, still, 0, still, reported))
    assert isinstance(message, Proxy)
    assert message.planes == (reported[0][:5],)
    assert message.more is None


def test_a_ball_that_nothing_else_is_said_of_is_a_spring_alone() -> None:
    """At rest and frictionless; its nearest point is 3 mm ahead."""
    normal, *values, _, friction, effects = Plane.of_ball((0.1, 0.0), (0.133, 0.0), 0.03, 300.0)
    assert normal == (1.0, 0.0)
    assert values == pytest.approx([0.103, 300.0, 0.0, 0.0])
    assert (friction, effects) == (0.0, None)


def test_the_first_four_are_told() -> None:
    walls = [FLOOR._replace(offset_m=0.01 * k) for k in range(6)]
    assert checked(iter(walls), 3) == tuple(walls[:4])


@pytest.mark.parametrize(
    "wrong",
    [
        {"normal": (0.0, 0.0, 2.0)},
        {"normal": (0.0, 1.0)},
        {"normal": (math.nan, 0.0, 1.0)},
        {"offset_m": math.inf},
        {"stiffness": 0.0},
        {"damping": -1.0},
        {"velocity_mps": math.nan},
    ],
)
def test_what_a_device_would_drop_is_refused_where_it_is_made(wrong: dict[str, object]) -> None:
    with pytest.raises(InvalidParameter, match="a plane's"):
        checked([FLOOR, FLOOR._replace(**wrong)], 3)  # type: ignore[arg-type]  # one name at a time
