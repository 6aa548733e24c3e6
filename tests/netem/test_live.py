"""What a relay shows of itself: figures that are known, as a line and as a table."""

import io
import re
from dataclasses import asdict, dataclass, replace

import pytest

from netem.link import Link
from netem.live import line, print_table
from netem.profile import LinkProfile
from netem.stats import LinkStats

NONE = Link[None](LinkProfile()).stats
SOME = replace(
    NONE, profile="delay 5ms", offered=200, delivered=150, lost=30, resent=7, recovered=5, lost_down=12,
    dropped_limit=6, corrupted=8, duplicated=10, reordered=1, in_flight=2, delay_mean_ms=1.5, delay_std_ms=0.25,
    delay_p50_ms=1.2344, delay_p99_ms=3.0,
)  # fmt: skip


@dataclass(frozen=True)
class Figures:
    up: LinkStats
    down: LinkStats
    clients_seen: int
    dropped: int

    def as_dict(self) -> dict[str, object]:
        return asdict(self)


@pytest.mark.parametrize(("dropped", "alarms"), [(4, "  dropped 4"), (0, "")])
def test_a_line_has_all_that_is_gone_and_what_the_relay_dropped(dropped: int, alarms: str) -> None:
    shown = line(12.34, Figures(SOME, NONE, 3, dropped))
    up, down = "up in 200 out 150 lost 24.00 % p50 1.234 ms", "down in 0 out 0 lost - p50 -"
    assert shown == f"    12.3 s  {up}  |  {down}{alarms}"


def test_the_table_has_every_figure() -> None:
    out = io.StringIO()
    print_table(Figures(SOME, NONE, 3, 4), 12.34, out)
    title, *rows = [re.split(r"\s{2,}", text.strip()) for text in out.getvalue().splitlines() if text.strip(" ─")]
    assert title == ["after 12.3 s"]
    assert rows == [
        ["up", "down"], ["profile", "delay 5ms", "(nothing)"], ["offered", "200", "0"],
        ["delivered", "150 (75.00 %)", "0"], ["lost", "30 (15.00 %)", "0"], ["resent", "7", "0"],
        ["recovered", "5 (2.50 %)", "0"], ["lost while down", "12", "0"], ["dropped over limit", "6", "0"],
        ["corrupted", "8", "0"], ["duplicated", "10 (5.00 %)", "0"], ["reordered", "1 (0.50 %)", "0"],
        ["in flight", "2", "0"], ["delay mean", "1.500 ms", "-"], ["delay std", "0.250 ms", "-"],
        ["delay p50", "1.234 ms", "-"], ["delay p99", "3.000 ms", "-"],
        ["clients seen 3", "dropped 4"],
    ]  # fmt: skip
