"""The page of a run that goes on, in headless Chromium: pause, step, tilt, push, drop, stop; and the run repeated.

The run is that of demos/play.py, in a process of its own as a visitor starts it.
"""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from shown_page import PATIENCE, ShownPage
from tipfem.demos import play

import tipfem as tp

DOMAIN = (1.2, 0.9)
WATER, OIL = np.array([0x00, 0x72, 0xB2]), np.array([0xE6, 0x9F, 0x00])
PLAY = Path(__file__).resolve().parents[3] / "demos" / "play.py"


def repeated(out, **what):
    """Take the steps of a run again, with the commands of its file; it ends as in the run's last checkpoint."""
    case = play.case(0.06, **what)
    first = tp.Simulation.resume(out, case=case)
    again = tp.Simulation(case, time_step=0.0125, steering=out / "steering.jsonl")
    while again.step_number < first.step_number:
        again.step()
    for name in ("position", "velocity", "pressure", "fluid"):
        assert getattr(again.particles, name).tobytes() == getattr(first.particles, name).tobytes(), name
    assert [r.command for r in again.steering.applied] == [r.command for r in first.steering.applied]
    return again.step_number


def start(out, *options):
    """Start the demo, and wait for the page's address."""
    words = [
        sys.executable,
        str(PLAY),
        "--spacing",
        "0.06",
        "--time-step",
        "0.0125",
        "--no-browser",
        "--port",
        "0",
        "--out",
        str(out),
    ]
    process = subprocess.Popen([*words, *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    line = process.stdout.readline()
    assert line.startswith("Open http://127.0.0.1:"), line + process.stderr.read()
    return process, line.split()[-1]


@pytest.fixture
def run(tmp_path):
    """The demo, its address and its results folder."""
    process, address = start(tmp_path / "play", "--tilt", "0", "--no-box")
    yield process, address, tmp_path / "play"
    process.kill()
    process.wait()


def step_of(shown):
    """Number of the step that the page tells of."""
    found = re.search(r"step (\d+)", shown.text("progress"))
    return int(found[1]) if found else -1


def fits(page, width):
    """All that a run has is on a page of a width [px]; its note covers nothing of the picture, and takes no click."""
    page.set_viewport_size({"width": width, "height": 700})
    page.evaluate("document.querySelector('[data-name=note]').hidden = false")  # it goes after a while
    page.wait_for_timeout(200)
    box = {name: page.locator(f'[data-name="{name}"]').bounding_box() for name in ("note", "progress", "panes")}
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert all(
        button.bounding_box()["x"] + button.bounding_box()["width"] < width
        for button in page.locator(".transport button:visible").all()
    )
    assert page.locator('[data-name="progress"]').evaluate("(one) => one.scrollWidth <= one.clientWidth")
    assert box["progress"]["width"] > 100
    assert box["note"]["y"] + box["note"]["height"] < box["panes"]["y"] + 8
    middle = [box["note"]["x"] + box["note"]["width"] / 2, box["note"]["y"] + box["note"]["height"] / 2]
    assert page.evaluate("(at) => !document.elementFromPoint(...at).closest('.note')", middle)


def commands(out):
    """What the run has been told so far."""
    path = out / "steering.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


@pytest.mark.slow
def test_a_run_is_paused_tilted_pushed_given_a_drop_and_stopped_by_pointer_and_keys(browser, run):
    process, address, out = run
    shown = ShownPage(browser, address, DOMAIN)
    page, began = shown.page, shown.frame
    assert shown.read("state", "running")
    assert shown.text("title") == "Water and oil to play with"
    assert page.locator('[data-when="stored"]:visible').count() == 0
    assert shown.command == f"tipfem render {out}"
    shown.wait(lambda: shown.frame > began + 3 and step_of(shown) > 3, "the run to go on")
    assert page.get_by_label("pushes the fluids").is_checked()
    shown.sees(0.6, 0.1, WATER)
    shown.sees(0.6, 0.8, OIL)

    plots = shown.part("series").locator("canvas")
    shown.wait(lambda: plots.count() == 3 and plots.last.is_visible(), "the energy and forces over time")
    assert plots.first.get_attribute("aria-label") == "kinetic energy [J/m] over time"
    assert plots.last.get_attribute("aria-label") == "force of the walls, y [N/m] over time"

    shown.button("go").click()
    shown.read("state", "paused")
    step = step_of(shown)
    shown.key(".", ".")
    shown.wait(lambda: step_of(shown) == step + 2, "two steps")
    assert "real time" not in shown.text("progress")  # nor a speed: it does not go on
    page.wait_for_timeout(300)
    assert step_of(shown) == step + 2

    shown.key("z")
    assert shown.read("note", "There is nothing to undo") == "There is nothing to undo."
    fits(page, 390)
    fits(page, 1000)
    page.set_viewport_size({"width": 1280, "height": 760})

    # The pendulum's bob hangs down; it is dragged to the lower right.
    bob = shown.part("pendulum").bounding_box()
    middle = bob["x"] + bob["width"] / 2, bob["y"] + bob["height"] / 2
    page.mouse.move(middle[0], middle[1] + 30)
    page.mouse.down()
    page.mouse.move(middle[0] + 20, middle[1] + 20, steps=3)
    page.mouse.up()
    shown.read("gravity-is", "9.81 m/s²", "45°")
    tilted = pytest.approx([9.81 / 2**0.5, -9.81 / 2**0.5], abs=1e-3)
    shown.wait(lambda: commands(out) and commands(out)[-1]["value"] == tilted, "the tilt in the file")

    # A drop too near to a wall is refused, and so is one in its own fluid: the picture says why, and nothing alarms.
    page.get_by_label("adds drops").check()
    assert not shown.part("strength").is_visible()
    shown.part("drop-fluid").select_option("water")
    for place, why in (((0.6, 0.87), "There is no room for a drop here."), ((0.6, 0.2), "This is water already.")):
        page.mouse.click(*shown.point(*place))
        shown.wait(lambda why=why: shown.part("said").text_content() == why, why)
        assert page.locator("[role=alert]:visible").count() == 0
    page.mouse.click(*shown.point(0.6, 0.65))
    shown.wait(lambda: commands(out)[-1]["command"] == "drop", "the drop")
    shown.sees(0.6, 0.65, WATER)
    assert commands(out)[-1]["command"] == "drop"
    assert commands(out)[-1]["at"] == pytest.approx([0.6, 0.65], abs=5e-3)

    shown.key(" ")
    shown.read("state", "running")
    page.get_by_label("pushes the fluids").check()
    page.mouse.move(*shown.point(0.3, 0.15))
    page.mouse.down()
    page.mouse.move(*shown.point(0.45, 0.2), steps=5)
    before = shown.frame
    shown.wait(lambda: shown.frame > before + 3, "the push to be seen")
    page.mouse.up()
    shown.wait(lambda: commands(out)[-1].get("at", 0) is None, "the end of the push")
    assert any(line["command"] == "poke" and line["at"] and line["acceleration"][0] > 5 for line in commands(out))

    told = len(commands(out))
    shown.key("]")
    shown.wait(lambda: len(commands(out)) > told, "another tilt")
    shown.key("z")
    shown.wait(lambda: len(commands(out)) == told, "the tilt to be undone")

    page.get_by_label("moves the picture").check()
    page.mouse.click(*shown.point(0.9, 0.8))
    shown.read("values", "oil", "velocity x")
    shown.wait(lambda: "oil" in shown.part("said").text_content(), "the values to be read out")
    assert shown.part("history").is_visible()  # which grows as the run goes on
    shown.wait(lambda: page.get_attribute(".tipfem-viewer", "data-history"), "the history")

    other = ShownPage(browser, address, DOMAIN, width=800, scheme="dark")
    other.read("state", "watching", "running")
    assert other.button("stop").is_disabled()
    assert page.get_attribute(".tipfem-viewer", "data-theme") == "light"

    shown.button("stop").click()
    for each in (shown, other):
        each.read("note", "The run has ended")
        assert each.text("state") == "ended"
        assert each.button("go").is_disabled()
        each.close()
    assert process.wait(PATIENCE) == 0
    assert json.loads((out / "summary.json").read_text())["status"] == "stopped by a command"
    assert {line["command"] for line in commands(out)} == {"gravity", "drop", "poke"}
    assert repeated(out) == json.loads((out / "summary.json").read_text())["steps"]


@pytest.mark.slow
def test_keys_tilt_push_and_drop_too(browser, run):
    process, address, out = run
    shown = ShownPage(browser, address, DOMAIN)
    shown.read("state", "running")
    shown.key("?")
    keys = shown.text("keys")
    assert all(
        says in keys for says in ("pause, go on", "one step", "tilt", "push", "add a drop", "stop the simulation")
    )
    assert "next time" not in keys
    shown.key("Escape")
    shown.wait(lambda: not shown.part("keys").is_visible(), "the keys to close")
    shown.key("]", "]")
    shown.read("gravity-is", "10°")
    shown.key("L")
    shown.wait(lambda: commands(out) and commands(out)[-1].get("at", 0) is None, "a push and its end")
    shown.page.get_by_label("adds drops").check()
    shown.part("drop-fluid").select_option("water")
    shown.page.get_by_label("moves the picture").check()
    shown.page.mouse.click(*shown.point(0.6, 0.67))
    shown.read("where", "at x =")
    shown.canvas.focus()
    shown.key("n")
    shown.wait(lambda: commands(out)[-1]["command"] == "drop", "the drop")
    assert commands(out)[-1]["fluid"] == "water"
    assert commands(out)[-1]["at"] == pytest.approx([0.6, 0.67], abs=5e-3)
    with shown.page.expect_download() as kept:
        shown.button("keep").click()
    file = out.parent / "kept.html"
    kept.value.save_as(file)
    assert file.stat().st_size < 300_000
    times = re.search(r'"times":\[([^]]*)\]', file.read_text())[1].split(",")
    assert len(times) > 2
    assert sorted(times, key=float) == times
    # It opens as it was seen, and offers the speed at all times.
    page = browser.new_page(reduced_motion="reduce")
    page.goto(file.as_uri())
    page.wait_for_selector("html[data-ready]")
    assert page.locator("#field option").all_inner_texts() == ["fluids", "speed [m/s]"]
    assert page.locator("#field").input_value() == "-1"
    page.locator("#field").select_option("0")
    middle = int(page.evaluate("Math.floor(Number(time.max) / 2)"))
    page.evaluate(f"show({middle}, 0.5)")
    page.wait_for_function(f"() => record.film.between({middle}, 0.5, () => {{}})")
    assert page.evaluate("0 <= record.film.low && record.film.low < record.film.high")
    page.close()
    shown.button("again").click()
    shown.wait(lambda: not commands(out), "the start without commands")
    shown.wait(lambda: step_of(shown) > 2, "the run that has begun anew")
    shown.key("X")
    shown.read("note", "The run has ended")
    shown.close()
    assert process.wait(PATIENCE) == 0, process.stderr.read()


@pytest.mark.parametrize(
    "name", ["SIGTERM", pytest.param("SIGINT", marks=pytest.mark.slow), pytest.param("SIGHUP", marks=pytest.mark.slow)]
)
def test_a_signal_ends_the_run_and_its_page(browser, run, name):
    process, address, out = run
    shown = ShownPage(browser, address, DOMAIN)
    process.send_signal(getattr(signal, name))
    shown.read("note", "The run has ended")
    shown.close()
    assert process.wait(PATIENCE) == (0 if name == "SIGINT" else 128 + getattr(signal, name))
    assert json.loads((out / "summary.json").read_text())["status"].startswith(("interrupted", "ended by signal"))


@pytest.mark.slow
def test_a_body_is_dragged_and_a_fluid_made_thicker(browser, tmp_path):
    """By the pointer and by a slider's keys; the run repeated from its file is the same to the bit."""
    out = tmp_path / "play"
    process, address = start(out, "--tilt", "0")
    shown = ShownPage(browser, address, DOMAIN)
    page = shown.page
    assert page.get_by_label("pushes the fluids").is_checked()  # what begins on a body drags it
    shown.wait(lambda: step_of(shown) > 3, "the run to go on")
    page.mouse.move(*shown.point(0.61, 0.43))
    page.mouse.down()
    page.mouse.move(*shown.point(0.75, 0.6), steps=5)
    pushes = [line for line in commands(out) if line["command"] == "poke" and line["at"]]
    shown.wait(lambda: len(commands(out)) > len(pushes) + 25, "the box to be drawn for some time")
    page.mouse.up()
    shown.wait(lambda: commands(out)[-1]["at"] is None, "the box to be let go")
    held = [line["at"] for line in commands(out) if line["at"]]
    assert held[-1][0] - held[0][0] > 0.02
    assert held[-1][1] - held[0][1] > 0.02
    shown.part("viscous").select_option("oil")
    shown.read("viscosity-is", "0.1 Pa s")
    shown.part("viscosity").press("ArrowRight")
    shown.read("viscosity-is", "0.13 Pa s")
    shown.wait(lambda: commands(out)[-1]["command"] == "viscosity", "the viscosity in the file")
    assert commands(out)[-1]["fluid"] == "oil"
    assert commands(out)[-1]["value"] == pytest.approx(10**-0.9)
    shown.button("stop").click()
    assert process.wait(PATIENCE) == 0
    shown.close()
    assert repeated(out, box=True) > 20


@pytest.mark.slow
def test_pouring_goes_on_while_the_pointer_is_held_and_no_gesture_alarms(browser, run):
    """Drops of water one after another in the oil; pushes across the walls; from beside the tank the picture moves."""
    _, address, out = run
    shown = ShownPage(browser, address, DOMAIN)
    page = shown.page
    page.evaluate("""() => {
        window.alarms = [];
        const note = document.querySelector("[role=alert]");
        new MutationObserver(() => note.hidden || alarms.push(note.textContent)).observe(note, { attributes: true });
    }""")
    shown.wait(lambda: step_of(shown) > 3, "the run to go on")
    page.get_by_label("adds drops").check()
    shown.part("drop-fluid").select_option("water")
    shown.part("drop").fill("0.1")
    page.mouse.move(*shown.point(0.6, 0.68))
    page.mouse.down()
    drops = lambda: [line for line in commands(out) if line["command"] == "drop"]  # noqa: E731
    shown.wait(lambda: len(drops()) > 1, "a second drop")
    page.mouse.move(*shown.point(1.3, 0.68), steps=8)  # it goes on to where there is no tank
    page.wait_for_timeout(500)
    page.mouse.up()
    assert {line["fluid"] for line in drops()} == {"water"}
    page.get_by_label("pushes the fluids").check()
    for start, end in (((0.1, 0.2), (-0.1, 0.5)), ((0.6, 0.8), (0.6, 1.1)), ((1.15, 0.1), (1.4, -0.2))):
        page.mouse.move(*shown.point(*start))
        page.mouse.down()
        page.mouse.move(*shown.point(*end), steps=6)
        page.mouse.up()
    page.wait_for_timeout(1000)  # for pushes on their way
    told = len(commands(out))
    page.mouse.move(*shown.point(-0.02, 0.3))
    page.mouse.down()
    page.mouse.move(*shown.point(0.3, 0.3), steps=4)
    page.mouse.up()
    shown.wait(lambda: "--window" in shown.command, "the picture to move")
    assert not any(line["at"] for line in commands(out)[told:])
    assert page.evaluate("alarms") == []
    shown.button("stop").click()
    shown.close()


@pytest.mark.slow
def test_a_wall_is_moved_by_a_slider(browser, tmp_path):
    """Under a free surface, as a piston; the run repeated from its file is the same to the bit."""
    out = tmp_path / "play"
    process, address = start(out, "--tilt", "0", "--no-box", "--piston")
    shown = ShownPage(browser, address, DOMAIN)
    slider = shown.page.get_by_label("left")
    assert slider.is_visible()
    shown.wait(lambda: step_of(shown) > 3, "the run to go on")
    slider.focus()
    for _ in range(10):
        slider.press("ArrowRight")
    there = pytest.approx(0.2 * 0.225)
    shown.wait(lambda: commands(out) and commands(out)[-1]["value"] == there, "the wall's place in the file")
    assert {(line["command"], line["wall"]) for line in commands(out)} == {("wall", "left")}
    step = step_of(shown)
    shown.wait(lambda: step_of(shown) > step + 60, "the wall to arrive")
    shown.sees(0.02, 0.2, np.array([0xFF, 0xFF, 0xFF]))
    shown.sees(0.07, 0.2, WATER)
    shown.button("stop").click()
    assert process.wait(PATIENCE) == 0
    shown.close()
    assert repeated(out, piston=True) > 20
