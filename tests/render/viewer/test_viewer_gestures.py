"""Whatever a hand does to a run, the run goes on: random gestures, of a seed, in headless Chromium."""

from __future__ import annotations

import random
import time

import pytest
from shown_page import ShownPage
from test_viewer_live_page import DOMAIN, start, step_of

CASES = {"two liquids": ("--no-box",), "a box": (), "a piston": ("--piston", "--no-box")}
KEYS = (".", "[", "]", "J", "L", "I", "K", "n", "z", "m", "f", "t", "l", "v", "o", "+", "-", "0", "k", "Escape")
SET = """(input, share) => {
    const low = Number(input.min), high = Number(input.max);
    input.value = low + share * (high - low);
    input.dispatchEvent(new Event("input", { bubbles: true }));
}"""


class Hand:
    """Draws gestures on a page.

    Args:
        shown: the page.
        seed: of the numbers that they are drawn with.
    """

    def __init__(self, shown, seed):
        self.shown, self.page, self.any = shown, shown.page, random.Random(seed)

    def place(self):
        """A point in the picture or a little beyond the tank."""
        return self.shown.point(self.any.uniform(-0.1, DOMAIN[0] + 0.1), self.any.uniform(-0.1, DOMAIN[1] + 0.1))

    def tool(self):
        """Take another tool."""
        tools = self.page.locator("[data-name=tools] input:visible")
        tools.nth(self.any.randrange(tools.count())).check()

    def drag(self):
        """Press somewhere, go somewhere else, wait, and let go."""
        self.page.mouse.move(*self.place())
        self.page.mouse.down()
        self.page.mouse.move(*self.place(), steps=self.any.randint(1, 6))
        self.page.wait_for_timeout(self.any.choice([0, 50, 900]))
        self.page.mouse.up()

    def click(self):
        """Click somewhere."""
        self.page.mouse.click(*self.place())

    def slide(self):
        """Set a slider of those of the simulation."""
        sliders = self.page.locator("[data-name=steering] input[type=range]:visible")
        chosen = sliders.nth(self.any.randrange(sliders.count()))
        chosen.evaluate(SET, self.any.random())

    def choose(self):
        """Choose in a list of those of the simulation, such as another fluid."""
        lists = self.page.locator("[data-name=steering] select:visible")
        if lists.count():
            chosen = lists.nth(self.any.randrange(lists.count()))
            chosen.select_option(index=self.any.randrange(chosen.locator("option").count()))

    def key(self):
        """Press a key."""
        self.page.keyboard.press(self.any.choice(KEYS))

    def pause(self):
        """Pause, or go on."""
        self.page.keyboard.press(" ")

    def any_gesture(self):
        """One of them."""
        kinds = [self.tool, self.drag, self.drag, self.click, self.slide, self.slide, self.choose, self.key, self.pause]
        self.any.choice(kinds)()


def play_with(browser, out, options, seconds, seed):
    """Start a run, make gestures for some time while it is paused and while it runs; it takes steps then."""
    process, address = start(out, *options)
    try:
        shown = ShownPage(browser, address, DOMAIN)
        shown.wait(lambda: step_of(shown) > 0, "the first step")
        hand, end = Hand(shown, seed), time.monotonic() + seconds
        shown.button("go").click()
        shown.read("state", "paused")
        for fluid in ("water", "oil"):  # each control, once while it is paused
            if fluid in shown.text("viscous"):
                shown.part("viscous").select_option(fluid)
                shown.part("viscosity").evaluate(SET, 0.6)
        while time.monotonic() < end:
            hand.any_gesture()
        assert process.poll() is None, process.stderr.read()
        before = step_of(shown)

        def goes_on():
            if "paused" in shown.text("state"):  # also by a gesture that was on its way
                shown.button("go").click()
            return step_of(shown) not in (before, -1)

        shown.wait(goes_on, "further steps")
        assert process.poll() is None, process.stderr.read()
        shown.close()
    finally:
        process.kill()
        process.wait()


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_a_run_goes_on_whatever_a_hand_does_to_it(browser, tmp_path, case):
    play_with(browser, tmp_path / "play", CASES[case], 6.0, seed=1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
@pytest.mark.parametrize("case", CASES)
def test_a_run_goes_on_after_a_minute_of_gestures(browser, tmp_path, case, seed):
    play_with(browser, tmp_path / "play", CASES[case], 60.0, seed)
