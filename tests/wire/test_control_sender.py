"""When hellos, replies and byes are sent: the times and numbers of the protocol's page."""

from hapnet.wire.control_sender import ControlSender
from hapnet.wire.messages import Bye, Hello, Identity, Refuse, Welcome

MS = 1_000_000
ME = Identity(1, "device", 2, "pen", {})


def sender() -> ControlSender:
    return ControlSender(ME, 100 * MS)


def sent(control: ControlSender, times: range, *, searching: bool) -> list[int]:
    """When it sends something, polled at these times [ms]."""
    return [ms for ms in times if control.poll(ms * MS, searching=searching)]


def test_a_side_that_searches_says_hello_every_period() -> None:
    control = sender()
    assert sent(control, range(350), searching=True) == [0, 100, 200, 300]
    assert control.hellos == 4
    assert control.next_due_ns == 400 * MS


def test_one_hello_is_enough_for_a_stranger_and_not_within_20_ms_of_the_last() -> None:
    control = sender()
    control.poll(0, searching=True)
    control.stop_hellos()
    assert control.next_due_ns is None
    for ms in range(5, 15):  # strangers speak all the time
        control.say_hello(ms * MS)
    assert control.next_due_ns == 20 * MS
    assert sent(control, range(15, 500), searching=False) == [20]


def test_at_most_eight_replies_leave_in_10_ms_and_one_to_each() -> None:
    control = sender()
    control.stop_hellos()
    for who in range(2, 30):
        control.reply(Welcome(1, who, 1, "device", 2, "pen", {}))
    control.reply(Refuse(1, 2, "changed my mind"))
    first = control.poll(0, searching=False)
    assert [m.addressee for m, _ in first if not isinstance(m, Hello)] == list(range(2, 10))
    assert first[0].message == Refuse(1, 2, "changed my mind")
    control.reply(Refuse(1, 40, "late"))
    assert control.next_due_ns == 10 * MS
    assert sent(control, range(1, 100), searching=False) == [10]


def test_three_byes_20_ms_apart_are_the_last_words() -> None:
    control = sender()
    control.reply(Refuse(1, 2, "too late"))
    bye = Bye(1, 2, 0, "the end")
    control.say_bye(bye, None, 5 * MS)
    said = [(ms, control.poll(ms * MS, searching=True)) for ms in range(5, 300)]
    assert [(ms, out) for ms, out in said if out] == [(ms, [(bye, None)]) for ms in (5, 25, 45)]
    assert control.next_due_ns is None
