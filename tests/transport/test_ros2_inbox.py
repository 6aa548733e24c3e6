"""Which messages of a topic count: none that was held up, came again, is damaged or is another publisher's."""

import pytest

pytest.importorskip("rosbags.typesys")

from hapnet.errors import BadMessage
from hapnet.ext.robots.ros2_inbox import Inbox
from hapnet.transport.ros2 import Attachment

PERIOD_MS = 10
A, B = bytes(16), bytes(15) + b"\1"


class Topic:
    """An inbox of one topic with its own clock [ms]."""

    def __init__(self) -> None:
        self.now = 0
        self.inbox = Inbox(self.decode, PERIOD_MS * 1e-3, lambda: self.now * 1_000_000)

    def decode(self, data: bytes) -> str:
        if data == b"bad":
            raise BadMessage("cdr", "bad")
        return data.decode()

    def at(self, now: int, number: int, data: bytes = b"x", publisher: bytes = A) -> str | None:
        self.now = now
        self.inbox.take(data, Attachment(number, -1, publisher).encode())
        found = self.inbox.next()
        return None if found is None else found[0]


def test_the_newest_message_counts_once() -> None:
    topic = Topic()
    assert topic.at(0, 1, b"a") == "a"
    assert topic.inbox.next() is None
    topic.inbox.take(b"b", Attachment(2, -1, A).encode())
    assert topic.at(10, 3, b"c") == "c"
    assert topic.inbox.unused == ""


def test_nothing_that_was_held_up_acts() -> None:
    """A link stood still for a second. Then 100 messages come at once, and after them live ones."""
    topic = Topic()
    assert topic.at(0, 1) == "x"
    burst = [topic.at(1000 + k // 20, 2 + k) for k in range(100)]
    assert burst == [None] * 100
    assert topic.at(1004 + PERIOD_MS, 102, b"live") == "live"
    assert topic.inbox.late == 100


def test_nothing_acts_that_waited_while_this_process_stood_still() -> None:
    topic = Topic()
    topic.inbox.take(b"old", Attachment(1, -1, A).encode())
    topic.now = 1000
    assert topic.inbox.next() is None
    assert topic.inbox.late == 1


def test_what_is_missing_bad_repeated_or_foreign_is_counted() -> None:
    topic = Topic()
    assert topic.at(0, 5) == "x"  # whoever joins later knows nothing of earlier ones
    assert topic.at(10, 8) == "x"
    assert topic.at(11, 8) is topic.at(12, 7) is None
    assert topic.at(20, 9, b"bad") is None
    topic.inbox.take(b"x", b"")
    topic.inbox.take(b"x" * 70_000, Attachment(9, -1, A).encode())
    assert topic.at(21, 1, b"b", B) is None
    inbox = topic.inbox
    assert (inbox.lost, inbox.late, inbox.bad, inbox.foreign) == (2, 2, 3, 1)
    assert inbox.unused == "2 lost, 3 bad, 2 late, 1 of another publisher"
    topic.at(100, 2, b"b", B)  # the first one has gone
    assert topic.at(110, 3, b"b", B) == "b"
