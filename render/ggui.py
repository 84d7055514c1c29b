"""Paint a drawing with Taichi's GGUI in an invisible window; needs a Vulkan driver, but no display.

A process has one window at a time; it is kept between pictures of one size. GGUI has no antialiasing, so
the window has twice the width and height of the picture.
"""

import atexit
import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .arrays import Array
from .drawing import Drawing
from .runtime import Bytes3, Floats3, ensure_runtime, ti

SAMPLES = 2  # a side: the window is this many times larger
_LARGEST = 16384  # [px] a side of an image, what Vulkan drivers commonly allow


class DriverError(RuntimeError):
    """No Vulkan driver that GGUI can use."""


@ti.kernel
def _shrink(tall: Floats3, image: Bytes3):
    """Filter GGUI's picture, [x, y up, RGBA], by boxes into an image (H, W, 3), y down."""
    for column, row in ti.ndrange(image.shape[1], image.shape[0]):  # along the memory of `tall`
        for k in ti.static(range(3)):
            total = ti.cast(0, ti.f32)
            for j, i in ti.static(ti.ndrange(SAMPLES, SAMPLES)):
                y = (image.shape[0] - 1 - row) * SAMPLES + j
                total += tall[column * SAMPLES + i, y, k]
            level = ti.cast(total * 255 / (SAMPLES * SAMPLES) + 0.5, ti.i32)
            image[row, column, k] = ti.cast(ti.math.clamp(level, 0, 255), ti.u8)


class _Window:
    """The process's one window, and the fields its triangles are read from."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = size
        self.program = ensure_runtime()
        with _quiet_driver() as said:
            try:
                self.window = ti.ui.Window("tipfem", size, show_window=False)
            except RuntimeError as error:
                raise DriverError(", ".join([str(error), *said()])) from None
        self.canvas = self.window.get_canvas()
        self.capacity = 0
        self._tree: Any = None

    def reserve(self, count: int) -> None:
        """Make room for `count` triangles. A new field compiles kernels, so room grows by halves."""
        if count <= self.capacity:
            return
        if self._tree is not None:
            self._tree.destroy()
        self.capacity = max(4096, count + count // 2)
        self.vertices, self.colours = ti.Vector.field(2, ti.f32), ti.Vector.field(3, ti.f32)
        builder = ti.FieldsBuilder()
        builder.dense(ti.i, 3 * self.capacity).place(self.vertices)
        builder.dense(ti.i, 3 * self.capacity).place(self.colours)
        self._tree = builder.finalize()

    def destroy(self) -> None:
        """Destroy the window and free its memory."""
        if ti.lang.impl.get_runtime().prog is not self.program:
            return  # Taichi was restarted; its end freed the window's memory
        self.window.destroy()
        if self._tree is not None:
            self._tree.destroy()


_open: _Window | None = None


def _window(size: tuple[int, int]) -> _Window:
    global _open
    if _open is not None and (_open.size != size or _open.program is not ensure_runtime()):
        close_window()
    if _open is None:
        _open = _Window(size)
    return _open


def close_window() -> None:
    """Destroy the window if there is one; an open window crashes the process at its end."""
    global _open
    if _open is not None:
        with _no_settings_file():
            _open.destroy()
        _open = None


atexit.register(close_window)


class GGUICanvas:
    """Paints drawings of one size (width, height) [px].

    Raises:
        DriverError: there is no Vulkan driver.
        ValueError: the size is too large for GGUI.
    """

    name = "ggui"

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = size
        if max(size) * SAMPLES > _LARGEST:
            raise ValueError(
                f"size {size[0]}x{size[1]}: GGUI draws up to {_LARGEST // SAMPLES} pixels "
                "a side; the backend 'raster' draws larger pictures"
            )
        with _no_settings_file():
            _window((size[0] * SAMPLES, size[1] * SAMPLES))

    def paint(self, drawing: Drawing, background: Sequence[float]) -> Array:
        """Paint a drawing, (H, W, 3) uint8, on a background (3,) in [0, 1]."""
        width, height = self.size
        vertices, colours = drawing.arrays()
        with _no_settings_file():
            window = _window((width * SAMPLES, height * SAMPLES))
            window.reserve(len(vertices))
            # GGUI draws whole fields: the unused end is triangles without area.
            corners = np.zeros((3 * window.capacity, 2), np.float32)
            corners[: 3 * len(vertices)] = vertices.reshape(-1, 2) / np.array([width, height], np.float32)
            corners[:, 1] = 1 - corners[:, 1]
            shades = np.zeros((3 * window.capacity, 3), np.float32)
            shades[: 3 * len(vertices)] = colours.reshape(-1, 3)
            window.vertices.from_numpy(corners)
            window.colours.from_numpy(shades)
            window.canvas.set_background_color(tuple(map(float, background)))
            window.canvas.triangles(window.vertices, per_vertex_color=window.colours)
            picture = window.window.get_image_buffer_as_numpy()
        image = np.empty((height, width, 3), np.uint8)
        _shrink(np.ascontiguousarray(picture), image)
        return image

    def close(self) -> None:
        """Destroy the process's window; a later picture opens it again."""
        close_window()


@contextlib.contextmanager
def _no_settings_file() -> Iterator[None]:
    """Remove the imgui.ini that GGUI writes to the working directory."""
    path = Path("imgui.ini").absolute()
    before = path.exists()
    try:
        yield
    finally:
        if not before:
            path.unlink(missing_ok=True)


@contextlib.contextmanager
def _quiet_driver() -> Iterator[Callable[[], list[str]]]:
    """Capture what the driver prints while it starts; yields a function that returns its first lines."""
    with tempfile.TemporaryFile() as held:
        saved = os.dup(2)
        os.dup2(held.fileno(), 2)

        def said() -> list[str]:
            held.seek(0)
            return [line.strip() for line in held.read().decode(errors="replace").splitlines()[:3]]

        try:
            yield said
        finally:
            os.dup2(saved, 2)
            os.close(saved)
