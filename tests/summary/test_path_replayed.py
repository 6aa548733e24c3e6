"""`path` with a stranger who repeats all that both sides send, encrypted or not: it is what it is without him."""

import random
from collections.abc import Iterable

import pytest

from hapnet.params import Params
from hapnet.side.link_port import LinkPort, Packet
from hapnet.summary.structure import DIRECTIONS
from tests.conftest import mostly_slow
from tests.support.forger import Keyed


class Repeated(Keyed):
    """A run whose frames are all repeated once, after 0 to 2 s. secrets : are they encrypted?

    The first two or three count once when they are repeated: they came before the pair was made.
    """

    def __init__(self, params: Params, seed: int, *, repeats: bool, secrets: bool) -> None:
        self._heard: list[tuple[int, bool, Packet]] = []
        self._repeats, self._rng = repeats, random.Random(seed)
        super().__init__(params, seed, secrets=secrets)

    def _keep(self, packets: Iterable[Packet], *, up: bool) -> list[Packet]:
        packets = list(packets)
        self._heard += [(self.now_ns + self._rng.randrange(2 * 10**9), up, packet) for packet in packets]
        return packets

    def receive(self, port: LinkPort, packets: Iterable[Packet]) -> None:
        super().receive(port, self._keep(packets, up=port is self.world_port))

    def step(self, now_ns: int) -> Packet | None:
        due = [each for each in self._heard if each[0] <= now_ns]
        self._heard = [each for each in self._heard if each[0] > now_ns]
        for _, up, packet in due if self._repeats else ():
            self.add(self.world_port if up else self.device_port, [packet])
        return super().step(now_ns)


@pytest.mark.parametrize("secrets", mostly_slow([False, True], 0, 1), ids=["plain", "encrypted"])
@pytest.mark.parametrize(
    "coupling",
    ["pspm", pytest.param("tdpa", marks=pytest.mark.slow), pytest.param("wave", marks=pytest.mark.slow)],
)
def test_the_path_is_the_same_with_a_stranger_who_repeats_frames(coupling: str, secrets: bool) -> None:
    words = {"duration_s": 10.0, "coupling": coupling, "link.up": "delay 30ms 10ms loss 5%"}
    params = Params().set(words | {"link.down": words["link.up"]})
    alone, watched = (
        Repeated(params, 3, repeats=repeats, secrets=secrets).run().summary["path"] for repeats in (False, True)
    )
    for key in ("round_trip_min_ms", "round_trip_p50_ms", "round_trip_p99_ms"):
        assert watched[key] == pytest.approx(alone[key], rel=0.1), (
            key
        )  # both draw anew; what he repeats is up to 2 s old
    for direction in DIRECTIONS:
        with_him, without = watched[direction], alone[direction]
        assert with_him is not None
        assert without is not None
        for key, share in (("jitter_p99_ms", 0.05), ("age_p99_ms", 0.3)):  # two that are lost in a row make the age
            assert with_him[key] == pytest.approx(without[key], rel=share), (direction, key)
        assert with_him["loss"] == pytest.approx(without["loss"], abs=0.03)  # each of 320 draws anew: 2.5 deviations
        assert with_him["arrived"] <= with_him["sent"]
        shares = [(flow["overtaken"] or 0) / (flow["sent"] or 1) for flow in (with_him, without)]
        assert shares[0] == pytest.approx(shares[1], abs=0.02)  # of 320, about one in a hundred: as above
