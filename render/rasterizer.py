"""Paint a drawing with Taichi kernels, without a graphics driver.

Vertices snap to a grid of 1/256 sample, as on graphics hardware, so that the edge functions are exact
integers and neighbouring triangles leave no gap. Every sample keeps the highest index of the triangles
that cover it, which is painter's order whatever the order of the threads.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .arrays import Array
from .runtime import ensure_runtime, ti

SAMPLES = 2  # a side: 2x2 samples a pixel
_SUBGRID = 256
# Largest magnitude of a vertex in samples: products of differences then stay far inside 64 bits.
_FARTHEST = 1 << 20


@ti.kernel
def _clear(owner: ti.types.ndarray(dtype=ti.i32, ndim=2)):
    for y, x in ti.ndrange(owner.shape[0], owner.shape[1]):
        owner[y, x] = -1


@ti.func
def _edge(ax: ti.i64, ay: ti.i64, bx: ti.i64, by: ti.i64, x: ti.i64, y: ti.i64) -> ti.i64:
    """Twice the signed area of (a, b, p), in squared grid units."""
    return (bx - ax) * (y - ay) - (by - ay) * (x - ax)


@ti.kernel
def _cover(corners: ti.types.ndarray(dtype=ti.i32, ndim=2), owner: ti.types.ndarray(dtype=ti.i32, ndim=2)):
    """Write the number of the last triangle that covers each sample.

    Args:
        corners: (T, 6) x0 y0 x1 y1 x2 y2 on the sub-sample grid.
        owner: (rows, columns) of samples, -1 at first.
    """
    for t in range(corners.shape[0]):
        ax, ay = ti.i64(corners[t, 0]), ti.i64(corners[t, 1])
        bx, by = ti.i64(corners[t, 2]), ti.i64(corners[t, 3])
        cx, cy = ti.i64(corners[t, 4]), ti.i64(corners[t, 5])
        area = _edge(ax, ay, bx, by, cx, cy)
        if area < 0:  # one orientation for both windings
            bx, cx = cx, bx
            by, cy = cy, by
        if area != 0:
            # Sample k has its centre at 256 k + 128.
            first_x = ti.max(0, ti.i32((ti.min(ax, bx, cx) + 127) >> 8))
            first_y = ti.max(0, ti.i32((ti.min(ay, by, cy) + 127) >> 8))
            last_x = ti.min(owner.shape[1] - 1, ti.i32((ti.max(ax, bx, cx) - 128) >> 8))
            last_y = ti.min(owner.shape[0] - 1, ti.i32((ti.max(ay, by, cy) - 128) >> 8))
            for y in range(first_y, last_y + 1):
                py = ti.i64(y) * 256 + 128
                px = ti.i64(first_x) * 256 + 128
                u = _edge(ax, ay, bx, by, px, py)
                v = _edge(bx, by, cx, cy, px, py)
                w = _edge(cx, cy, ax, ay, px, py)
                for x in range(first_x, last_x + 1):
                    if u >= 0 and v >= 0 and w >= 0:
                        ti.atomic_max(owner[y, x], t)
                    u -= (by - ay) * 256
                    v -= (cy - by) * 256
                    w -= (ay - cy) * 256


@ti.func
def _colour(
    t: ti.i32,
    x: ti.f32,
    y: ti.f32,
    vertices: ti.template(),
    colours: ti.template(),
) -> ti.types.vector(3, ti.f32):
    """Colour of triangle t at the point (x, y) [px], linear between its vertices."""
    ax, ay = vertices[t, 0, 0], vertices[t, 0, 1]
    bx, by = vertices[t, 1, 0] - ax, vertices[t, 1, 1] - ay
    cx, cy = vertices[t, 2, 0] - ax, vertices[t, 2, 1] - ay
    area = bx * cy - by * cx
    v = ti.cast(0, ti.f32)
    w = ti.cast(0, ti.f32)
    if area != 0:
        v = ti.cast(ti.math.clamp(((x - ax) * cy - (y - ay) * cx) / area, 0, 1), ti.f32)
        w = ti.cast(ti.math.clamp((bx * (y - ay) - by * (x - ax)) / area, 0, 1 - v), ti.f32)
    out = ti.Vector([colours[t, 0, 0], colours[t, 0, 1], colours[t, 0, 2]])
    for k in ti.static(range(3)):
        out[k] += v * (colours[t, 1, k] - colours[t, 0, k]) + w * (colours[t, 2, k] - colours[t, 0, k])
    return out


@ti.kernel
def _resolve(
    vertices: ti.types.ndarray(dtype=ti.f32, ndim=3),
    colours: ti.types.ndarray(dtype=ti.f32, ndim=3),
    owner: ti.types.ndarray(dtype=ti.i32, ndim=2),
    red: ti.f32,
    green: ti.f32,
    blue: ti.f32,
    image: ti.types.ndarray(dtype=ti.u8, ndim=3),
):
    """Mean colour of the samples of every pixel.

    Args:
        vertices: (T, 3, 2) [px].
        colours: (T, 3, 3) of the vertices.
        owner: (rows, columns) triangle of each sample, -1 for the background.
        red: of the background.
        green: of the background.
        blue: of the background.
        image: (H, W, 3), written.
    """
    for row, column in ti.ndrange(image.shape[0], image.shape[1]):
        total = ti.Vector([ti.cast(0, ti.f32), ti.cast(0, ti.f32), ti.cast(0, ti.f32)])
        for j, i in ti.static(ti.ndrange(SAMPLES, SAMPLES)):
            t = owner[row * SAMPLES + j, column * SAMPLES + i]
            if t < 0:
                total += ti.Vector([red, green, blue])
            else:
                x = ti.cast(column, ti.f32) + ti.cast((i + 0.5) / SAMPLES, ti.f32)
                y = ti.cast(row, ti.f32) + ti.cast((j + 0.5) / SAMPLES, ti.f32)
                total += _colour(t, x, y, vertices, colours)
        for k in ti.static(range(3)):
            level = ti.cast(total[k] * 255 / (SAMPLES * SAMPLES) + 0.5, ti.i32)
            image[row, column, k] = ti.cast(ti.math.clamp(level, 0, 255), ti.u8)


class Rasterizer:
    """Paints drawings of one size.

    Args:
        size: (width, height) [px].
    """

    name = "raster"

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = size
        self._owner: Any = None
        self._program: Any = None

    def paint(self, vertices: Array, colours: Array, background: Sequence[float]) -> Array:
        """Paint triangles.

        Args:
            vertices: (T, 3, 2) [px].
            colours: (T, 3, 3) of the vertices, in [0, 1].
            background: (3,) colour in [0, 1].

        Returns:
            (H, W, 3) uint8.
        """
        width, height = self.size
        program = ensure_runtime()
        if self._program is not program:
            self._owner = ti.ndarray(ti.i32, shape=(height * SAMPLES, width * SAMPLES))
            self._program = program
        _clear(self._owner)
        if len(vertices) == 0:  # Taichi does not accept empty arrays; this triangle has no area
            vertices, colours = np.zeros((1, 3, 2), np.float32), np.zeros((1, 3, 3), np.float32)
        snapped = np.clip(vertices * np.float32(SAMPLES), -_FARTHEST, _FARTHEST) * np.float32(_SUBGRID)
        _cover(np.rint(snapped).astype(np.int32).reshape(-1, 6), self._owner)
        image = np.empty((height, width, 3), np.uint8)
        _resolve(
            np.ascontiguousarray(vertices), np.ascontiguousarray(colours), self._owner, *map(float, background), image
        )
        return image

    def close(self) -> None:
        """Free the sample buffer."""
        self._owner = self._program = None
