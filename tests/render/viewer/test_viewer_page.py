"""The page itself, in headless Chromium: what a user does with pointer and keys, and what is then seen."""

from __future__ import annotations

import io
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from render_results import SIDE, write_results
from shown_page import PATIENCE, ShownPage
from tipfem.demos.benchmarks import viewing
from view_client import TIMES

# Keeps what the button that plays is called, which may be for shorter than a test looks; a status that says the same
# again is no change.
WATCH = """() => {
    const play = document.querySelector('[data-do="play"]'), name = () => play.getAttribute("aria-label");
    window.seen = [name()];
    new MutationObserver(() => name() !== window.seen.at(-1) && window.seen.push(name())).observe(play, {
        attributeFilter: ["aria-label"],
    });
}"""
RUN = """
import sys, tipfem as tp
tp.init(threads=1)
water = tp.Fluid("water", density=998.2, viscosity=1e-3)
tank = tp.tank(size=(1.0, 0.5), spacing=0.1).fill(water)
case = tp.Case(tank, fluids=[water], gravity=(0, -9.81))
print("begun", flush=True)
tp.Simulation(case, sys.argv[1], time_step=0.01).run(until=1e6, progress=False)
"""
WATER, AIR = np.array([0x00, 0x72, 0xB2]), np.array([0xE8, 0xF3, 0xFA])


@pytest.fixture
def shown(browser, server):
    """The page at its first time, with nothing chosen."""
    opened = ShownPage(browser, server.address, (SIDE, SIDE))
    opened.wait(opened.button("play").is_enabled, "the page before to be gone, and this one to steer")
    opened.key("0", "Home")
    opened.part("field").select_option("")
    opened.read("legend", "water", "air")
    opened.at(1)
    opened.wait(lambda: opened.command == f"tipfem render {server.out}", "nothing chosen")
    yield opened
    opened.close()


def test_the_page_shows_the_results_and_loads_nothing_from_elsewhere(shown, server):
    assert shown.text("title") == "Sloshing"
    assert shown.text("legend").split() == ["water", "air", "smoothed", "outlines"]
    assert shown.text("clock").split() == ["t", "=", "0.000", "s", f"1/{len(TIMES)}"]
    shown.sees(0.4, 0.1, WATER)
    shown.sees(0.1, 0.45, AIR)
    assert all(url.startswith(f"http://127.0.0.1:{server.port}/") for url in shown.asked)
    assert len(shown.asked) >= 6


def test_time_goes_on_by_keys_the_slider_and_playing(shown):
    shown.key("ArrowRight", "ArrowRight")
    shown.at(3)
    shown.key("End")
    shown.at(12)
    slider = shown.part("scrub").bounding_box()
    shown.page.mouse.click(slider["x"] + slider["width"] / 2, slider["y"] + slider["height"] / 2)
    shown.wait(lambda: re.search(r"\b[67]/12", shown.text("clock")), "the time in the middle")
    shown.part("speed").select_option("2")
    shown.page.evaluate(WATCH)
    shown.page.click('[data-do="play"]')
    shown.at(12)
    shown.wait(lambda: shown.page.evaluate("seen") == ["Play", "Pause", "Play"], "playing and its end")
    # The wave has moved on by a tenth of its length or so at each time: water and air have changed places.
    shown.sees(0.17, 0.24, WATER)
    shown.key("Home")
    shown.sees(0.43, 0.24, AIR)


def test_wheel_drag_and_keys_move_the_window(shown):
    def window():
        found = re.search(r"--window (.*)", shown.command)
        return [float(word) for word in found[1].split()[:4]] if found else None

    assert window() is None
    box = shown.canvas.bounding_box()
    px, py = shown.place(0.4, 0.1)
    shown.page.mouse.move(box["x"] + px, box["y"] + py)
    shown.page.mouse.wheel(0, -400)
    shown.wait(window, "the zoom")
    x0, _, x1, _ = window()
    before = (box["width"] - 82) / (box["height"] - 54) * SIDE * 1.07  # the width that was shown [m]
    assert x1 - x0 == pytest.approx(before * np.exp(-400 * 0.0016), rel=0.01)
    # What was under the pointer still is.
    share = (px - 66) / (box["width"] - 82)
    assert x0 + share * (x1 - x0) == pytest.approx(0.4, abs=2e-3)
    shown.page.mouse.down()
    shown.page.mouse.move(box["x"] + px - 50, box["y"] + py, steps=4)
    shown.page.mouse.up()
    moved = pytest.approx(x0 + 50 / (box["width"] - 82) * (x1 - x0), abs=2e-4)
    shown.wait(lambda: window()[0] == moved, "the pan")
    assert shown.part("history").is_hidden()  # a drag is no click
    shown.key("+", "d")
    shown.wait(lambda: window()[2] - window()[0] < 0.8 * (x1 - x0), "the zoom by a key")
    shown.key("0")
    shown.wait(lambda: window() is None, "all of it")


@pytest.mark.slow
def test_fluids_are_drawn_by_each_page_from_outlines(browser, server, shown):
    """Zoom and theme need no frame from the viewer; a second page has its own view; a field comes as cells."""
    other = ShownPage(browser, server.address, (SIDE, SIDE))
    other.read("state", "watching")
    frames, whole = (shown.frame, other.frame), shown.colour(0.1, 0.3)
    assert shown.page.evaluate("document.querySelector('.pane canvas[role]').width") > 500
    other.page.mouse.move(*other.point(0.4, 0.05))
    other.page.mouse.wheel(0, -900)
    other.page.wait_for_timeout(300)
    assert (abs(other.colour(0.1, 0.3) - other.shaded(WATER, 0.15)) < 8).all()  # what was above the surface
    assert (shown.colour(0.1, 0.3) == whole).all()
    shown.key("h")
    shown.sees(-0.014, -0.014, np.array([0x15, 0x1A, 0x21]))
    shown.key("h")
    shown.page.wait_for_timeout(300)
    assert (shown.frame, other.frame) == frames
    shown.key("o")
    shown.wait(lambda: "--outlines mesh" in shown.command, "the edges of the mesh")
    shown.key("o")
    shown.wait(lambda: "--outlines" not in shown.command, "smooth outlines")
    smooth = shown.page.locator('[data-layer="smooth"]')
    assert smooth.is_checked()
    shown.key("f")
    shown.read("legend", "pressure")
    shown.wait(lambda: min(shown.frame, other.frame) > max(frames), "the cells")
    shown.wait(lambda: not (smooth.is_checked() or smooth.is_enabled()), "no smooth outlines over a field")
    other.close()


def test_the_address_keeps_the_time_the_field_and_the_window(browser, server, shown):
    """A page that is opened at the address shows the same, once it steers."""
    shown.key("f", "+", "ArrowRight", "ArrowRight")
    shown.at(3)
    shown.wait(lambda: "window" in shown.page.url and "field=pressure" in shown.page.url, "the address")
    address, command = shown.page.url, shown.command
    assert "&t=0.2&" in address
    shown.key("0", "f", "Home")
    shown.at(1)
    shown.page.goto("about:blank")
    shown.page.goto(address)
    shown.wait(shown.button("play").is_enabled, "the page to steer")
    shown.at(3)
    same = command[: command.index("--window")]
    shown.wait(lambda: shown.command.startswith(f"{same}--window"), "the same field and a window")
    numbers = [[float(word) for word in text.split()[-4:]] for text in (shown.command, command)]
    assert numbers[0] == pytest.approx(numbers[1], rel=1e-3)
    shown.key("0")
    shown.part("field").select_option("")


def test_a_click_keeps_a_point_and_shows_its_history(shown):
    px, py = shown.place(0.2, 0.1)
    shown.canvas.click(position={"x": px, "y": py})
    shown.wait(lambda: "velocity x" in shown.text("values") and "water" in shown.text("values"), "the values")
    rows = dict(line.split("\t")[:2] for line in shown.text("values").splitlines())
    # The velocity is (y, -x); the pointer is on whole pixels.
    assert float(rows["velocity x [m/s]"]) == pytest.approx(0.1, abs=2e-3)
    assert float(rows["velocity y [m/s]"].replace("−", "-")) == pytest.approx(-0.2, abs=2e-3)
    shown.wait(lambda: "t = 0 s: water" in shown.part("said").text_content(), "the values to be read out")
    assert shown.part("history").is_visible()
    shown.part("history-field").select_option("velocity_x")
    plot = shown.part("plot")

    def blue():
        image = np.asarray(Image.open(io.BytesIO(plot.screenshot())).convert("RGB")).astype(int)
        return np.flatnonzero(image[..., 2] - image[..., 0] > 100) // image.shape[1]

    shown.wait(lambda: len(blue()) > 100, "the curve")
    assert np.ptp(blue()) <= 3  # level: this value stays
    plot.click(position={"x": 200, "y": 60})
    shown.wait(lambda: "1/12" not in shown.text("clock").split(), "the time that was clicked")
    shown.key("Escape")
    assert shown.part("history").is_hidden()


@pytest.mark.slow
def test_fields_layers_and_colours_are_chosen_by_keys_too(shown):
    shown.key("f", "m", "v")
    shown.wait(lambda: "--field pressure --mesh --arrows" in shown.command, "the choices")
    shown.read("legend", "pressure [Pa]", "interface")
    shown.wait(shown.page.locator('[data-layer="mesh"]').is_checked, "the mesh")
    shown.part("range").select_option("given")
    shown.part("low").fill("0")
    shown.part("high").fill("1000")
    shown.part("high").press("Enter")
    shown.wait(lambda: "--range 0 1000" in shown.command, "the range")
    bar = shown.page.locator(".legend canvas")
    shown.wait(lambda: bar.get_attribute("aria-label") == "Colours from 0 to 1000", "the colours")
    shown.canvas.focus()
    shown.key("m", "v")
    shown.wait(lambda: "--mesh" not in shown.command and "--arrows" not in shown.command, "no layers")
    shown.key("?")
    keys = shown.text("keys")
    assert all(word in keys for word in ("play, pause", "zoom in", "keep the point", "take a picture"))
    shown.key("Escape")
    shown.wait(lambda: not shown.part("keys").is_visible(), "the keys to close")


@pytest.mark.slow
def test_colours_keep_their_range_from_the_first_picture_on(shown):
    """Over all times and some seconds, as the legend tells it."""
    shown.part("field").select_option("speed")
    bar = shown.page.locator(".legend canvas")
    bar.wait_for()
    seen = set()
    for k in range(2, 12):
        seen.add((bar.get_attribute("aria-label"), shown.text("legend")))
        shown.key("ArrowRight")
        shown.at(k)
        shown.page.wait_for_timeout(300)
    assert len(seen) == 1
    assert re.fullmatch(r"Colours from 0 to \d\S*", seen.pop()[0])


@pytest.mark.slow
def test_pictures_and_movies_are_downloaded(shown):
    with shown.page.expect_download() as picture:
        shown.key("g")
    assert picture.value.suggested_filename == "wave_0.0000s.png"
    assert Image.open(picture.value.path()).size == (1280, 720)
    with shown.page.expect_download() as page:
        shown.key("G")
    assert page.value.suggested_filename == "wave.html"
    assert '"times":[0.0,0.1,' in Path(page.value.path()).read_text()
    shown.key("r")
    shown.wait(lambda: shown.page.get_attribute('[data-do="record"]', "aria-pressed") == "true", "the recording")
    shown.key("ArrowRight")
    shown.at(2)
    with shown.page.expect_download() as movie:
        shown.page.click('[data-do="record"]')
    assert movie.value.suggested_filename == "wave.mp4"
    assert movie.value.path().read_bytes()[4:8] == b"ftyp"


@pytest.mark.slow
@pytest.mark.parametrize(("width", "scheme"), [(800, "dark"), (1600, "light")])
def test_everything_has_its_place_at_any_width(browser, server, width, scheme):
    shown = ShownPage(browser, server.address, (SIDE, SIDE), width, 900, scheme)
    shown.wait(shown.button("play").is_enabled, "the page to steer")
    dark = scheme == "dark"
    assert shown.page.get_attribute(".tipfem-viewer", "data-theme") == scheme
    boxes = [shown.page.locator(part).bounding_box() for part in (".show", ".transport", "aside")]
    for box in boxes:
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= width
    assert boxes[0]["width"] > (0.9 if width == 800 else 0.7) * width
    assert boxes[1]["y"] + boxes[1]["height"] <= 900
    shown.wait(lambda: (shown.colour(-0.014, -0.014).mean() < 60) == dark, "the background")
    # Every control has a name that can be read out.
    names = shown.page.evaluate(
        """() => [...document.querySelectorAll("button, input, select, textarea, canvas[tabindex]")].map(
            (e) => e.getAttribute("aria-label") || (e.labels && e.labels[0] ? e.labels[0].innerText : e.innerText)
        )"""
    )
    assert len(names) > 25
    assert all(name and name.strip() for name in names)
    shown.close()


@pytest.mark.slow
def test_a_page_whose_token_is_wrong_says_so(browser, server):
    page = browser.new_page()
    page.goto(server.address.split("#")[0] + "#wrong")
    page.wait_for_selector('[data-name="note"]:has-text("token")')
    page.close()


@pytest.mark.slow
def test_keys_hold_after_a_control_was_used_by_the_pointer(shown):
    """A drop-down, the slider, a checkbox and the button that records give the keys back; by Tab they keep them."""
    # The list that a press opens is the system's, not the page's: it would take the keys until it is closed.
    shown.part("field").dispatch_event("pointerdown")
    shown.part("field").focus()
    shown.part("field").select_option("pressure")
    shown.read("legend", "pressure")
    shown.key("ArrowRight")
    shown.at(2)
    assert shown.part("field").input_value() == "pressure"
    slider = shown.part("scrub").bounding_box()
    shown.page.mouse.click(slider["x"] + slider["width"] / 2, slider["y"] + slider["height"] / 2)
    shown.wait(lambda: re.search(r"\b[67]/12", shown.text("clock")), "the time in the middle")
    shown.key("m")
    mesh = shown.page.locator('[data-layer="mesh"]')
    shown.wait(mesh.is_checked, "the mesh by its key")
    mesh.click()
    shown.wait(lambda: not mesh.is_checked(), "the mesh by its box")
    shown.key("Home", "Space")
    shown.at(12)
    assert not mesh.is_checked()
    shown.button("record").click()
    shown.wait(lambda: shown.button("record").get_attribute("aria-pressed") == "true", "the recording")
    shown.key("Home")
    shown.at(1)
    shown.key("Space")
    shown.at(12)
    assert shown.button("record").get_attribute("aria-pressed") == "true"
    with shown.page.expect_download():
        shown.button("record").click()
    shown.part("field").focus()
    shown.key("Home")  # a key of the drop-down that has the focus without the pointer
    shown.wait(lambda: shown.part("field").input_value() == "", "the first field")


@pytest.mark.slow
def test_a_silent_connection_is_told(browser, server):
    """A connection that carries nothing is told, and the note goes when it carries again."""
    context = browser.new_context()
    page = context.new_page()
    held = []
    stalled = [False]

    def pass_on(socket):
        other = socket.connect_to_server()
        other.on_message(lambda message: held.append(message) if stalled[0] else socket.send(message))

    page.route_web_socket(lambda url: "socket" in url, pass_on)
    page.goto(server.address)
    page.wait_for_selector('.tipfem-viewer:not([data-frame="0"])')
    note = page.locator('[data-name="note"]')
    assert not note.is_visible()
    stalled[0] = True
    note.filter(has_text="has not answered").wait_for(timeout=60_000)
    stalled[0] = False
    note.wait_for(state="hidden", timeout=60_000)
    context.close()


@pytest.mark.slow
def test_the_benchmark_of_viewing_measures_what_is_painted(browser, server, monkeypatch):
    monkeypatch.setattr(viewing, "SETTLES", 50)
    monkeypatch.setattr(viewing, "OPENED", 1)
    page, frames, first = viewing.opened(browser, server.address)
    zoom, drag, time, states, pictures, size = map(float, viewing.measure(page, frames, 1))
    page.close()
    assert 0 < first < 1000 * PATIENCE
    assert all(0 <= passed < 3000 for passed in (zoom, drag, time))
    assert states > 1
    assert pictures > 1
    assert 0 < size < 5


@pytest.mark.slow
def test_two_results_are_compared_in_the_browser_that_is_opened_without_the_token_in_its_arguments(
    browser, server, tmp_path
):
    """The browser is given a file that leads to the page; there all times of both results are reached."""
    short, told, command = write_results(tmp_path / "short", TIMES[:3]), tmp_path / "told", tmp_path / "browser"
    command.write_text(f'#!/bin/sh\necho "$@" > {told}.part; mv {told}.part {told}\n')
    command.chmod(0o700)
    surroundings = {name: value for name, value in os.environ.items() if name != "SSH_CONNECTION"}
    surroundings |= {"BROWSER": f"{command} %s", "DISPLAY": ":99"}
    words = [sys.executable, "-m", "tipfem", "view", str(short), str(server.out), "--port", "0"]
    viewer = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=surroundings)
    token = viewer.stdout.readline().partition("#")[2].strip()
    viewer.stdout.readline()
    while not told.exists():
        assert viewer.poll() is None
    given = told.read_text().strip()
    assert token not in given
    assert given.startswith("file://")
    shown = ShownPage(browser, given, (SIDE, SIDE))
    assert shown.page.url.startswith("http://127.0.0.1:")
    panes = shown.page.locator(".pane canvas[role]")
    assert panes.count() == 2
    shown.wait(shown.part("scrub").is_enabled, "the page to steer")
    shown.canvas = panes.first
    labels = [panes.nth(k) for k in range(2)]
    shown.key("End")
    shown.at(len(TIMES))
    shown.wait(lambda: "t = 1.1 s" in labels[1].get_attribute("aria-label"), "the last time of the longer one")
    assert "t = 0.2 s" in labels[0].get_attribute("aria-label")
    pictures = [label.screenshot() for label in labels]
    shown.key("+")
    shown.wait(lambda: all(one.screenshot() != old for one, old in zip(labels, pictures, strict=True)), "both zoomed")
    shown.close()
    viewer.send_signal(signal.SIGINT)
    assert viewer.wait(PATIENCE) == 0


@pytest.mark.slow
def test_a_viewer_attaches_to_a_run_that_goes_on_and_its_page_stops_it(browser, tmp_path):
    out = tmp_path / "run"
    run = subprocess.Popen([sys.executable, "-c", RUN, str(out)], stdout=subprocess.PIPE, text=True)
    assert run.stdout.readline() == "begun\n"
    while not list(out.glob("*")) or "Open" not in (line := attached(out)):
        assert run.poll() is None
    shown = ShownPage(browser, line.split()[-1], (1.0, 0.5))
    shown.read("state", "running")
    before = shown.frame
    shown.wait(lambda: shown.frame > before + 5, "the run to go on")
    shown.button("stop").click()
    shown.read("note", "The run has ended")
    shown.close()
    assert run.wait(PATIENCE) == 0
    assert json.loads((out / "summary.json").read_text())["status"] == "stopped by a command"


def attached(out):
    """The first line of a viewer of a run."""
    words = [sys.executable, "-m", "tipfem", "view", str(out), "--no-browser", "--port", "0"]
    return subprocess.Popen(words, stdout=subprocess.PIPE, text=True).stdout.readline()
