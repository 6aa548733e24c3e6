"""The report's figure that a browser can zoom: what is drawn is what was recorded, and the page needs nothing else."""

import base64
import hashlib
import json
import re
import shutil
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hapnet
from hapnet.ext.pictures import zoomed
from hapnet.ext.pictures.report import Report, report
from hapnet.simulation.result import Result

pytest.importorskip("plotly", reason="the extra zoom is not installed")
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")


@pytest.fixture(scope="module")
def result() -> Result:
    return hapnet.simulate({"duration_s": 3.0}, seed=3)


@pytest.fixture
def made(result: Result, monkeypatch: pytest.MonkeyPatch) -> Report:
    monkeypatch.setattr("hapnet.ext.pictures.zoomed.can_zoom", lambda: True)
    return report(result)


def test_its_lines_are_the_samples(made: Report, result: Result) -> None:
    drawn = json.loads(made.pictures["run"].zoomed)
    lines: dict[tuple[str, str], Any] = {(one["yaxis"], one.get("name", "")): one for one in drawn["data"]}
    device, world = result.recording.device, result.recording.world
    position, force = lines["y", "device"], lines["y2", "coupling on the device"]
    np.testing.assert_allclose(position["x"], device["time_s"], rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(position["y"], 1e3 * device["position_m"][:, 0], rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(force["y"], device["force_N"][:, 0], rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(lines["y", "proxy"]["y"], 1e3 * world["position_m"][:, 0], rtol=1e-5, atol=1e-9)
    assert lines["y2", "contact on the proxy"]["line"]["shape"] == "hv"  # a step holds its force
    titles = [axis["title"]["text"] for name, axis in drawn["layout"].items() if name.startswith("yaxis")]
    assert titles == ["position [mm]", "force [N]", "reservoir [mJ]", "passivity margin [mJ]"]
    contacts = [one for one in drawn["layout"]["shapes"] if one.get("yref") == "y domain"]
    inside = world["penetration_m"] > 0.0
    assert contacts
    assert min(one["x0"] for one in contacts) == pytest.approx(world["time_s"][inside][0])


def test_the_page_runs_these_scripts_and_no_others(made: Report) -> None:
    """Each is known by its digest; nothing is loaded; and the verdict is said once."""
    page = made.page
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    assert [script == zoomed.library() for script in scripts] == [True, False]
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)
    asked = re.search(r"script-src ([^;]*)", unescape(policy[1]))
    digests = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    assert asked[1].split() == [f"'sha256-{one}'" for one in digests]
    assert "<noscript><div" in page
    assert page.replace("Passive:", "passive:").count("PASSIVE: gave out at most") == 1
    assert "True" not in re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)


def test_without_the_extra_there_is_a_picture_and_no_script(result: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hapnet.ext.pictures.zoomed.can_zoom", lambda: False)
    made = report(result)
    assert "<script" not in made.page
    assert made.page.count("<img") == len(made.pictures)
    assert made.page.replace("Passive:", "passive:").count("PASSIVE: gave out at most") == 1


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium here (Debian: apt install chromium)")
def test_a_drag_zooms_all_panels_to_the_same_seconds(made: Report, tmp_path: Path) -> None:
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright drives the browser")
    (tmp_path / "page.html").write_text(made.page, "utf-8")
    said: list[str] = []
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1100, "height": 1400})
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto((tmp_path / "page.html").as_uri())
        page.wait_for_selector(".zoom .nsewdrag")
        panel = page.locator(".zoom .nsewdrag").first.bounding_box()
        first, last = page.evaluate("document.querySelector('.zoom').layout.xaxis.range")
        y = panel["y"] + 0.3 * panel["height"]
        page.mouse.move(panel["x"] + 0.25 * panel["width"], y)
        page.mouse.down()
        page.mouse.move(panel["x"] + 0.5 * panel["width"], y + 0.5 * panel["height"], steps=5)
        page.mouse.up()
        page.wait_for_function(f"document.querySelector('.zoom').layout.xaxis.range[0] > {first}")
        ranges = page.evaluate("['xaxis', 'xaxis4'].map(name => document.querySelector('.zoom').layout[name].range)")
        shared = page.locator(".modebar-btn[data-title^='Share']").count()
        browser.close()
    assert ranges[0] == ranges[1]
    assert ranges[0] == pytest.approx([first + share * (last - first) for share in (0.25, 0.5)], abs=0.03)
    assert shared == 0
    assert not said
