"""What is said of a frame that is refused."""

import pytest

from tests.wire.test_messages import HELLO, A, nan, rejected


@pytest.mark.parametrize(
    ("words", "frame"),
    [
        ("type: sequence is 1.5; allowed: int", [2, 1, A, 1.5, 0, [0.0], 0, 0]),
        ("type: position[1] is 1; allowed: a float", [2, 1, A, 0, 0, [0.0, 1], 0, 0]),
        ("range: position[0] is nan; allowed: float >= -1000000.0", [2, 1, A, 0, 0, [nan], 0, 0]),
        ("dimension: position is of length 0; allowed: array of length >= 1", [2, 1, A, 0, 0, [], 0, 0]),
        ("range: level is 1.5; allowed: float <= 1.0", [2, 1, A, 0, 0, [0.0], 0, 0, {"level": 1.5}]),
        ("range: role is 'a\\nb'; allowed: device, world", [*HELLO[:4], "a\nb", *HELLO[5:]]),
        ("range: name is of length 257; allowed: str of length <= 256", [*HELLO[:6], "x" * 257, {}]),
        ("range: a part of about; allowed: str of length <= 256", [*HELLO[:7], {"a": "x" * 257}]),
        ("range: a part of about; allowed: finite numbers", [*HELLO[:7], {"a": nan}]),
    ],
)  # fmt: skip
def test_an_error_names_the_element_in_one_line(words: str, frame: object) -> None:
    assert str(rejected(frame)) == words
