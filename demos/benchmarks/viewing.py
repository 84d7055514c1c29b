"""The viewer in a browser: first picture, from key or drag to the screen, pictures a second, bytes a state.

    python -m tipfem demo benchmarks/viewing --results out/dam_break

It needs Playwright and Chromium, which runs headless on the same machine and draws without a graphics card: its own
work is part of what is measured. Each number is the middle of several tries.
"""

from __future__ import annotations

import shutil
import statistics
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tipfem.demos import harness
from tipfem.demos.support.options import Count, Several

SIZE = {"width": 1600, "height": 900}
READY = '.tipfem-viewer:not([data-frame="0"])'
SETTLES = 700  # ms after which what was asked for is done
OPENED = 3  # times that a page is opened, and its times are played
LOOKS = (("fluids", ()), ("field and mesh", ("f", "m")))  # names, and keys that lead there from the one before
# Counts the pictures that are painted, each once however often it is touched before it is on the screen.
COUNTS = """
window.painted = 0;
const clear = CanvasRenderingContext2D.prototype.clearRect;
CanvasRenderingContext2D.prototype.clearRect = function (...box) {
    const count = () => ((window.due = 0), window.painted++);
    if (this.canvas.tabIndex === 0 && !window.due) window.due = requestAnimationFrame(count);
    return clear.apply(this, box);
};
"""
# Milliseconds from what a user does to the picture that it brings, which is on the screen; NaN if there is none.
TIMED = """async ([what, along]) => {
    const canvas = document.querySelector(".pane canvas[role]"), before = window.painted;
    const { left, top, width, height } = canvas.getBoundingClientRect();
    const at = (dx) => ({ clientX: left + 0.5 * width + dx, clientY: top + 0.5 * height, pointerId: 1, bubbles: true });
    canvas.setPointerCapture = () => {};
    if (what === "drag") canvas.dispatchEvent(new PointerEvent("pointerdown", { ...at(0), button: 0 }));
    const begin = performance.now();
    if (what === "drag") canvas.dispatchEvent(new PointerEvent("pointermove", at(along)));
    else document.dispatchEvent(new KeyboardEvent("keydown", { key: what }));
    while (window.painted === before && performance.now() - begin < 3000) await new Promise(requestAnimationFrame);
    const passed = performance.now() - begin;
    if (what === "drag") canvas.dispatchEvent(new PointerEvent("pointerup", at(along)));
    return window.painted === before ? NaN : passed;
}"""
# States and pictures a second while the times are played, to their end.
PLAYED = """async () => {
    const root = document.querySelector(".tipfem-viewer"), play = document.querySelector('[data-do="play"]');
    const said = (label) => new Promise((done) => {
        const look = () => ((play.getAttribute("aria-label") === "Play") === label ? done() : setTimeout(look, 5));
        look();
    });
    play.click();
    await said(false);
    const [first, painted, begin] = [Number(root.dataset.frame), window.painted, performance.now()];
    await said(true);
    const seconds = (performance.now() - begin) / 1000;
    return [(Number(root.dataset.frame) - first) / seconds, (window.painted - painted) / seconds];
}"""


def middle(measured: Callable[[int], Any], tries: int) -> float:
    """The median of what is measured so many times, each with its number."""
    return statistics.median(measured(number) for number in range(tries))


def timed(page: Any, what: str, along: float = 0.0) -> float:
    """Milliseconds from a key, or a drag along some pixels, to the screen, once nothing else goes on."""
    page.wait_for_timeout(SETTLES)
    return float(page.evaluate(TIMED, [what, along]))


def measure(page: Any, frames: list[int], tries: int) -> list[str]:
    """Figures of what is shown.

    Args:
        page: of the viewer.
        frames: bytes of the frames that it has been sent.
        tries: of each key.
    """
    played = []
    for _ in range(OPENED):
        page.keyboard.press("Home")
        page.wait_for_timeout(SETTLES)
        frames.clear()
        played.append(page.evaluate(PLAYED))
    page.keyboard.press("Home")
    states, pictures = (statistics.median(each[k] for each in played) for k in (0, 1))
    size = statistics.median(frames) / 1000
    zoom = middle(lambda number: timed(page, "-" if number % 2 else "+"), tries)
    drag = middle(lambda number: timed(page, "drag", -25 if number % 2 else 25), tries)
    page.keyboard.press("0")
    time = middle(lambda number: timed(page, "ArrowRight"), tries)
    return [f"{number:.0f}" for number in (zoom, drag, time, states, pictures)] + [f"{size:.1f}"]


def opened(browser: Any, address: str) -> tuple[Any, list[int], float]:
    """A page of the viewer, the bytes of its frames, and the milliseconds to its first picture."""
    page, frames = browser.new_page(viewport=SIZE), list[int]()

    def hear(message: Any) -> None:
        if isinstance(message, bytes):
            frames.append(len(message))

    page.on("websocket", lambda one: one.on("framereceived", hear))
    page.add_init_script(COUNTS)
    page.goto(address)
    page.wait_for_selector(READY)
    return page, frames, float(page.evaluate("new Promise(requestAnimationFrame).then(() => performance.now())"))


def main(*, results: Several[Path], tries: Count = 9) -> int:
    """Measure and print the table.

    Args:
        results: results folders.
        tries: keys pressed for each number.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        harness.stop("this needs playwright: pip install playwright")
    times = ("first picture [ms]", "zoom [ms]", "drag [ms]", "next time [ms]")
    heads = ("results", "shown", *times, "states/s, playing", "pictures/s, playing", "a state [kB]")
    print("| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|", flush=True)
    for folder in results:
        words = [sys.executable, "-m", "tipfem", "view", str(folder), "--port", "0", "--no-browser"]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as viewer, sync_playwright() as driver:
            assert viewer.stdout is not None
            address = viewer.stdout.readline().split()[-1]
            browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
            firsts = []
            for _ in range(OPENED):
                page, frames, first = opened(browser, address)
                firsts.append(first)
                if len(firsts) < OPENED:
                    page.close()
            page.keyboard.press(">")  # 50 stored times a second
            for name, keys in LOOKS:
                for key in keys:
                    page.keyboard.press(key)
                page.wait_for_timeout(4000)  # ranges are known
                row = [folder.name, name, f"{statistics.median(firsts):.0f}", *measure(page, frames, tries)]
                print("| " + " | ".join(row) + " |", flush=True)
            browser.close()
            viewer.terminate()
    return 0


if __name__ == "__main__":
    harness.command(__name__)
