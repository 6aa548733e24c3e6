"""Planes in a message of the world."""

from typing import Any

import msgpack
import pytest

from hapnet.wire.messages import Proxy, decode
from tests.wire.test_messages import A, inf, nan, rejected

PLANE: list[Any] = [[1.0, 0.0], 0.02, 3000.0, 10.0, 0.0]


def proxy(planes: object, **more: object) -> list[object]:
    return [2, 10, A, 0, 0, [0.04, 0.0], 0, [0.0, 0.0], planes, 0, 0, *([more] if more else [])]


@pytest.mark.parametrize(
    ("kind", "planes"),
    [
        ("type", 1.0), ("type", [1.0]), ("type", [PLANE[:-1]]), ("type", [[*PLANE, 0.0]]), ("type", [[*PLANE[:4], 0]]),
        ("range", [PLANE] * 9),
        ("range", [[[1.0, 0.01], *PLANE[1:]]]), ("range", [[[0.99, 0.0], *PLANE[1:]]]),
        ("range", [[*PLANE[:2], 0.0, 10.0, 0.0]]), ("range", [[*PLANE[:2], -1.0, 10.0, 0.0]]),
        ("range", [[*PLANE[:3], -1e-9, 0.0]]), ("range", [[*PLANE[:4], nan]]), ("range", [[PLANE[0], inf, *PLANE[2:]]]),
    ],
)  # fmt: skip
def test_a_plane_is_a_unit_normal_and_four_numbers(kind: str, planes: object) -> None:
    assert rejected(proxy(planes)).kind == kind
    for fine in (None, [], [PLANE] * 4, [[*PLANE[:3], 0.0, -0.1]]):
        assert isinstance(decode(msgpack.packb(proxy(fine))), Proxy)


@pytest.mark.parametrize(("name", "most"), [("reach", 1e6), ("level", 1.0)])
def test_reach_and_level_are_within_their_ranges(name: str, most: float) -> None:
    for wrong, kind in ((1, "type"), (None, "type"), (-1e-9, "range"), (1.001 * most, "range"), (nan, "range")):
        assert rejected(proxy([], **{name: wrong})).kind == kind
    for fine in (0.0, most):
        message = decode(msgpack.packb(proxy([], **{name: fine})))
        assert isinstance(message, Proxy)
        assert message.more == {name: fine}
