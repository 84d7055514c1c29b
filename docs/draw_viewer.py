"""Take docs/images/viewer.png and play.png: the viewer's page with a dam break, and that of a run that is played with.

    python docs/draw_viewer.py

Both runs are made in a temporary folder; ``--results FOLDER`` takes a dam break that is there already. It needs
Playwright and Chromium, as the tests of the page do.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cyclopts

# The middle of what has the colour of bodies [px of the page].
BODY = """() => {
    const canvas = document.querySelector(".pane canvas[role]"), at = [];
    const { left, top } = canvas.getBoundingClientRect();
    const { data, width } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    for (let k = 0; k < data.length; k += 4) {
        if (data[k] === 0xc3 && data[k + 1] === 0xc8 && data[k + 2] === 0xcf) at.push([(k / 4) % width, k / 4 / width]);
    }
    return [left, top].map((from, axis) => from + at.reduce((sum, place) => sum + place[axis], 0) / at.length);
}"""
PICTURES = Path(__file__).resolve().parent / "images"


@contextmanager
def opened(words: Sequence[str], width: int, height: int) -> Iterator[Any]:
    """The page that a command of tipfem serves, in headless Chromium.

    Args:
        words: of the command.
        width: of the page [px].
        height: of it [px].
    """
    from playwright.sync_api import sync_playwright

    command = [sys.executable, "-m", "tipfem", *words, "--port", "0", "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process, sync_playwright() as driver:
        assert process.stdout is not None
        address = process.stdout.readline().split()[-1]
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": width, "height": height})
        page.set_default_timeout(180_000)
        page.goto(address)
        page.wait_for_selector('.tipfem-viewer:not([data-frame="0"])')
        yield page
        browser.close()
        process.terminate()


def place(page: Any, x: float, y: float) -> tuple[float, float]:
    """A point of the page [px] at shares x and y of the picture's width and height."""
    box = page.locator(".pane canvas[role]").bounding_box()
    return box["x"] + x * box["width"], box["y"] + y * box["height"]


def draw_results(out: Path) -> None:
    """Take viewer.png: speed with arrows, and the history of a point in the water's tongue."""
    with opened(["view", str(out)], 1280, 800) as page:
        page.select_option('[data-name="field"]', "speed")
        for key in ("v", *["PageDown"] * 6):
            page.keyboard.press(key)
        page.wait_for_selector('[data-name="clock"] >> text=61/')
        page.mouse.click(*place(page, 0.62, 0.86))
        page.wait_for_selector('.tipfem-viewer[data-history="1"]')
        page.wait_for_timeout(3000)  # the range of the colours grows until all times have been looked at
        page.evaluate("document.activeElement.blur()")
        page.screenshot(path=str(PICTURES / "viewer.png"))


def draw_play(out: Path) -> None:
    """Take play.png: gravity is tilted, a drop falls, and the box is dragged."""
    with opened(["demo", "play", "--paused", "--out", str(out)], 1280, 800) as page:
        page.wait_for_selector('[data-name="gravity-is"] >> text=20°')
        page.get_by_label("adds drops").check()
        page.mouse.click(*place(page, 0.5, 0.25))
        page.get_by_label("pushes the fluids").check()
        page.locator('[data-do="go"]').click()
        page.wait_for_function("() => / ([6-9]\\d|\\d{3,}) /.test(document.querySelector('.pace').textContent)")
        x, y = page.evaluate(BODY)
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 110, y - 80, steps=5)
        page.wait_for_timeout(500)
        page.evaluate("document.activeElement.blur()")
        # How fast this machine is says nothing of others.
        page.locator('[data-do="go"]').evaluate("(button) => button.click()")
        page.wait_for_function("() => !document.querySelector('.pace').textContent.includes('real time')")
        page.screenshot(path=str(PICTURES / "play.png"))
        page.mouse.up()
        page.keyboard.press("X")
        page.wait_for_selector('[data-name="note"]:has-text("ended")')


def main(*, results: Path | None = None) -> None:
    """Make the runs and take the pictures.

    Args:
        results: results folder of the dam break; by default it is run.
    """
    with tempfile.TemporaryDirectory() as folder:
        if results is None:
            results = Path(folder) / "dam_break"
            words = [sys.executable, "-m", "tipfem", "demo", "dam_break", "--no-frames", "--out", str(results)]
            subprocess.run(words, check=False)  # its check of the front's place does not matter here
        draw_results(results)
        draw_play(Path(folder) / "play")
    print(f"{PICTURES / 'viewer.png'}\n{PICTURES / 'play.png'}")


if __name__ == "__main__":
    cyclopts.run(main)
