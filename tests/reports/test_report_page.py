"""The report as a page: what it says, that nothing in a recording can break out of it, and that it stands alone."""

import math
import re
import shlex
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from hapnet import cli
from hapnet.couplings.registry import COUPLINGS, coupling
from hapnet.ext.page.commands.play import led
from hapnet.ext.pictures.html import element, join
from hapnet.ext.pictures.page import FOLDED, MOST_EVENTS, ReportSource, page
from hapnet.ext.pictures.pictures import pictures
from hapnet.ext.pictures.settings import commands, settings
from hapnet.laws import BILATERAL_NAMES
from hapnet.params import Params
from hapnet.recording.samples import Event, Recording
from hapnet.simulation.simulation import simulate
from hapnet.summary.servos import milli_up
from hapnet.summary.structure import known, read
from hapnet.summary.tables import links, motion, sides
from hapnet.summary.words import legible
from tests.conftest import mostly_slow
from tests.plots.test_run import run

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
VOID = {"meta", "img"}


class Page(HTMLParser):
    """What a browser would make of it: elements, their attributes, and the text of each section."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.sections: dict[str, str] = {"": ""}
        self._open: list[str] = []
        self._section = ""
        self.feed(text)
        self.close()
        assert not self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attrs}))
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self._open[-1:] == ["h2"]:
            self._section = data
            self.sections[data] = ""
        elif "style" not in self._open:
            self.sections[self._section] += data + "\n"

    def attributes(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.elements if name == tag]


def stands_alone(text: str) -> Page:
    """It needs no script, no network and no other file, and says what is there to people who cannot see it."""
    parsed = Page(text)
    assert text.startswith("<!doctype html>")
    assert {tag for tag, _ in parsed.elements} <= {
        "html", "head", "meta", "title", "style", "body", "main", "header", "section", "h1", "h2", "p", "div", "dl",
        "dt", "dd", "figure", "figcaption", "img", "table", "caption", "thead", "tbody", "tr", "th", "td", "details",
        "summary", "pre", "code", "mark",
    }  # fmt: skip
    for _, attributes in parsed.elements:
        assert not [name for name in attributes if name.startswith("on") or name in ("href", "style", "srcset")]
        assert attributes.get("src", "data:image/png;base64,").startswith("data:image/png;base64,")
    assert "url(" not in text
    assert "@import" not in text
    assert parsed.attributes("html") == [{"lang": "en"}]
    assert len(parsed.attributes("h1")) == 1
    assert all(len(image["alt"]) > 20 for image in parsed.attributes("img"))
    assert all(header.get("scope") in ("row", "col") for header in parsed.attributes("th"))
    return parsed


def page_of(recording: Recording, *sources: ReportSource) -> Page:
    """Without its pictures, which take the time."""
    return stands_alone(page(recording, {}, sources))


@pytest.fixture(scope="module")
def simulated() -> Recording:
    params = Params().set({"duration_s": 1.0, "device.stiffness": 80.0, "link.up": "delay 5ms 2ms"})
    result = simulate(params, seed=7)
    return replace(result.recording, summary=result.summary)


def test_what_a_reader_wants_to_know_comes_in_that_order(simulated: Recording) -> None:
    source = ReportSource(Path("a b/run.mcap"), "both", written="2026-11-21 12:00:00 UTC")
    found = stands_alone(page(simulated, pictures(simulated), [source]))
    assert list(found.sections) == [
        "", "The run", "Summary", "Path", "Links", "Energy account", "Silences and events",
        "Commands that repeat the run", "Settings", "Versions", "Files",
    ]  # fmt: skip
    theorem = simulated.summary["theorem"]
    out = f"gave out at most {milli_up(theorem['energy_out_J'], 0.15)} mJ of the 150 mJ allowed"
    assert f"PASSIVE: {out}" in found.sections[""]
    run_of = found.sections["The run"].split("\n")
    facts = dict(zip(run_of[::2], run_of[1::2], strict=False))
    assert facts["uplink"] == "delay 5ms 2ms"
    assert facts["downlink"] == "delay 40ms 10ms loss 2%"
    assert (facts["scene"], facts["hand"], facts["seed"], facts["duration"]) == ("wall", "press", "7", "1 s")
    assert (facts["clock"], facts["file written"]) == ("virtual time", "2026-11-21 12:00:00 UTC")
    assert "a b/run.mcap" in found.sections["Files"]
    assert simulated.meta["versions"]["numpy"] in found.sections["Versions"]
    assert len(found.attributes("img")) == 2


@pytest.mark.parametrize("zooms", mostly_slow([False, True], 0))
def test_the_first_screen_has_verdict_picture_and_five_values(
    zooms: bool, simulated: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a window of 1280 by 800 pixels, with and without plotly.js."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright drives the browser")
    if CHROMIUM is None:
        pytest.skip("there is no chromium here (Debian: apt install chromium)")
    if zooms:
        pytest.importorskip("plotly")
    monkeypatch.setattr("hapnet.ext.pictures.zoomed.can_zoom", lambda: zooms)
    (tmp_path / "page.html").write_text(page(simulated, pictures(simulated), []), "utf-8")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        shown = browser.new_page(viewport={"width": 1280, "height": 800})
        shown.goto((tmp_path / "page.html").as_uri())
        picture = shown.locator(".first .zoom .main-svg" if zooms else ".first img").first
        picture.wait_for()
        boxes = [one.bounding_box() for one in (shown.locator(".verdict"), picture, shown.locator(".first dl"))]
        assert shown.locator(".first dd").count() == 5
        browser.close()
    verdict, drawn, values = boxes
    assert all(box["y"] + box["height"] <= 800 for box in boxes)
    assert verdict["y"] < drawn["y"]
    assert drawn["x"] + drawn["width"] <= values["x"]  # side by side
    assert drawn["height"] > 400


def test_of_another_coupling_its_own_claim_is_told_and_nothing_of_reservoirs() -> None:
    result = simulate(Params().set({"duration_s": 1.0, "coupling": "wave"}), seed=7)
    recording = replace(result.recording, summary=result.summary)
    found = stands_alone(page(recording, pictures(recording), []))
    assert "Energy account" not in found.sections
    assert "passive at both ports for any constant delay" in found.sections[""]
    assert "wave variables; Niemeyer, Slotine 2004" in found.sections[""]
    reported = found.sections[""] + found.sections["Summary"]
    assert "Theorem" not in reported
    assert "eservoir" not in reported + found.attributes("img")[0]["alt"]
    assert "slack" not in reported
    alone = page_of(replace(recording, world=None, summary={**result.summary, "world": None, "theorem": {}}))
    assert "PASSIVITY NOT KNOWN: this coupling is passive only at both ports together" in alone.sections[""]


def test_the_tables_are_those_of_the_terminal(simulated: Recording) -> None:
    found = page_of(simulated)
    assert simulated.summary is not None
    for section, table in (("Summary", sides), ("Summary", motion), ("Links", links)):
        rows = table(read(simulated.summary)).rows
        assert len(rows) >= 4
        for row in rows:
            assert "\n".join(row) in found.sections[section]


def test_a_verdict_is_told_in_words_and_colour() -> None:
    for margin, kind, words in (
        (-0.01, "bad", "NOT PASSIVE: gave out 110 mJ, more than the 100 mJ allowed"),
        (0.01, "good", "PASSIVE: gave out at most 90 mJ of the 100 mJ allowed"),
    ):
        found = page_of(replace(run(seconds=1), summary={"theorem": {"margin_J": margin, "bound_J": 0.1}}))
        assert words in found.sections[""]
        assert f"verdict {kind}" in [attributes.get("class") for attributes in found.attributes("p")]
    found = page_of(replace(run(seconds=1), summary={}))
    assert "PASSIVITY NOT KNOWN" in found.sections[""]
    assert "verdict unknown" in [attributes.get("class") for attributes in found.attributes("p")]
    half = {"device": {"ledger": {"margin_J": 0.5}}}
    found = page_of(replace(run(sides="device", seconds=1), summary=half))
    assert "PASSIVITY NOT KNOWN: the world's account is missing; the device's half held" in found.sections[""]
    assert "the files of both sides" in found.sections[""]


def test_a_world_does_not_know_whose_hand_it_was() -> None:
    meta = {"origin_ns": 0, "scene": "box", "params": Params().as_dict()}
    world = page_of(replace(run(sides="world", seconds=1), meta=meta, summary={}))
    assert "Scene box" in world.sections[""].splitlines()
    assert "press" not in world.sections["The run"]
    device = page_of(replace(run(sides="device", seconds=1), meta=meta, summary={}))
    assert "Scene box, hand press" in device.sections[""]
    assert "press" in device.sections["The run"]


HOSTILE = (
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "</style><script>alert(2)</script>",
    "'--><svg/onload=x>",
    "[/red][bold",
    "\x1b[2J\x1b[31m",
    "\ud800 \u202e \x00",
    "&lt;b&gt;",
    "%s {0} {x}",
    "$\\frac{$",
    "9" * 10_000,
)


@pytest.mark.parametrize("text", mostly_slow([(one,) for one in [" ".join(HOSTILE), *HOSTILE[-2:]]], 1))
def test_whatever_a_recording_says_is_text(text: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    from hapnet.recording.mcap import RecordingWriter

    anything: Any = {"x": text, text: text}
    link = {"profile": text, "offered": text, "lost": 3, "delay_p50_ms": text, "delay_histogram_ms": [[text, text]]}
    meta = {
        "origin_ns": 0, "seed": text, "scene": text, "coupling": text, "session": text, "links": {"up": text},
        "params": {"operator": text, "scene": text, text: text, "device": {"servo": text}}, "versions": anything,
    }  # fmt: skip
    summary = {
        "theorem": {"margin_J": text}, "device": {"ledger": {"margin_J": text}, "sent_nJ": text}, "world": text,
        "links": {"up": link, "down": text}, "seed": text, "coupling": text, "duration_s": text, "energy": text,
    }  # fmt: skip
    file = tmp_path / "x.mcap"
    writer = RecordingWriter(file, escapable(meta))
    for i, sample in enumerate(run(seconds=1).samples()):
        writer.write(sample)
        if i < 3:
            writer.write(Event(sample.time_ns, escapable(text), escapable(text)))
    writer.close(escapable(summary))
    assert cli.main(["report", str(file)]) == 0
    found = stands_alone((tmp_path / "x.html").read_text("utf-8"))
    for part in HOSTILE if " " in text else [text]:
        shown = legible(escapable(part))[:1500]
        assert shown in found.sections["Silences and events"]
        assert shown[:20] in found.sections["Settings"]
    assert "PASSIVITY NOT KNOWN" in found.sections[""]
    assert "\x1b" not in capsys.readouterr().out


def escapable(value: Any) -> Any:
    """Without what no file can hold: pairs of surrogates that are none."""
    if isinstance(value, str):
        return value.encode("utf-8", "replace").decode("utf-8")
    if isinstance(value, dict):
        return {escapable(key): escapable(item) for key, item in value.items()}
    return [escapable(item) for item in value] if isinstance(value, list) else value


def test_elements_escape_their_texts_and_attributes() -> None:
    made = element("p", "a < b", element("b", "&"), title='"x" <y>', class_="z", http_equiv="q")
    assert made == '<p title="&quot;x&quot; &lt;y&gt;" class="z" http-equiv="q">a &lt; b<b>&amp;</b></p>'
    assert element("p", join("<i>", element("i", "<i>"))) == "<p>&lt;i&gt;<i>&lt;i&gt;</i></p>"


def test_legible_replaces_what_does_not_print_and_shortens() -> None:
    assert legible({"a\x00": ["b\x1b", 3, None, 2.5, {"c": "\u202e"}]}) == {"a�": ["b�", 3, None, 2.5, {"c": "�"}]}
    assert legible("ü μ ≥ 漢") == "ü μ ≥ 漢"
    assert len(legible("x" * 5000)) == 2000


def test_only_finite_numbers_are_known() -> None:
    assert [known(value) for value in (1, 2.5, True, math.nan, math.inf, "3", None)] == [1, 2.5] + [None] * 5


def test_many_events_are_folded_and_far_too_many_counted() -> None:
    recording = run(seconds=1)
    few = [
        Event(-4_000_000, "paired", "paired with the world"),
        Event(1_500_000_000, "heard", "data from the world again"),
    ]
    found = page_of(replace(recording, events=few, summary={}))
    assert "-0.004\npaired\npaired with the world\n1.500\nheard" in found.sections["Silences and events"]
    folded = len(found.attributes("details"))
    many = [Event(i, "overrun", f"number {i}") for i in range(FOLDED)] + few
    found = page_of(replace(recording, events=many, summary={}))
    assert len(found.attributes("details")) == folded + 1
    assert f"{FOLDED + 2} events: {FOLDED} overrun, 1 paired, 1 heard" in found.sections["Silences and events"]
    far = [Event(i, "dropped", "x") for i in range(MOST_EVENTS + 30)]
    found = page_of(replace(recording, events=far, summary={}))
    assert "The other 30 events are only in the recording." in found.sections["Silences and events"]


def test_that_virtual_time_records_no_events_is_told() -> None:
    """They may be counted in the summary beside it: that none were recorded is not that there were none."""
    recording = replace(run(seconds=1), events=[], summary={})
    assert page_of(recording).sections["Silences and events"].strip() == "No events were recorded."
    simulated = replace(recording, meta={**recording.meta, "clock": "virtual"})
    assert "virtual time records no events" in page_of(simulated).sections["Silences and events"]


def test_settings_with_units_and_meaning_and_what_differs_from_the_defaults(simulated: Recording) -> None:
    rows = {row.name: row for row in settings(simulated)}
    others = {coupling(name).section for name in (*COUPLINGS, *BILATERAL_NAMES) if name != "pspm"}
    assert list(rows) == [name for name in Params().flat() if name.partition(".")[0] not in others]
    given, default, meaning, source = rows["device.stiffness"][1:]
    assert (given, default, source) == ("80.0", "0.0", "program")
    assert rows["rendering"].source == "rule"
    assert rows["device.damping"].source == ""
    assert meaning.startswith("K [N/m]: a number, one per axis, or a matrix; 0: by what the device renders")
    assert rows["device.damping"].default == ""
    assert {row.name for row in rows.values() if row.default} == {
        "device.stiffness",
        "duration_s",
        "rendering",
        "link.up",
    }
    found = page_of(simulated)
    assert f"4 of {len(rows)} differ" in found.sections["Settings"]
    assert len(found.attributes("mark")) == 4


def test_settings_of_two_processes_and_of_another_version() -> None:
    def with_params(**params: Any) -> dict[str, Any]:
        return {"params": {"duration_s": 0.0, **params}}

    recording = replace(run(seconds=1), summary={"duration_s": 3.4567})
    recording.meta["sides"] = {
        "device": with_params(link={"up": "delay 1ms", "down": ""}, later=5),
        "world": with_params(link={"up": "", "down": "delay 2ms"}, world={"mass": [[1.0, 0.0], [0.0, 2.0]]}),
    }
    rows = {row.name: row for row in settings(recording)}
    assert rows["link.up"].value == '"delay 1ms" / ""'
    assert rows["later"] == ("later", "5", "", "", "")
    assert rows["world.mass"].value == "[[1.0, 0.0], [0.0, 2.0]]"
    assert not [c for c in commands(recording, []) if "simulate" in c.line]  # a parameter that is not known here
    del recording.meta["sides"]["device"]["params"]["later"]
    line = next(c.line for c in commands(recording, []) if "simulate" in c.line)
    assert shlex.split(line)[2:] == [
        "--set", "rendering=paper", "--set", "duration_s=3.457", "--set", "device.servo=sampled",
        "--set", "operator_model.start_periods=0.0", "--set", "world.mass=[[1.0, 0.0], [0.0, 2.0]]",
        "--set", "link.up=delay 1ms", "--set", "link.down=delay 2ms",
        "--set", "contact_model.remembers=false", "--set", "contact_model.stop_s=0.0",
        "--set", "contact_model.yields_below=0.0",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"scene": "box", "dof": 2, "device.stiffness": (90.0, 110.0), "wire.accept_stale": True},
        {"link.up": "", "link.down_timeline": "at 1s: down; at 2s: up", "operator": 'it\'s $HOME/`x` "y".csv'},
    ],
)
def test_the_commands_shown_bring_the_settings_back(
    changes: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    params = Params().set(changes)
    meta = {"clock": "virtual", "params": params.as_dict()}
    recording = replace(run(seconds=1), meta=meta, summary={"seed": 12})
    virtual, replayed = commands(recording, [Path("a b/device.mcap"), Path("world.mcap")])
    assert shlex.split(replayed.line) == ["hapnet", "replay", "a b/device.mcap", "world.mcap"]
    hapnet, *argv = shlex.split(virtual.line)
    assert (hapnet, argv[:3]) == ("hapnet", ["simulate", "--seed", "12"])
    assert cli.main([*argv, "--show-params"]) == 0
    assert without_sources(capsys.readouterr().out) == without_sources(params.toml())
    meta["clock"] = "boot:1"
    again = next(c.line for c in commands(recording, []) if c.line.startswith("hapnet run"))
    assert cli.main([*shlex.split(again)[1:], "--show-params"]) == 0
    assert without_sources(capsys.readouterr().out) == without_sources(params.toml())


def without_sources(toml: str) -> str:
    """The command sets what a program, or a recording, had set."""
    return re.sub(r"; set by: \w+", "", toml)


def test_what_a_hand_led_live_did_is_made_again_by_another_or_replayed(capsys: pytest.CaptureFixture[str]) -> None:
    """Nobody leads it in `hapnet simulate` or `hapnet run`, which refuse it."""
    params = led(Params().set({"scene": "box", "dof": 2, "link.up": "delay 40ms"}))
    meta = {"clock": "boot:1", "params": params.as_dict()}
    recording = replace(run(seconds=1), meta=meta, summary={"seed": 12, "duration_s": 3.0})
    lines = [shlex.split(command.line) for command in commands(recording, [Path("device.mcap")])]
    assert [line[1] for line in lines] == ["play", "replay"]
    assert cli.main([*lines[0][1:], "--show-params"]) == 0
    assert without_sources(capsys.readouterr().out) == without_sources(params.toml())


def test_a_torn_file_is_told_of_at_the_top() -> None:
    found = page_of(
        run(seconds=1),
        ReportSource(Path("d/device.mcap"), "device", "device.mcap is incomplete: it ends at 1 s", Path("d/r.mcap")),
    )
    assert (
        "device.mcap is incomplete: it ends at 1 s. The report covers the samples that can be read"
        in found.sections[""]
    )
    assert "d/r.mcap" in found.sections["Files"]
