"""Take docs/images/viewer.png: the viewer's page with the dam break, in headless Chromium.

    python -m tipfem demo dam_break --no-frames
    python docs/draw_viewer.py out/dam_break

It needs Playwright and Chromium, as the tests of the page do.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

PICTURE = Path(__file__).resolve().parent / "images" / "viewer.png"
SIZE = {"width": 1360, "height": 930}


def main(out: str) -> None:
    """Start the viewer of a results folder, choose what is shown, and take the picture.

    Args:
        out: the results folder.
    """
    from playwright.sync_api import sync_playwright

    words = [sys.executable, "-m", "tipfem", "view", out, "--port", "0", "--no-browser"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as viewer, sync_playwright() as driver:
        assert viewer.stdout is not None
        address = viewer.stdout.readline().split()[-1]
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport=SIZE)
        page.goto(address)
        page.wait_for_selector('.tipfem-viewer[data-moving="false"]')
        page.select_option('[data-name="field"]', "speed")
        for key in ("v", *["PageDown"] * 6):
            page.keyboard.press(key)
        box = page.locator(".pane canvas").bounding_box()
        assert box is not None
        page.mouse.click(box["x"] + 0.62 * box["width"], box["y"] + 0.86 * box["height"])
        page.wait_for_selector('.tipfem-viewer[data-history="1"]', timeout=120_000)
        page.wait_for_timeout(3000)  # the range of the colours grows until all times have been looked at
        page.wait_for_selector('.tipfem-viewer[data-moving="false"]')
        page.screenshot(path=str(PICTURE))
        browser.close()
        viewer.terminate()
    print(PICTURE)


if __name__ == "__main__":
    main(sys.argv[1])
