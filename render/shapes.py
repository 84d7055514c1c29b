"""Lines and dots as triangles, by Taichi kernels: a mesh has many of them."""

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array
from .runtime import Doubles2, Doubles3, Floats3, Floats4, ensure_runtime, ti

TRIANGLES_A_LINE = 2
LARGE_DOT = 2.5  # [px] radius above which a hexagon no longer looks round


def _fan(corners: int) -> Array:
    """A regular polygon of radius 1 as a fan of triangles (corners - 2, 3, 2)."""
    angles = 2 * np.pi / corners * np.arange(corners)
    polygon = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.stack([polygon[[0, k, k + 1]] for k in range(1, corners - 1)])


_HEXAGON, _ROUND = _fan(6), _fan(16)


@ti.kernel
def _stroke(segments: Doubles3, half: ti.f64, cap: ti.f64, out: Floats3):
    """Two triangles (2 S, 3, 2), written to ``out``, for each segment (S, 2, 2) with half a width and caps [px]."""
    for s in range(segments.shape[0]):
        x, y = segments[s, 0, 0], segments[s, 0, 1]
        dx, dy = segments[s, 1, 0] - x, segments[s, 1, 1] - y
        length = ti.max(ti.sqrt(dx * dx + dy * dy), 1e-12)
        dx, dy = dx / length, dy / length
        sx, sy = x - cap * dx, y - cap * dy
        ex, ey = segments[s, 1, 0] + cap * dx, segments[s, 1, 1] + cap * dy
        ax, ay = -dy * half, dx * half
        out[2 * s, 0, 0], out[2 * s, 0, 1] = ti.cast(sx - ax, ti.f32), ti.cast(sy - ay, ti.f32)
        out[2 * s, 1, 0], out[2 * s, 1, 1] = ti.cast(ex - ax, ti.f32), ti.cast(ey - ay, ti.f32)
        out[2 * s, 2, 0], out[2 * s, 2, 1] = ti.cast(ex + ax, ti.f32), ti.cast(ey + ay, ti.f32)
        out[2 * s + 1, 2, 0], out[2 * s + 1, 2, 1] = ti.cast(sx + ax, ti.f32), ti.cast(sy + ay, ti.f32)
        for k in ti.static(range(2)):
            out[2 * s + 1, 0, k] = out[2 * s, 0, k]
            out[2 * s + 1, 1, k] = out[2 * s, 2, k]


@ti.kernel
def _fan_out(centres: Doubles2, fan: Doubles3, radius: ti.f64, out: Floats4):
    """Triangles (N, F, 3, 2), written to ``out``, of a polygon (F, 3, 2) of radius 1 at each dot (N, 2) [px]."""
    for n in range(centres.shape[0]):
        for t in range(fan.shape[0]):
            for j, k in ti.static(ti.ndrange(3, 2)):
                out[n, t, j, k] = ti.cast(centres[n, k] + radius * fan[t, j, k], ti.f32)


def line_triangles(segments: ArrayLike, width: float, cap: float) -> Array:
    """Triangles (2 S, 3, 2) of lines of a width along segments (S, 2, 2), with caps at both ends [px], float32."""
    given = np.ascontiguousarray(segments, np.float64)
    out = np.empty((TRIANGLES_A_LINE * len(given), 3, 2), np.float32)
    if len(given):  # Taichi does not accept empty arrays
        ensure_runtime()
        _stroke(given, width / 2, cap, out)
    return out


def triangles_in_dot(radius: float) -> int:
    """Number of triangles of a dot of a radius [px]."""
    return len(_polygon(radius))


def _polygon(radius: float) -> Array:
    return _HEXAGON if radius <= LARGE_DOT else _ROUND


def dot_triangles(centres: ArrayLike, radius: float) -> Array:
    """Triangles (F N, 3, 2) of dots (N, 2) of a radius [px], float32, F of `triangles_in_dot`."""
    given = np.ascontiguousarray(centres, np.float64)
    fan = _polygon(radius)
    out = np.empty((len(given), len(fan), 3, 2), np.float32)
    if len(given):
        ensure_runtime()
        _fan_out(given, fan, radius, out)
    return out.reshape(-1, 3, 2)
