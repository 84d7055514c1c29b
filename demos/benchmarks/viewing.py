"""The viewer in a browser: pictures a second in playing and zooming, time from a key to the screen.

    python -m tipfem demo benchmarks/viewing --results out/dam_break

It needs Playwright and Chromium, which runs headless on the same machine and draws without a graphics card: its own
work is part of what is measured. Each row is the middle of several tries.
"""

from __future__ import annotations

import shutil
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

from tipfem.demos import harness
from tipfem.demos.support.options import Count, Several

SIZE = {"width": 1600, "height": 900}
READY = '.tipfem-viewer:not([data-frame="0"])'
# Each runs in the page; a frame is on the screen when the browser has painted after its number has changed.
SCRIPTS = {
    # Milliseconds from a key to the frame that it brings.
    "key": """async (key) => {
        const root = document.querySelector(".tipfem-viewer"), begin = performance.now();
        const shown = new Promise((done) => new MutationObserver((_, seen) => {
            seen.disconnect();
            requestAnimationFrame(() => done(performance.now() - begin));
        }).observe(root, { attributes: true, attributeFilter: ["data-frame"] }));
        document.dispatchEvent(new KeyboardEvent("keydown", { key }));
        return Promise.race([shown, new Promise((done) => setTimeout(() => done(NaN), 5000))]);
    }""",
    # Frames a second while the times are played, to their end.
    "play": """async () => {
        const root = document.querySelector(".tipfem-viewer"), play = document.querySelector('[data-do="play"]');
        const wait = () => new Promise((done) => setTimeout(done, 5));
        play.click();
        while (play.getAttribute("aria-label") === "Play") await wait();
        const first = Number(root.dataset.frame), begin = performance.now();
        while (play.getAttribute("aria-label") !== "Play") await wait();
        return (1000 * (Number(root.dataset.frame) - first)) / (performance.now() - begin);
    }""",
    # Frames a second while the wheel turns to and fro.
    "zoom": """async (seconds) => {
        const root = document.querySelector(".tipfem-viewer"), canvas = root.querySelector(".pane canvas");
        const area = canvas.getBoundingClientRect(), first = Number(root.dataset.frame), begin = performance.now();
        for (let n = 0; performance.now() - begin < 1000 * seconds; n++) {
            const at = { clientX: area.left + 0.5 * area.width, clientY: area.top + 0.7 * area.height };
            canvas.dispatchEvent(new WheelEvent("wheel", { ...at, deltaY: n % 80 < 40 ? -25 : 25, cancelable: true }));
            await new Promise((done) => setTimeout(done, 16));
        }
        return (Number(root.dataset.frame) - first) / seconds;
    }""",
}


def measure(page: Any, tries: int) -> list[str]:
    """Figures of what is shown: pictures a second played and zoomed, and times from a key to the screen."""
    settle = 900  # ms, until the smooth picture has been drawn
    played, zoomed, times = [], [], []
    for _ in range(3):
        page.keyboard.press("Home")
        page.wait_for_timeout(settle)
        played.append(page.evaluate(SCRIPTS["play"]))
        page.keyboard.press("Home")  # also when all has been played
        page.wait_for_timeout(settle)
        zoomed.append(page.evaluate(SCRIPTS["zoom"], 2.0))
        page.keyboard.press("0")
        page.wait_for_timeout(settle)
    for number in range(tries):
        times.append(page.evaluate(SCRIPTS["key"], "+" if number % 2 == 0 else "-"))
        page.wait_for_timeout(settle)
    late = statistics.quantiles(times, n=10)[-1]
    rates = (statistics.median(played), statistics.median(zoomed), statistics.median(times), late)
    return [f"{rate:.1f}" for rate in rates[:2]] + [f"{time:.0f}" for time in rates[2:]]


def main(*, results: Several[Path], tries: Count = 20) -> int:
    """Measure and print the table.

    Args:
        results: results folders.
        tries: keys pressed for each row.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        harness.stop("this needs playwright: pip install playwright")
    print("| results | shown | pictures/s, playing | pictures/s, zooming | key to screen, median [ms] | 90 % [ms] |")
    print("|---|---|---|---|---|---|")
    for folder in results:
        words = [sys.executable, "-m", "tipfem", "view", str(folder), "--port", "0", "--no-browser"]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as viewer, sync_playwright() as driver:
            assert viewer.stdout is not None
            address = viewer.stdout.readline().split()[-1]
            browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
            page = browser.new_page(viewport=SIZE)
            page.goto(address)
            page.wait_for_selector(READY)
            for name, keys in (("fluids", ()), ("field and mesh", ("f", "m"))):
                for key in keys:
                    page.keyboard.press(key)
                page.keyboard.press(">")  # about 50 stored times a second
                page.wait_for_timeout(4000)  # the ranges are known, and all kernels compiled
                print(f"| {folder.name} | {name} | " + " | ".join(measure(page, tries)) + " |", flush=True)
                page.keyboard.press("<")
            browser.close()
            viewer.terminate()
    return 0


if __name__ == "__main__":
    harness.command(__name__)
