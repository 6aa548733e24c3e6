import pytest

from hapnet.realtime.shutdown import GONE_NS, PeerAbsence
from hapnet.side.notices import Notice
from hapnet.wire.events import Paired, PeerHeard, PeerLeft, PeerSilent
from hapnet.wire.messages import Identity

LEFT = PeerLeft("the run is over")


class Side:
    """A world, what it reported and whether it was ended."""

    def __init__(self, *, once: bool) -> None:
        self.reported: list[Notice] = []
        self.ends = 0
        self.alone = PeerAbsence("world", once, self.reported.append, self._end)

    def _end(self) -> None:
        self.ends += 1


@pytest.mark.parametrize(
    ("left_s", "says"),
    [
        (57.2, ["waits for another device for the 57 s that are left (--once would end it now)"]),
        (None, ["waits for another device until it is stopped (--once would end it now)"]),
        (0.4, []),
    ],
)
def test_a_world_whose_device_has_left_says_how_long_it_waits(left_s: float | None, says: list[str]) -> None:
    side = Side(once=False)
    side.alone.happened(LEFT, 5, left_s)
    assert [notice.text for notice in side.reported] == says
    side.alone.watch(5 + 10 * GONE_NS, 0)
    assert side.ends == 0


def test_once_ends_it_when_its_device_leaves() -> None:
    side = Side(once=True)
    side.alone.happened(LEFT, 5, 57.2)
    assert side.ends == 1
    assert [notice.text for notice in side.reported] == ["this side ends, as its first device has left (--once)"]


def test_once_ends_it_when_its_device_is_gone_without_a_word() -> None:
    """Neither a silence of a second, nor a long one of a device that is still there, nor one that is over."""
    side = Side(once=True)
    begin = 70 * GONE_NS
    gone = begin + GONE_NS + 1
    side.alone.watch(gone, 0)  # nobody has come yet
    side.alone.happened(PeerSilent(begin), begin + 1, None)
    side.alone.watch(begin + GONE_NS, 0)
    side.alone.watch(gone, 1)
    assert side.ends == 0
    for back in (PeerHeard(1, 1, 0), Paired(Identity(3, "device", 1, "another", {}), 2)):
        side.alone.happened(back, gone, None)
        side.alone.watch(2 * gone, 0)
        assert side.ends == 0
        side.alone.happened(PeerSilent(begin), begin + 1, None)
    side.alone.watch(gone, 0)
    side.alone.watch(gone + 1, 0)
    assert side.ends == 1
    assert [notice.text for notice in side.reported] == [
        "this side ends: no data from its device for 10 s, and no connection (--once)"
    ]
