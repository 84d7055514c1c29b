"""A window on the screen that shows pictures and tells what keys and the pointer do; by Taichi's GGUI."""

import os
import sys
from collections.abc import Sequence

import numpy as np

from .arrays import Array
from .ggui import DriverError
from .runtime import ensure_runtime, ti

# GGUI tells of letters and these alone: of no digit and no sign.
_NAMES = {
    ti.ui.SPACE: " ",
    ti.ui.LEFT: "ArrowLeft",
    ti.ui.RIGHT: "ArrowRight",
    ti.ui.UP: "ArrowUp",
    ti.ui.DOWN: "ArrowDown",
    ti.ui.ESCAPE: "Escape",
    ti.ui.RETURN: "Enter",
    ti.ui.TAB: "Tab",
    ti.ui.BACKSPACE: "Backspace",
}
_LINE, _FRAME, _WIDE = 17, 46, 680  # [px] of a line of text, of what is around the lines, and of their box
_LINES = 3  # that there is room for, besides the legend


def has_display() -> bool:
    """Whether there is a screen to open a window on."""
    return sys.platform == "darwin" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


class Screen:
    """A window; one at a time in a process.

    Args:
        title: of the window.
        size: (width, height) [px].

    Raises:
        ValueError: there is no display.
        DriverError: no Vulkan driver can draw on it.
    """

    def __init__(self, title: str, size: tuple[int, int]) -> None:
        if not has_display():
            raise ValueError("a window needs a display: DISPLAY is not set; a browser needs none")
        ensure_runtime()
        self.size = size
        try:
            self._window = ti.ui.Window(title, size, show_window=True, vsync=False)
        except RuntimeError as error:
            raise DriverError(f"no Vulkan driver can draw in a window: {error}") from None
        self._canvas, self._text = self._window.get_canvas(), self._window.get_gui()
        self._picture = np.zeros((*size, 3), dtype=np.uint8)

    @property
    def open(self) -> bool:
        """Whether nobody has closed it."""
        return bool(self._window.running)

    @property
    def pointer(self) -> tuple[float, float]:
        """Place of the pointer, from (0, 0) at the lower left to (1, 1)."""
        x, y = self._window.get_cursor_pos()
        return float(x), float(y)

    def keys(self) -> list[tuple[str, bool]]:
        """What has been pressed (True) or let go since the last call: names as browsers have them, or "LMB", "RMB"."""
        pressed, released = (
            [event.key for event in self._window.get_events(kind)] for kind in (ti.ui.PRESS, ti.ui.RELEASE)
        )
        # A key that is pressed for less than a picture's time is let go already.
        shift = self._window.is_pressed(ti.ui.SHIFT) or ti.ui.SHIFT in pressed

        def named(key: str) -> str:
            return key.upper() if shift and len(key) == 1 else _NAMES.get(key, key)

        return [(named(key), True) for key in pressed] + [(named(key), False) for key in released]

    def show(
        self, image: Array | None, lines: Sequence[str], legend: Sequence[tuple[str, str]], panel: Sequence[str] = ()
    ) -> None:
        """Show a picture and text.

        Args:
            image: (H, W, 3) uint8, of the window's size or scaled to it; None for the one before.
            lines: in the upper left corner.
            legend: names and colours "#rrggbb" below them.
            panel: a list over the picture; nothing if it is empty.
        """
        if image is not None:
            self._picture = np.ascontiguousarray(np.swapaxes(image[::-1], 0, 1))
        self._canvas.set_image(self._picture)
        width, height = self.size
        # Its size is that of the first picture.
        tall = (_FRAME + _LINE * (_LINES + len(legend))) / height
        with self._text.sub_window("tipfem", 0.0, 0.0, min(1.0, _WIDE / width), tall) as box:
            for line in lines:
                box.text(line)
            for name, colour in legend:
                box.text(f"# {name}", tuple(int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)))
        if panel:
            with self._text.sub_window("Keys", 0.05, 0.15, min(0.9, 520 / width), 0.8) as box:
                for line in panel:
                    box.text(line)
        self._window.show()

    def pixels(self) -> Array:
        """The picture as the window shows it, without text, (H, W, 3) uint8."""
        self._canvas.set_image(self._picture)  # what was shown is gone
        shown = self._window.get_image_buffer_as_numpy()
        return np.ascontiguousarray((np.swapaxes(shown[..., :3], 0, 1)[::-1] * 255 + 0.5).astype(np.uint8))

    def close(self) -> None:
        """Close the window."""
        self._window.destroy()
