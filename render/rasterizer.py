"""Paint a drawing with Taichi kernels, without a graphics driver.

Vertices snap to a grid of 1/256 sample, as on graphics hardware, so that the edge functions are exact integers and
neighbouring triangles leave no gap. The picture is painted in bands of rows, one thread a band: a band's triangles are
known beforehand and are painted in their order, and its samples stay in the processor's cache until they are shaded.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .arrays import Array
from .drawing import Drawing
from .runtime import Bytes3, Floats1, Floats2, Floats3, Ints1, Ints2, ensure_runtime, ti

SAMPLES = (1, 2)  # a side of a pixel, allowed numbers
BAND = 8  # rows of pixels in a band
# Columns (T, SNAPPED) of triangles on the grid of samples, see `set_up`: from `BOX` on what each can cover.
BOX, SNAPPED = 6, 10
# In triangles at most so many samples wide every sample is tried: that takes less than finding those between the edges.
_NARROW = 8
# Largest magnitude of a vertex in samples: products of differences then stay far inside 64 bits.
_FARTHEST = float(1 << 20)


@ti.func
def snap(value: ti.f32, samples: ti.i32) -> ti.i32:
    """A coordinate [px] on the grid of 1/256 sample; halves go to the even number."""
    scaled = ti.math.clamp(ti.cast(value, ti.f64) * samples, -_FARTHEST, _FARTHEST) * 256
    down = ti.floor(scaled + 0.5, ti.f64)
    if down - scaled == 0.5 and down / 2 != ti.floor(down / 2, ti.f64):
        down -= 1
    return ti.cast(down, ti.i32)


@ti.kernel
def set_up(vertices: Floats3, samples: ti.i32, columns: ti.i32, rows: ti.i32, snapped: Ints2):
    """Snap triangles (T, 3, 2) [px] to the grid of samples and find the samples that each can cover.

    Written are the corners x0 y0 x1 y1 x2 y2 on the grid, of positive orientation, and from `BOX` on: first and last
    column, first and last row of samples; the last row is below the first one for triangles that cover nothing.
    """
    for t in range(vertices.shape[0]):
        ax, ay = snap(vertices[t, 0, 0], samples), snap(vertices[t, 0, 1], samples)
        bx, by = snap(vertices[t, 1, 0], samples), snap(vertices[t, 1, 1], samples)
        cx, cy = snap(vertices[t, 2, 0], samples), snap(vertices[t, 2, 1], samples)
        area = ti.i64(bx - ax) * ti.i64(cy - ay) - ti.i64(by - ay) * ti.i64(cx - ax)
        if area < 0:  # one orientation for both windings
            bx, cx = cx, bx
            by, cy = cy, by
        snapped[t, 0], snapped[t, 1] = ax, ay
        snapped[t, 2], snapped[t, 3] = bx, by
        snapped[t, 4], snapped[t, 5] = cx, cy
        # Sample k has its centre at 256 k + 128.
        first_x, last_x = (ti.min(ax, bx, cx) + 127) >> 8, (ti.max(ax, bx, cx) - 128) >> 8
        first_y, last_y = (ti.min(ay, by, cy) + 127) >> 8, (ti.max(ay, by, cy) - 128) >> 8
        if area == 0 or first_x >= columns or last_x < 0 or first_x > last_x:
            last_y = first_y - 1
        snapped[t, BOX], snapped[t, BOX + 1] = ti.max(0, first_x), ti.min(columns - 1, last_x)
        snapped[t, BOX + 2], snapped[t, BOX + 3] = ti.max(0, first_y), ti.min(rows - 1, last_y)


@ti.kernel
def count_bands(snapped: Ints2, tall: ti.i32, start: Ints1, extent: Ints2):
    """Count the triangles of every band ``tall`` rows high, and find the columns that they touch.

    Of ``start`` (B + 1,), zeros, entry b is the number of triangles in bands 0 to b - 1; ``extent`` (B, 2) has the
    first and last column touched, the number of columns and -1 at first.
    """
    ti.loop_config(serialize=True)
    for t in range(snapped.shape[0]):
        if snapped[t, BOX + 2] <= snapped[t, BOX + 3]:
            for b in range(snapped[t, BOX + 2] // tall, snapped[t, BOX + 3] // tall + 1):
                start[b + 1] += 1
                extent[b, 0] = ti.min(extent[b, 0], snapped[t, BOX])
                extent[b, 1] = ti.max(extent[b, 1], snapped[t, BOX + 1])
    ti.loop_config(serialize=True)
    for b in range(extent.shape[0]):
        start[b + 1] += start[b]


@ti.kernel
def fill_bands(snapped: Ints2, tall: ti.i32, place: Ints1, listed: Ints1):
    """List the triangles of every band ``tall`` rows high in painter's order, from ``place`` (B + 1,), changed, on."""
    ti.loop_config(serialize=True)
    for t in range(snapped.shape[0]):
        if snapped[t, BOX + 2] <= snapped[t, BOX + 3]:
            for b in range(snapped[t, BOX + 2] // tall, snapped[t, BOX + 3] // tall + 1):
                listed[place[b]] = t
                place[b] += 1


@ti.func
def _crossing(ax: ti.i32, ay: ti.i32, bx: ti.i32, inverse: ti.f64, py: ti.i32) -> ti.i32:
    """Column of samples at or just left of the edge from a to b in the row at py; inverse is 1 / (by - ay)."""
    x = ti.cast(ax, ti.f64) + ti.cast(bx - ax, ti.f64) * ti.cast(py - ay, ti.f64) * inverse
    # Far outside the picture the number of a column would not fit.
    return ti.cast(ti.math.clamp(ti.floor((x - 128) / 256, ti.f64), -2, 1 << 24), ti.i32)


@ti.func
def _cover(t, first, last, snapped: ti.template(), owner: ti.template()):
    """Write t to the samples that triangle t covers in the rows first to last."""
    ax, ay = snapped[t, 0], snapped[t, 1]
    bx, by = snapped[t, 2], snapped[t, 3]
    cx, cy = snapped[t, 4], snapped[t, 5]
    wide = snapped[t, BOX + 1] - snapped[t, BOX] >= _NARROW
    ab, bc, ca = ti.cast(0, ti.f64), ti.cast(0, ti.f64), ti.cast(0, ti.f64)
    if wide:
        one = ti.cast(1, ti.f64)
        ab, bc, ca = one / ti.cast(by - ay, ti.f64), one / ti.cast(cy - by, ti.f64), one / ti.cast(ay - cy, ti.f64)
    du, dv, dw = ti.i64(by - ay) * 256, ti.i64(cy - by) * 256, ti.i64(ay - cy) * 256
    for y in range(ti.max(first, snapped[t, BOX + 2]), ti.min(last, snapped[t, BOX + 3]) + 1):
        py = y * 256 + 128
        x, end = snapped[t, BOX], snapped[t, BOX + 1]
        if wide:
            # The columns between the edges, to within one on either side; the edge functions decide exactly.
            if ay < by:
                end = ti.min(end, _crossing(ax, ay, bx, ab, py) + 1)
            elif ay > by:
                x = ti.max(x, _crossing(ax, ay, bx, ab, py))
            if by < cy:
                end = ti.min(end, _crossing(bx, by, cx, bc, py) + 1)
            elif by > cy:
                x = ti.max(x, _crossing(bx, by, cx, bc, py))
            if cy < ay:
                end = ti.min(end, _crossing(cx, cy, ax, ca, py) + 1)
            elif cy > ay:
                x = ti.max(x, _crossing(cx, cy, ax, ca, py))
        px = x * 256 + 128
        u = ti.i64(bx - ax) * ti.i64(py - ay) - ti.i64(by - ay) * ti.i64(px - ax)
        v = ti.i64(cx - bx) * ti.i64(py - by) - ti.i64(cy - by) * ti.i64(px - bx)
        w = ti.i64(ax - cx) * ti.i64(py - cy) - ti.i64(ay - cy) * ti.i64(px - cx)
        while x <= end:
            if (u | v | w) >= 0:
                owner[y, x] = t
            u -= du
            v -= dv
            w -= dw
            x += 1


@ti.func
def _graded_corners(t: ti.i32, s: ti.i32, vertices: ti.template(), graded: ti.template()):
    """Geometry and colours of triangle t for `_graded_colour`; its colours are in row s of graded."""
    ax, ay = vertices[t, 0, 0], vertices[t, 0, 1]
    sides = ti.Vector([vertices[t, 1, 0] - ax, vertices[t, 1, 1] - ay, vertices[t, 2, 0] - ax, vertices[t, 2, 1] - ay])
    first = ti.Vector([graded[s, 0, 0], graded[s, 0, 1], graded[s, 0, 2]])
    second = ti.Vector([graded[s, 1, 0], graded[s, 1, 1], graded[s, 1, 2]]) - first
    third = ti.Vector([graded[s, 2, 0], graded[s, 2, 1], graded[s, 2, 2]]) - first
    return ti.Vector([ax, ay]), sides, first, second, third


@ti.func
def _graded_colour(x: ti.f32, y: ti.f32, corner, sides, first, second, third) -> ti.types.vector(3, ti.f32):
    """Colour at the point (x, y) [px], linear between the vertices; the rest is what `_graded_corners` returns."""
    dx, dy = x - corner[0], y - corner[1]
    area = sides[0] * sides[3] - sides[1] * sides[2]
    v = ti.cast(0, ti.f32)
    w = ti.cast(0, ti.f32)
    if area != 0:
        v = ti.cast(ti.math.clamp((dx * sides[3] - dy * sides[2]) / area, 0, 1), ti.f32)
        w = ti.cast(ti.math.clamp((sides[0] * dy - sides[1] * dx) / area, 0, 1 - v), ti.f32)
    return first + (v * second + w * third)


@ti.func
def _shade(
    t: ti.i32,
    x: ti.f32,
    y: ti.f32,
    vertices: ti.template(),
    flat: ti.template(),
    slot: ti.template(),
    graded: ti.template(),
) -> ti.types.vector(3, ti.f32):
    """Colour of triangle t at the point (x, y) [px], linear between its vertices."""
    out = ti.Vector([flat[t, 0], flat[t, 1], flat[t, 2]])
    s = slot[t]
    if s >= 0:
        corner, sides, first, second, third = _graded_corners(t, s, vertices, graded)
        out = _graded_colour(x, y, corner, sides, first, second, third)
    return out


@ti.func
def _level(value: ti.f32) -> ti.u8:
    """A colour in [0, 1] as a number from 0 to 255."""
    return ti.cast(ti.math.clamp(ti.cast(value * 255 + 0.5, ti.i32), 0, 255), ti.u8)


@ti.kernel
def _paint(
    samples: ti.template(),
    snapped: Ints2,
    start: Ints1,
    listed: Ints1,
    extent: Ints2,
    vertices: Floats3,
    flat: Floats2,
    slot: Ints1,
    graded: Floats3,
    ground: Floats1,
    owner: Ints2,
    image: Bytes3,
):
    """Paint all bands: the triangle of each sample, then the mean colour of the samples of each pixel.

    Args are of `set_up`, `count_bands`, `fill_bands` and `Drawing.compact`; ``ground`` (3,) is the background, which
    ``image`` (H, W, 3) has at first; ``owner`` (rows, columns) of samples is working space.
    """
    ti.loop_config(block_dim=1)
    for b in range(extent.shape[0]):
        top = b * BAND
        bottom = ti.min(top + BAND, image.shape[0])
        left, right = extent[b, 0] // samples, extent[b, 1] // samples + 1
        if extent[b, 1] >= 0:
            for y in range(top * samples, bottom * samples):
                for x in range(left * samples, right * samples):
                    owner[y, x] = -1
            for k in range(start[b], start[b + 1]):
                _cover(listed[k], top * samples, bottom * samples - 1, snapped, owner)
            background = ti.Vector([ground[0], ground[1], ground[2]])
            for row in range(top, bottom):
                # Of the triangle of the pixel before, which is that of this one more often than not.
                known, s = -2, -1
                colour = background
                corner, sides = ti.Vector.zero(ti.f32, 2), ti.Vector.zero(ti.f32, 4)
                first, second, third = background, background, background
                for column in range(left, right):
                    t = owner[row * samples, column * samples]
                    same = 1
                    for j, i in ti.static(ti.ndrange(samples, samples)):
                        if owner[row * samples + j, column * samples + i] != t:
                            same = 0
                    if same == 0:
                        known = -2
                        total = ti.Vector([ti.cast(0, ti.f32), ti.cast(0, ti.f32), ti.cast(0, ti.f32)])
                        for j in range(samples):
                            for i in range(samples):
                                o = owner[row * samples + j, column * samples + i]
                                if o < 0:
                                    total += background
                                else:
                                    x = ti.cast(column, ti.f32) + (ti.cast(i, ti.f32) + 0.5) / samples
                                    y = ti.cast(row, ti.f32) + (ti.cast(j, ti.f32) + 0.5) / samples
                                    total += _shade(o, x, y, vertices, flat, slot, graded)
                        colour = total / (samples * samples)
                    elif t != known:
                        known, s = t, -1
                        colour = background
                        if t >= 0:
                            s = slot[t]
                            colour = ti.Vector([flat[t, 0], flat[t, 1], flat[t, 2]])
                            if s >= 0:
                                corner, sides, first, second, third = _graded_corners(t, s, vertices, graded)
                    if same == 1 and s >= 0:  # the mean of a linear colour is that of the centre
                        x, y = ti.cast(column, ti.f32) + 0.5, ti.cast(row, ti.f32) + 0.5
                        colour = _graded_colour(x, y, corner, sides, first, second, third)
                    for k in ti.static(range(3)):
                        image[row, column, k] = _level(colour[k])


@ti.kernel
def _own(snapped: Ints2, owner: Ints2):
    """Write the last triangle that covers a sample of ``owner``, -1 at first."""
    ti.loop_config(serialize=True)
    for t in range(snapped.shape[0]):
        if snapped[t, BOX + 2] <= snapped[t, BOX + 3]:
            _cover(t, 0, owner.shape[0] - 1, snapped, owner)


def in_bands(vertices: Array, samples: int, width: int, height: int) -> tuple[Array, Array, Array, Array]:
    """Results of `set_up`, `count_bands`, `fill_bands` for triangles (T, 3, 2) in a picture of width, height [px]."""
    snapped, bands = np.empty((len(vertices), SNAPPED), np.int32), -(-height // BAND)
    set_up(vertices, samples, width * samples, height * samples, snapped)
    start, extent = np.zeros(bands + 1, np.int32), np.tile(np.array([width * samples, -1], np.int32), (bands, 1))
    count_bands(snapped, BAND * samples, start, extent)
    listed = np.empty(max(int(start[-1]), 1), np.int32)
    fill_bands(snapped, BAND * samples, start.copy(), listed)
    return snapped, start, listed, extent


def locate(vertices: Array, shape: tuple[int, int]) -> Array:
    """The triangle (rows, columns) at the centre of each square of a grid, int32; -1 where there is none.

    ``vertices`` (T, 3, 2) are in squares of the grid, x to the right, y with the rows.
    """
    ensure_runtime()
    owner = np.full(shape, -1, np.int32)
    if len(vertices):  # Taichi does not accept empty arrays
        snapped = np.empty((len(vertices), SNAPPED), np.int32)
        set_up(np.ascontiguousarray(vertices, np.float32), 1, shape[1], shape[0], snapped)
        _own(snapped, owner)
    return owner


class Rasterizer:
    """Paints drawings of one size (width, height) [px], with 1 or 2 samples along a side of a pixel.

    With 2 edges are smooth, with 1 a picture takes about half the time; `ValueError` for others.
    """

    name = "raster"

    def __init__(self, size: tuple[int, int], samples: int = 2) -> None:
        if samples not in SAMPLES:
            raise ValueError(f"samples {samples!r}: expected 1 or 2, the samples along a side of a pixel")
        self.size = size
        self.samples = samples
        self._owner: Any = None
        self._program: Any = None

    def paint(self, drawing: Drawing, background: Sequence[float]) -> Array:
        """Paint a drawing, (H, W, 3) uint8, on a background (3,) in [0, 1]."""
        width, height = self.size
        samples = self.samples
        program = ensure_runtime()
        if self._program is not program:
            self._owner = ti.ndarray(ti.i32, shape=(height * samples, width * samples))
            self._program = program
        levels = (np.asarray(background, np.float32) * 255 + 0.5).astype(np.uint8)
        image = np.empty((height, width, 3), np.uint8)
        image[0] = levels
        image[1:] = image[0]  # whole rows are copied faster than pixels
        vertices, *looks = drawing.compact()
        if len(vertices) == 0:  # Taichi does not accept empty arrays
            return image
        snapped, start, listed, extent = in_bands(vertices, samples, width, height)
        ground = np.array(background, np.float32)
        _paint(samples, snapped, start, listed, extent, vertices, *looks, ground, self._owner, image)
        return image

    def close(self) -> None:
        """Free the sample buffer."""
        self._owner = self._program = None
