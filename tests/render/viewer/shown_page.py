"""A page of the viewer in headless Chromium: what a user does with pointer and keys, and what is then seen.

The page follows its viewer with a delay that is long on a busy machine, so whatever a test reads is waited for.
"""

from __future__ import annotations

import io
import time

import numpy as np
import pytest
from PIL import Image
from tipfem.render.colours import DARK, GASES, LIGHT, LIQUIDS, at_depth, hex_code, shades

PATIENCE = 240.0  # longest wait for what the page is to show [s]
LEFT, TOP, RIGHT, BOTTOM = 66, 8, 16, 46  # [px] around the picture, as in stage.js
MARGIN = 0.035  # of the domain, as in render/viewer/choices.py


class ShownPage:
    """A page in the browser.

    Args:
        browser: of Playwright.
        address: of the viewer.
        domain: (width, height) [m], from the origin.
        width: of the page [px].
        height: of the page [px].
        scheme: "light" or "dark".
        before: script that runs before those of the page.
    """

    def __init__(self, browser, address, domain, width=1280, height=760, scheme="light", before=""):
        context = browser.new_context(
            viewport={"width": width, "height": height}, color_scheme=scheme, accept_downloads=True
        )
        self.domain = domain
        context.add_init_script(before)
        self.page = context.new_page()
        self.page.set_default_timeout(1000 * PATIENCE)
        self.complaints, self.asked = [], []
        self.page.on("console", lambda message: self.hear(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(address)
        self.page.wait_for_selector('.tipfem-viewer:not([data-frame="0"])')
        self.canvas = self.page.locator(".pane canvas[role]")

    def hear(self, text):
        """Keep what the page complains of; that the browser has no graphics card is its own business."""
        if "GL Driver Message" not in text:
            self.complaints.append(text)

    def part(self, name):
        """An element by its name."""
        return self.page.locator(f'[data-name="{name}"]')

    def text(self, name):
        """Text of an element."""
        return self.part(name).inner_text()

    def button(self, action):
        """A button by what it does."""
        return self.page.locator(f'[data-do="{action}"]')

    @property
    def frame(self):
        """Number of the last frame on the screen."""
        return int(self.page.get_attribute(".tipfem-viewer", "data-frame"))

    @property
    def command(self):
        """The command line that draws the same."""
        return self.part("command").input_value()

    def wait(self, condition, what):
        """Wait until a condition holds."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            if condition():
                return
            self.page.wait_for_timeout(40)
        pytest.fail(f"waited for {what}")

    def read(self, name, *words):
        """Wait until the text of an element has words; returns it."""
        self.wait(lambda: all(word in self.text(name) for word in words), f"{words} in {name}: {self.text(name)!r}")
        return self.text(name)

    def at(self, number):
        """Wait until the clock shows the stored time of this number, the first being 1."""
        self.wait(lambda: self.text("clock").split()[-1].split("/")[0] == str(number), f"stored time {number}")

    def key(self, *keys):
        """Press keys."""
        for key in keys:
            self.page.keyboard.press(key)

    def place(self, x, y):
        """Where a point of the domain [m] is on the canvas, while all of the domain is shown."""
        box = self.canvas.bounding_box()
        left, top, width, height = LEFT, TOP, box["width"] - LEFT - RIGHT, box["height"] - TOP - BOTTOM
        margin = 2 * MARGIN * max(self.domain)
        scale = min(width / (self.domain[0] + margin), height / (self.domain[1] + margin))
        middle = self.domain[0] / 2, self.domain[1] / 2
        return left + width / 2 + (x - middle[0]) * scale, top + height / 2 - (y - middle[1]) * scale

    def point(self, x, y):
        """Where a point of the domain [m] is on the page."""
        box, (px, py) = self.canvas.bounding_box(), self.place(x, y)
        return box["x"] + px, box["y"] + py

    def colour(self, x, y):
        """The colour at a point of the domain, as it is on the screen."""
        image = np.asarray(Image.open(io.BytesIO(self.canvas.screenshot())).convert("RGB")).astype(int)
        px, py = self.place(x, y)
        return image[round(py), round(px)]

    def sees(self, x, y, colour):
        """Wait until a point of the domain has a colour; that of a fluid is shaded by depth."""
        self.wait(lambda: abs(self.colour(x, y) - self.shaded(colour, y)).max() < 8, f"{colour} at {x}, {y}")

    def shaded(self, colour, y):
        """A colour of a fluid as it is at a height [m]; others as they are."""
        code = hex_code(colour / 255)
        if code not in (*LIQUIDS, *GASES):
            return colour
        scheme = DARK if self.page.get_attribute(".tipfem-viewer", "data-theme") == "dark" else LIGHT
        return 255 * at_depth(shades([colour / 255], scheme)[0], y, self.domain[1], 0.0)

    def close(self):
        """Close the page; it has nothing to complain of."""
        self.page.context.close()
        assert self.complaints == [], self.complaints
