"""A result as one HTML file, opened in headless Chromium without a server."""

from __future__ import annotations

import re

import numpy as np
import pytest
from PIL import Image
from render_results import write_results
from tipfem.render.viewer.share import share

from tipfem.app.commands import main

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


# An outline of twenty points from wall to wall rises and gains a point; a drop goes down, another comes; a box turns.
MOTION = """() => {
    const loop = (at, held) => ({ points: Float64Array.from(at.flat()), fixed: Uint8Array.from(at, held) });
    const along = (count, place) => Array.from({ length: count }, (_, k) => place(k));
    const pool = (count, level) => loop([[1, 0], ...along(count, (k) => [1 - k / (count - 1), level]), [0, 0]],
        (_, k) => k < 2 || k > count - 1);
    const on = (x, y, radius, angle) => [x + radius * Math.cos(angle), y + radius * Math.sin(angle)];
    const ring = (x, y, radius, angle, held) => loop(along(4, (k) => on(x, y, radius, angle + 1.5708 * k)), () => held);
    const drop = (x, y) => ring(x, y, 0.02, 0, false), box = (x, angle) => ring(x, 0.3, 0.1, angle, true);
    const walls = [loop([[0, 0], [1, 0], [1, 1], [0, 1]], () => true)];
    const one = [[pool(20, 0.20), drop(0.3, 0.8)], [box(0.4, 0)], walls];
    const two = [[pool(21, 0.24), drop(0.3, 0.76), drop(0.9, 0.5)], [box(0.5, 1)], walls];
    const seen = (share) => between(one, two, share, false, 1.4), all = [0.25, 0.75].map(seen);
    const highest = ({ points }) => Math.max(...points.filter((_, k) => k % 2));
    const boxes = all.map((state) => state[1][0].points);
    return {
        ends: [seen(0) === one, seen(1) === two],
        counts: all.map(([fluid]) => fluid.length),
        levels: all.map(([fluid]) => highest(fluid[0])),
        drops: all.map(([fluid]) => highest(fluid[1])),
        turns: boxes.map((p) => Math.atan2(p[1] - 0.3, p[0] - (p[0] + p[4]) / 2)),
        sizes: boxes.map((p) => Math.hypot(p[4] - p[0], p[5] - p[1])),
    };
}"""
PACE = """() => {
    const motion = new Motion(), state = [[], []], times = [];
    for (let n = 0, now = 0; now < 2000; now += 10) {
        if (now >= 100 * n + (n % 3) * 20) motion.take(state, 0.01 * n++, true, now); // ten a second, not quite even
        motion.at(now, true, 1);
        if (now > 800) times.push(motion.time - 0.0001 * now);
    }
    const moved = times.map((time, k) => time - times[k - 1] + 0.001).slice(1);
    const jumped = (motion.take(state, 5, true, 2000), motion.time);
    const still = (motion.take(state, 5.01, false, 2010), motion.time);
    return [Math.min(...moved), Math.max(...moved), Math.min(...times), Math.max(...times), jumped, still];
}"""


def test_pictures_between_states_move_evenly(browser, file):
    """Outlines by points that belong together, bodies by their pose; what has come appears half-way."""
    page = browser.new_page()
    page.goto(file.as_uri())
    page.wait_for_selector("html[data-ready]")
    seen = page.evaluate(MOTION)
    assert seen["ends"] == [True, True]
    assert seen["counts"] == [2, 3]
    assert seen["levels"] == pytest.approx([0.21, 0.23])
    assert seen["drops"] == pytest.approx([0.81, 0.79])
    assert seen["turns"] == pytest.approx([0.25, 0.75], abs=1e-3)
    assert seen["sizes"] == pytest.approx([0.2, 0.2], abs=1e-3)
    slowest, fastest, latest, earliest, jumped, still = page.evaluate(PACE)
    assert 0.0004 < slowest < 0.001 < fastest < 0.0016  # [s] in 10 ms, in which it is a millisecond at an even pace
    assert -0.025 < latest < earliest < 0  # never ahead of what is known, and not three states behind
    assert [jumped, still] == [5, 5.01]
    page.close()
