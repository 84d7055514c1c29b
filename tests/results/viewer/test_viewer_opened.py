"""Pages as a user comes to them, in headless Chromium: by the browser that the viewer opens, and to a running run."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

import pytest
from render_results import SIDE, write_results
from shown_page import PATIENCE, ShownPage
from view_client import TIMES

RUN = """
import sys, tipfem as tp
tp.init(threads=1)
water = tp.Fluid("water", density=998.2, viscosity=1e-3)
tank = tp.tank(size=(1.0, 0.5), spacing=0.1).fill(water)
case = tp.Case(tank, fluids=[water], gravity=(0, -9.81))
print("begun", flush=True)
tp.Simulation(case, sys.argv[1], time_step=0.01).run(until=1e6, progress=False)
"""


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
