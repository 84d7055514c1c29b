"""A result as one HTML file, opened in headless Chromium without a server."""

from __future__ import annotations

import re

import numpy as np
import pytest
from PIL import Image
from render_results import write_results

from tipfem.app.commands import main
from tipfem.results.viewer.share import share

TIMES = (0.0, 0.1, 0.2, 0.3)
WATER = np.array([0x00, 0x72, 0xB2])


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """The file, of four times, with a probe."""
    out = write_results(tmp_path_factory.mktemp("share") / "run", times=TIMES)
    (out / "probes").mkdir()
    rows = "".join(f"{time},{1000 * time}\n" for time in np.linspace(0, 0.3, 50))
    (out / "probes" / "wall.csv").write_text("time [s],pressure [Pa]\n" + rows)
    return share(out, field="speed", times=[0.2])


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_opens_plays_and_zooms_without_anything_from_elsewhere(browser, file, scheme, tmp_path):
    """Times by keys, the bar and playing; zoom, theme and smoothing; a plot; no request and no complaint."""
    context = browser.new_context(viewport={"width": 1000, "height": 620}, color_scheme=scheme)
    page = context.new_page()
    complaints, asked = [], []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(file.as_uri())
    page.wait_for_selector("html[data-ready]")
    clock = page.locator("#clock")

    def picture(name):
        path = tmp_path / f"{name}.png"
        page.locator("#stage").screenshot(path=path)
        return np.asarray(Image.open(path).convert("RGB")).astype(int)

    first = picture("first")
    water = (abs(first - WATER) < 10).all(axis=2).mean()
    assert water > 0.1
    assert (first[2, 2] > 200).all() == (scheme == "light")
    page.keyboard.press("ArrowRight")
    assert clock.inner_text() == "t = 0.100 s"
    page.keyboard.press("End")
    assert clock.inner_text() == "t = 0.300 s"
    bar = page.locator("#time").bounding_box()
    page.mouse.click(bar["x"] + 2, bar["y"] + bar["height"] / 2)
    assert clock.inner_text() == "t = 0.000 s"
    page.keyboard.press("Space")
    page.locator("#clock", has_text="t = 0.300 s").wait_for()
    page.locator("#play", has_text="Play").wait_for()
    before = picture("before")
    box = page.locator("#stage").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] * 0.7)
    page.mouse.wheel(0, -600)
    assert (abs(picture("zoomed") - before) > 20).any(axis=2).mean() > 0.05
    page.keyboard.press("0")
    assert (picture("all") == before).all()
    page.keyboard.press("o")
    assert not page.locator("#smooth").is_checked()
    page.keyboard.press("h")
    assert (picture("other")[2, 2] > 200).all() == (scheme == "dark")
    assert not page.locator("#bar").is_visible()
    page.locator("#at button", has_text="speed at 0.2 s").click()
    assert clock.inner_text() == "t = 0.200 s"
    assert page.locator("#bar").inner_text().startswith("speed [m/s]: 0")
    coloured = picture("speed")
    page.keyboard.press("f")
    assert (abs(picture("fluids") - coloured) > 20).any(axis=2).mean() > 0.2
    assert page.locator("#legend li").all_inner_texts() == ["water", "air"]
    assert page.locator("#lapse").inner_text() == "played 2.5 times faster"
    assert page.locator("figcaption").all_inner_texts() == ["wall: pressure [Pa]"]
    assert complaints == []
    assert asked == [file.as_uri()]
    context.close()


def test_it_is_small_and_its_policy_allows_its_own_script_alone(file):
    """Nothing is loaded, whatever the title says."""
    text = share(file.parent, file.parent / "small.html").read_text(encoding="utf-8")
    assert len(text) < 45_000
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1]
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe-inline" not in policy.split(";")[1]
    assert "http://" not in text
    assert "https://" not in text


def test_what_cannot_be_shared_is_said_before_it_is_drawn(file, capsys):
    """A folder that is not there, a field without times, a field that the results do not have."""
    out = str(file.parent)
    for words, message in (
        (["--to", "/nodir/x.html"], "there is no folder '/nodir'"),
        (["--field", "speed"], "name both the field and the times"),
        (["--field", "heat", "--at", "0.1"], "heat"),
    ):
        assert main(["share", out, *words]) == 2
        assert message in capsys.readouterr().err


@pytest.mark.parametrize(("width", "height", "plots"), [(688, 430, False), (640, 900, True), (1000, 620, True)])
def test_the_picture_has_most_of_the_page_and_plots_are_whole_or_left_out(browser, file, width, height, plots):
    """As in a column of the documentation, on a tablet, and on a screen."""
    page = browser.new_context(viewport={"width": width, "height": height}).new_page()
    page.goto(file.as_uri())
    page.wait_for_selector("html[data-ready]")
    assert page.locator("#stage").bounding_box()["height"] > 0.55 * height
    assert page.locator("#plots").is_visible() == plots
    if plots:
        whole, first = page.locator("#plots").bounding_box(), page.locator("#plots figure").first.bounding_box()
        assert first["y"] + first["height"] <= whole["y"] + whole["height"]
    assert not page.locator("#all").is_visible()
    page.locator("#stage").focus()
    page.keyboard.press("+")
    page.locator("#all").click()
    assert not page.locator("#all").is_visible()
    page.context.close()
