"""Draw the posters of the gallery and the moving pictures of README from the pages of docs/shared, in both themes.

    python docs/draw_pages.py [NAME ...]

Each page is opened in headless Chromium as a card. Its poster is the state that it opens with, the one where most
happens. The moving picture in three dimensions is of the results in out/, where share_demos.py keeps them. Needs
Playwright and Chromium.
"""

from __future__ import annotations

import html
import io
import os
import re
import shutil
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright
from tipfem.render import Results
from tipfem.render.solid import SolidRenderer

DOCS = Path(__file__).resolve().parent
POSTERS = DOCS / "images" / "posters"
THEMES = ("light", "dark")
MOVING = "obstacle"  # the page that README's first picture is of
SOLID = "splash_3d"  # the results that its second picture is of
FRAMES, SECONDS = 50, 5.0
SIDE = 480  # of moving pictures [px]


def shown_as(name: str) -> str:
    """What the gallery asks a page for: to be a card, of the fluids or of the field that it opens with."""
    asked = re.findall(rf'data-page="shared/{name}.html#(card[^"]*)"', (DOCS / "gallery.md").read_text("utf-8"))[0]
    return html.unescape(asked)


def open_card(browser, name: str, theme: str, width: int, height: int):
    """A page of docs/shared as a card that does not play."""
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme=theme, reduced_motion="reduce"
    )
    page = context.new_page()
    page.goto((DOCS / "shared" / f"{name}.html").as_uri() + f"#{shown_as(name)}")
    page.wait_for_selector("html[data-ready]")
    return page


def seen(page) -> Image.Image:
    """The page as it is now."""
    return Image.open(io.BytesIO(page.screenshot())).convert("RGB")


def draw_poster(browser, name: str, theme: str) -> None:
    """The state that a page opens with."""
    page = open_card(browser, name, theme, 480, 320)
    seen(page).save(POSTERS / f"{name}_{theme}.webp", quality=60, method=6)
    page.context.close()


def draw_movie(browser, theme: str) -> None:
    """All times of the page from the one that it opens with, as who sees no movement sees the first alone."""
    page = open_card(browser, MOVING, theme, SIDE, SIDE)
    bar = page.locator("#time")
    last = int(bar.get_attribute("max"))
    lead = round(float(bar.input_value()) * (FRAMES - 1) / last)
    frames = []
    for k in range(FRAMES):
        bar.evaluate(
            "(bar, at) => { bar.value = at; bar.dispatchEvent(new Event('input')); }", round(k * last / (FRAMES - 1))
        )
        frames.append(seen(page))
    write_movie(frames, MOVING, theme, lead)
    page.context.close()


def draw_solid(theme: str) -> None:
    """All stored times of a flow in three dimensions."""
    results = Results(DOCS.parent / "out" / SOLID, solid=True)
    with SolidRenderer((SIDE, SIDE), dark=theme == "dark") as renderer:
        frames = [Image.fromarray(renderer.frame(results.volume(k))) for k in range(len(results))]
    write_movie(frames, SOLID, theme)


def write_movie(frames: list[Image.Image], name: str, theme: str, lead: int = 0) -> None:
    """Frames as a moving picture that lasts so many seconds and rests for one at the last; it begins with ``lead``."""
    durations = [round(1000 * SECONDS / len(frames))] * (len(frames) - 1) + [1000]
    frames, durations = ([*rows[lead:], *rows[:lead]] for rows in (frames, durations))
    path = DOCS / "images" / f"{name}_{theme}.webp"
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=durations, loop=0, quality=45, method=6)


def main(names: list[str]) -> None:
    """Draw for these pages, or for all."""
    POSTERS.mkdir(exist_ok=True)
    with sync_playwright() as driver:
        arguments = ["--no-sandbox"] if os.getuid() == 0 else []
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=arguments)
        for path in sorted((DOCS / "shared").glob("*.html")):
            if names and path.stem not in names:
                continue
            for theme in THEMES:
                draw_poster(browser, path.stem, theme)
                if path.stem == MOVING:
                    draw_movie(browser, theme)
                if path.stem == SOLID:
                    draw_solid(theme)
        browser.close()


if __name__ == "__main__":
    main(sys.argv[1:])
