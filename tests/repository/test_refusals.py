"""What every refusal must be: a sentence that names what is wrong and what is allowed, without a riddle.

`python -m tests.repository.refusals` prints them all, for a person who reads them.
"""

import re

import pytest

from hapnet.errors import InvalidParameter
from netem import ProfileError
from tests.repository.refusals import refusals

NOTHING_ALLOWED = re.compile(
    r"; allowed: (no (?!more )|none[:;]|left out:|its default|given |another |other |any other|permitted|with |without "
    r"|on the |only |each |either .* not both|fewer|$)"
)
"""What follows "allowed:" is a value that could be given. For a reason there is `why`."""


@pytest.mark.long
def test_the_refusals_are_found() -> None:
    """Many, of all packages, with the texts of their variables."""
    assert len(refusals()) > 600
    texts = {refusal.text for refusal in refusals()}
    assert "--out {str(out)}: --no-files writes no files; leave one of the two out" in texts
    assert "{name} is {value}; allowed: a finite number above 0" in texts
    assert any(refusal.file.startswith("netem/") for refusal in refusals())


@pytest.mark.parametrize("text", [
    "ecn: ecn is not allowed; allowed: no marking: messages have no ECN field", "x is 3; allowed: left out: y reads it",
    "--out is a; allowed: no --out with --no-files", "x is 3; allowed: ", "mesh is 9 triangles; allowed: fewer",
])  # fmt: skip
def test_a_riddle_is_recognized(text: str) -> None:
    assert NOTHING_ALLOWED.search(text)


@pytest.mark.long
def test_after_allowed_comes_what_is_allowed() -> None:
    assert [refusal for refusal in refusals() if NOTHING_ALLOWED.search(refusal.text)] == []


def test_each_is_one_line_and_no_question_alone() -> None:
    for refusal in refusals():
        assert "\n" not in refusal.text, refusal
        assert not refusal.text.endswith((":", ";", " ")), refusal


def test_a_reason_survives_another_name() -> None:
    """Errors are raised again with the name that the user knows."""
    error = InvalidParameter("size", 3, "", why="it is too large").renamed("scene box: size")
    assert str(error) == "scene box: size 3: it is too large"
    again = InvalidParameter("size", 3, "1 to 2", ("a",)).renamed("box", "3m")
    assert (str(again), again.known) == ("box is '3m'; allowed: 1 to 2", ("a",))


def test_a_profiles_reason_is_the_message() -> None:
    import pickle

    error = ProfileError("ecn", "ecn", "", why="messages have no ECN field")
    assert str(error) == "ecn: messages have no ECN field"
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
