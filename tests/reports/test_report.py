import io
from typing import Any

import pytest
from rich.console import Console

from hapnet.summary.structure import read
from hapnet.summary.tables import brief, summary_text
from hapnet.summary.words import verdict

ALONE = "PASSIVITY NOT KNOWN: this coupling is passive only at both ports together, and the world's account is missing"
APART = "PASSIVITY NOT KNOWN: this coupling is passive only at both ports together, and no clock covers both"
NOTHING = "PASSIVITY NOT KNOWN: there is no energy account"
LINK = "delay 40ms 10ms distribution normal loss 2%"


@pytest.mark.parametrize(
    ("summary", "line"),
    [
        ({"theorem": {"margin_J": 0.0312, "bound_J": 0.1}}, "PASSIVE: gave out at most 68.8 mJ of the 100 mJ allowed"),
        ({"theorem": {"margin_J": -9e-13, "bound_J": 0.1}}, "PASSIVE: gave out at most 100 mJ of the 100 mJ allowed"),
        ({"theorem": {"margin_J": -2e-9, "bound_J": None}}, "NOT PASSIVE: the margin fell to -2e-06 mJ"),
        (
            {"theorem": None, "device": {"ledger": {"margin_J": 0.5, "bound_J": 0.6}}},
            "PASSIVITY NOT KNOWN: the world's account is missing; the device's half held and gave out at most 100 mJ "
            "of its 600 mJ",
        ),
        (
            {"device": {"ledger": {"margin_J": 0.5}}, "world": {"ledger": {"margin_J": 0.25}}},
            "PASSIVE: margin at least 750 mJ",
        ),
        ({"coupling": "pd", "device": {"ledger": {"margin_J": -0.5}}}, ALONE),
        ({"coupling": "popc", "world": {"ledger": {"margin_J": 0.5}}}, ALONE.replace("world", "device")),
        (
            {
                "coupling": "wave",
                "device": {"ledger": {"margin_J": -0.5}},
                "world": {"ledger": {"margin_J": 0.25}},
            },
            APART,
        ),
        (
            {"coupling": "zoh", "device": {"ledger": {"margin_J": -0.5}}},
            "NOT PASSIVE: the margin of the device's half fell to -500 mJ",
        ),
        ({"coupling": "tdpa", "theorem": {"margin_J": -0.5}}, "NOT PASSIVE: the margin fell to -500 mJ"),
        ({}, NOTHING),
        (None, NOTHING),
    ],
)
def test_verdict(summary: dict[str, Any] | None, line: str) -> None:
    assert verdict(summary) == line


def printed(summary: dict[str, Any]) -> str:
    out = io.StringIO()
    Console(file=out, width=100).print(summary_text(summary))
    return out.getvalue()


def cells(text: str) -> dict[str, list[str]]:
    """Row label -> its cells; columns are two or more blanks apart."""
    rows = [[cell for cell in line.split("  ") if cell.strip()] for line in text.splitlines()]
    return {row[0].strip(): [cell.strip() for cell in row[1:]] for row in rows if row}


def test_the_summary_as_a_table() -> None:
    text = printed(
        {
            "theorem": {"margin_J": 0.0312, "bound_J": 0.1, "energy_out_J": 0.0688, "margin_end_J": 0.2},
            "device": {
                "ledger": {"margin_J": 0.02, "slack_J": 9e-13, "energy_out_J": 0.03, "margin_end_J": 0.07},
                "reservoir_min_J": 0.0012,
                "deficit_max_J": -0.9e-12,
                "true_slack_J": 0.003,
                "sent_nJ": 1_123_456_789,
                "credited_nJ": 5,
                "quantisation_J": None,
                "servo": {"ticks": 10000, "late_p50_us": 21.3, "late_p99_us": 61.2, "skipped": 0},
            },
            "world": {
                "ledger": {"margin_J": 0.0112, "energy_out_J": 0.04, "slack_J": 0.0},
                "step": {"count": 333, "mean_s": 0.03},
            },
            "energy": {"up": {"sent_nJ": 1_123_456_789, "in_flight_nJ": 789}, "down": {"in_flight_nJ": 0}},
            "links": {"up": {"profile": LINK, "offered": 400, "lost": 9, "delay_p50_ms": 40.2}, "down": None},
            "motion": {"free_rms_m": 0.00123, "peak_force_N": 3.2, "contacts": 3, "contact_rms_m": None},
            "coupling": "pspm",
            "seed": 3,
            "duration_s": 10.0,
        }
    )
    assert text.splitlines()[0] == "PASSIVE: gave out at most 68.8 mJ of the 100 mJ allowed"
    assert text.splitlines()[3] == "coupling pspm, seed 3, duration 10 s"
    rows = cells(text)
    assert rows["energy that came out, most [mJ]"] == ["68.8"]
    assert rows["bound d² [mJ]"] == ["100"]
    assert "margin after 1 s, min [mJ]" not in rows
    assert rows["given out, most [mJ]"] == ["30", "40"]
    assert rows["margin at the end [mJ]"] == ["70", "-"]
    assert rows["reservoir, min [mJ]"] == ["1.2", "-"]
    assert rows["sent [mJ]"] == ["1123", "-"]
    assert rows["credited [mJ]"] == ["5e-06", "-"]
    assert rows["slack, min [mJ]"] == ["0", "0"]
    assert rows["deficit, largest [mJ]"] == ["0", "-"]
    assert rows["true slack, min [mJ]"] == ["3", "-"]
    assert "quantisation [mJ]" not in rows
    assert rows["servo late p99 [µs]"] == ["61.2", "-"]
    assert rows["step mean [ms]"] == ["-", "30"]
    assert rows["energy in flight [mJ]"] == ["0.000789", "0"]
    assert rows["asked"] == [LINK, "-"]
    assert rows["delay p50 [ms]"] == ["40.2", "-"]
    assert rows["lost [%]"] == ["2.25", "-"]
    assert rows["position error, free (rms) [mm]"] == ["1.23"]
    assert "position error, in contact (rms) [mm]" not in rows
    assert rows["force, largest [N]"] == ["3.2"]


@pytest.mark.parametrize("coupling", ["pspm", "zoh", "wave"])
def test_no_rows_of_what_a_coupling_does_not_have(coupling: str) -> None:
    side = {
        "ledger": {"margin_J": -0.02, "energy_out_J": 0.02, "slack_J": None},
        "sent_nJ": 0,
        "credited_nJ": 0,
        "discarded_nJ": 0,
    }
    summary = {"coupling": coupling, "device": {**side, "abandoned_nJ": 0, "incarnations": 1}, "world": side}
    summary["energy"] = {"up": {"sent_nJ": 0, "abandoned_nJ": 0}, "down": None}
    rows = cells(printed(summary))
    shuffled = {f"{name} [mJ]" for name in ("sent", "credited", "discarded", "abandoned", "energy sent")}
    shuffled.add("energy abandoned [mJ]")
    assert shuffled & set(rows) == (shuffled if coupling == "pspm" else set())
    assert ("given out, most [mJ]" in rows) == (coupling != "wave")
    assert rows["pairs"] == ["1", "-"]


def test_a_summary_that_knows_nothing_is_its_verdict_alone() -> None:
    assert printed({"theorem": None, "links": None}).strip() == NOTHING


def test_what_matters_most_in_four_lines() -> None:
    summary: dict[str, Any] = {
        "theorem": {"margin_J": 0.0312, "bound_J": 0.1},
        "motion": {"free_rms_m": 0.00234, "contact_rms_m": 0.0104, "peak_force_N": 3.217, "contacts": 1,
                   "peak_penetration_m": 0.0018},
        "path": {"round_trip_p50_ms": 83.04, "round_trip_p99_ms": 110.2, "up": {"sent": 400, "lost": 9}, "down": None},
    }  # fmt: skip
    assert brief(read(summary)) == [
        "tracking error (rms): 2.34 mm free, 10.4 mm in contact",
        "largest force: 3.217 N, 1 contact, 1.8 mm deep at most",
        "path: round trip 83.04 ms (99 %: 110.2), 2.25 % lost up",
    ]
    summary["motion"] |= {"free_rms_m": None, "contacts": 0}
    assert brief(read(summary))[:2] == ["tracking error (rms): 10.4 mm in contact", "largest force: 3.217 N"]
    names = ("tracking error (rms)", "largest force", "path")
    assert brief(read({})) == [f"{name}: not known" for name in names]
