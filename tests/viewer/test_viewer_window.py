"""The viewer in a window: keys and the pointer as messages, and a real window on a display without a screen."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from typing import ClassVar

import numpy as np
import pytest
from render_results import write_results

from tipfem.viewer import ResultsSource
from tipfem.viewer.native import show_window

TIMES = tuple(0.1 * k for k in range(12))


class FakeScreen:
    """A window that nobody sees: a script presses keys and looks at what is shown, look by look."""

    def __init__(self, script):
        self.size, self.pointer, self.open = (640, 400), (0.5, 0.5), True
        self.script, self.pressed = script(self), []
        self.image, self.lines, self.panel, self.closed = None, [], [], False

    def keys(self):
        """What the script has pressed since the last look."""
        try:
            next(self.script)
        except StopIteration:
            self.open = False
        pressed, self.pressed = self.pressed, []
        return pressed

    def press(self, *keys):
        """Press and let go of keys."""
        self.pressed += [(key, True) for key in keys]

    def show(self, image, lines, legend, panel=()):
        """Keep what is shown."""
        self.image = self.image if image is None else image
        self.lines, self.legend, self.panel = list(lines), list(legend), list(panel)

    def close(self):
        """Keep that it was closed."""
        self.closed = True


def until(screen, condition):
    """Let looks pass until a condition holds."""
    for _ in range(600):
        if condition():
            return
        yield
    raise AssertionError(screen.lines)


class LiveStub(ResultsSource):
    """Stored results that take commands, and keep them."""

    commands = frozenset({"pause", "go", "step", "stop", "gravity", "poke", "drop"})
    limits: ClassVar = {"gravity": 98.0, "poke_acceleration": 50.0, "poke_radius": 0.5, "drop_radius": 0.2}
    live, interval = True, 0.02

    def __init__(self, out):
        super().__init__(out)
        self.given = []

    def status(self):
        return {"state": "running", "step": 3, "gravity": [0.0, -10.0]}

    def command(self, name, values):
        self.given.append((name, dict(values)))


def test_keys_step_through_stored_results_and_zoom(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out, seen = write_results(tmp_path / "wave", TIMES, sharp=True), {}

    def script(screen):
        yield from until(screen, lambda: screen.image is not None)
        assert screen.image.shape == (400, 640, 3)
        first = screen.image
        screen.press("ArrowRight", "ArrowRight")
        yield from until(screen, lambda: "t = 0.2000 s" in screen.lines[0])
        screen.press("f")
        yield from until(screen, lambda: "pressure" in screen.lines[0])
        screen.press("ArrowUp")
        yield from until(screen, lambda: not np.array_equal(screen.image, first))
        screen.press("Tab")
        yield from until(screen, lambda: any("zoom in" in line for line in screen.panel))
        assert not any("gravity" in line for line in screen.panel)  # results take no commands
        screen.press("Tab", "k")
        yield from until(screen, lambda: len(screen.lines) > 1 and screen.lines[1].startswith("at "))
        screen.press("g")
        yield from until(screen, lambda: list(tmp_path.glob("*.png")))
        seen["legend"] = screen.legend

    screens = []

    def opened(title, size):
        screens.append(FakeScreen(script))
        return screens[0]

    said = []
    show_window([ResultsSource(out)], said.append, open_screen=opened)
    assert screens[0].closed
    assert said[0].startswith("Open in a window")
    assert [name for name, _ in seen["legend"]] == ["water", "air"]


def test_keys_and_the_pointer_steer_a_run(tmp_path):
    source = LiveStub(write_results(tmp_path / "wave", TIMES, sharp=True))

    def script(screen):
        yield from until(screen, lambda: screen.image is not None)
        screen.press(" ", "Enter", "ArrowRight", "ArrowRight")
        yield
        screen.pointer = (0.4, 0.3)
        screen.pressed.append(("LMB", True))
        yield
        screen.pointer = (0.6, 0.3)
        yield
        screen.pressed.append(("LMB", False))
        yield
        screen.pointer = (0.5, 0.5)
        screen.press("n", "J")
        yield from until(screen, lambda: source.given.count(("poke", {"at": None})) == 2)
        screen.press("X")
        yield

    show_window([source], lambda _: None, open_screen=lambda *_: FakeScreen(script))
    names = [name for name, _ in source.given]
    assert names[:4] == ["pause", "step", "gravity", "gravity"]
    # Ten degrees in two keys, whose length stays.
    x, y = source.given[3][1]["value"]
    assert np.degrees(np.arctan2(x, -y)) == pytest.approx(10, abs=0.01)
    assert np.hypot(x, y) == pytest.approx(10, abs=1e-3)
    pushes = [values for name, values in source.given if name == "poke"]
    assert pushes[1]["acceleration"] == pytest.approx((20, 0))  # 0.4 of the limit, dragged far enough
    assert pushes[2] == {"at": None}
    assert names[-1] == "stop"
    assert ("drop", "water") in [(name, values.get("fluid")) for name, values in source.given]


def test_without_a_display_it_is_said_and_nothing_starts(tmp_path):
    out = write_results(tmp_path / "wave", TIMES, sharp=True)
    environment = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run(
        [sys.executable, "-m", "tipfem", "view", str(out), "--native"], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "a window needs a display" in done.stderr


@pytest.mark.vulkan
def test_a_real_window_shows_the_picture(tmp_path):
    xvfb = shutil.which("xvfb-run")
    if xvfb is None:
        if os.environ.get("TIPFEM_REQUIRE_VULKAN"):
            pytest.fail("xvfb-run is not installed")
        pytest.skip("xvfb-run is not installed")
    code = (
        "import numpy as np\n"
        "from tipfem.render.screen import Screen\n"
        "screen = Screen('tipfem', (320, 200))\n"
        "image = np.zeros((200, 320, 3), np.uint8)\n"
        "image[:, 160:] = (0, 114, 178)\n"
        "image[150:] = (230, 159, 0)\n"
        "for _ in range(3):\n"
        "    screen.show(image, ['t = 1 s'], [('water', '#0072b2')])\n"
        "found = screen.pixels()\n"
        "assert found.shape == (200, 320, 3), found.shape\n"
        "assert abs(found[140, 300].astype(int) - (0, 114, 178)).max() <= 1, found[140, 300]\n"
        "assert abs(found[190, 40].astype(int) - (230, 159, 0)).max() <= 1, found[190, 40]\n"
        "assert screen.open and screen.keys() == []\n"
        "screen.close()\n"
    )
    done = subprocess.run([xvfb, "-a", sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    if done.returncode and not os.environ.get("TIPFEM_REQUIRE_VULKAN") and "DriverError" in done.stderr:
        pytest.skip(f"no Vulkan driver draws in a window here: {done.stderr.splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
