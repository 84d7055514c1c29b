"""Outlines, cells and pictures as bytes, for pages: page/outlines.js and page/cells.js read the first two."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from PIL import Image
from tipfem.render import Scene
from tipfem.render.colours import DARK, LIGHT, fluid_colours, hex_code, shades
from tipfem.render.outlines import Loop

from tipfem.typing import Array

FINE = 0.01  # of a spacing: places are that exact


def turned(values: Array, kind: str) -> bytes:
    """Whole numbers 0, -1, 1, -2, ... of each row as 0, 1, 2, 3, ..., the lowest bytes first: small ones compress well.

    ``kind`` is that of signed whole numbers, "<i2" or "<i4", in which larger ones wrap around.
    """
    signed = values.astype(kind)
    folded = (signed << 1) ^ (signed >> (8 * signed.itemsize - 1))
    return bytes(np.ascontiguousarray(folded)[..., None].view(np.uint8).swapaxes(-1, -2).tobytes())


def from_lowest(triangles: Array) -> Array:
    """Triangles (M, 3) turned so that the first corner has the lowest number."""
    first = triangles.argmin(axis=1)
    return np.take_along_axis(triangles, (first[:, None] + np.arange(3)) % 3, axis=1)


def steps_of(triangles: Array) -> Array:
    """From the first corner of each triangle (M, 3) to that of the next, and from it to its own others: (3, M)."""
    first = triangles[:, 0]
    return np.stack([np.diff(first, prepend=0), triangles[:, 1] - first, triangles[:, 2] - first])


def packed(loops: Sequence[Loop], lower: Array, scale: Array, wide: bool = False) -> bytes:
    """Loops of a layer: their number; of each the number of points, x and y, and fixed points as bits.

    Places are told by their second differences, see `turned`, in numbers of 16 bits or, if ``wide``, 32; number 0 is at
    ``lower`` (2,), the next ``scale`` (2,) on [m]. `ValueError` if a loop has more points than can be counted so.
    """
    kind, signed, most = ("<u4", "<i4", 2**32 - 1) if wide else ("<u2", "<i2", 65_535)
    parts = [np.array(len(loops), kind).tobytes()]
    for points, fixed in loops:
        if max(len(points), len(loops)) > most:
            raise ValueError(f"an outline has {len(points)} points; at most {most} can be shared")
        places = np.clip(np.rint((points - lower) / scale), 0, most).astype(np.int64)
        second = np.diff(np.diff(places, axis=0, prepend=0), axis=0, prepend=0).T
        parts += [np.array(len(points), kind).tobytes(), turned(second, signed), np.packbits(fixed).tobytes()]
    return b"".join(parts)


def packed_cells(scene: Scene, field: str | None, plain: Array) -> tuple[dict[str, Any], bytes]:
    """The cells of a scene, and the values of a field that colour them, but for ``plain`` (M,); see page/cells.js.

    Returns:
        What the page needs to read the bytes: numbers of nodes and of particles in no cell, the place that the others
        are relative to and the ``step`` [m] of their numbers of 16 bits, None for floats where these would be too
        coarse; the lowest value and the ``span`` up to the highest, 65535; the fluid of each group of cells or -1 for
        the field; and the bytes.

    Raises:
        ValueError: the field is not there, or not finite.
    """
    group = np.full(len(scene.cells), -1)
    if scene.cell_fluid is not None:
        group = np.where(plain, scene.cell_fluid, -1)
    corners = from_lowest(scene.cells)
    wide = len(scene.position) > 65_535
    order = np.argsort(corners[:, 0].astype(np.uint32 if wide else np.uint16), kind="stable")  # two bytes sort fastest
    order = order[np.argsort(group[order].astype(np.int16), kind="stable")]
    by_cell = field in scene.cell_fields
    values = np.empty(0) if field is None else scene.field_values(field)
    if by_cell and field is not None:
        values = scene.cell_values(field)[order]
    low, span = (float(values.min()), float(np.ptp(values))) if len(values) else (0.0, 0.0)
    levels = np.rint((values - low) * (65_535 / (span or 1.0)))
    lower, upper = (np.array([end(axis) for axis in scene.position.T]) for end in (np.min, np.max))  # faster by axis
    step = np.maximum(upper - lower, 1e-12) / 65_535
    whole = bool(step.max() < FINE * scene.spacing)
    places = scene.position - lower
    if whole:
        moves = turned(np.diff(np.rint(places / step).astype(np.int64), axis=0, prepend=0).T, "<i2")
    else:
        moves = places.astype("<f4").tobytes()
    loose = np.flatnonzero(scene.geometry.loose[0]).astype("<u4")
    kinds, counts = np.unique(group, return_counts=True)
    head: dict[str, Any] = dict(nodes=len(scene.position), loose=len(loose), by_cell=by_cell, wide=wide)
    head |= dict(origin=lower.tolist(), step=step.tolist() if whole else None, low=low, span=span)
    head["parts"] = np.stack([counts, kinds], axis=1).tolist()
    cells = turned(steps_of(corners[order]), "<i4" if wide else "<i2")
    rises = turned(np.diff(levels.astype(np.int64), prepend=0), "<i2")
    return head, loose.tobytes() + moves + cells + rises


def packed_lines(given: Sequence[tuple[str, str, str, Any]], lower: Array) -> tuple[dict[str, Any], bytes]:
    """Lines over the fluids: their kind, colour, that of their rim, and points (K, 2) of each [m].

    Beside places relative to ``lower`` (2,) [m], as floats of 32 bits, what the page needs to read them: of each sort
    ``count`` lines of ``each`` points, or ``points`` of each line.
    """
    heads, parts = [], []
    for kind, line, rim, paths in given:
        head: dict[str, Any] = {"kind": kind, "line": line, "rim": rim}
        if isinstance(paths, np.ndarray):
            head |= {"count": paths.shape[0], "each": paths.shape[1]}
        else:
            head["points"] = [len(path) for path in paths]
            paths = np.concatenate([np.empty((0, 2)), *paths])
        heads.append(head)
        parts.append((paths - lower).astype("<f4").tobytes())
    data = b"".join(parts)
    return {"origin": lower.tolist(), "bytes": len(data), "sorts": heads}, data


def webp(image: Array, quality: int) -> bytes:
    """A picture as WebP of a quality from 0 to 100; image is (H, W, 3), or (H, W, 4) with opacity, uint8."""
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "webp", quality=quality, method=6)
    return buffer.getvalue()


def png(image: Array) -> bytes:
    """A picture as PNG; image is (H, W, 3) uint8."""
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "png", compress_level=4)
    return buffer.getvalue()


def fluid_looks(names: Sequence[str], densities: Sequence[float] | None) -> list[dict[str, Any]]:
    """Names of fluids, and for light and for dark pages their colours at the top, at the bottom and on the average."""
    fills = fluid_colours(names, densities)
    told: list[dict[str, Any]] = [{"name": name} for name in names]
    for theme, scheme in (("light", LIGHT), ("dark", DARK)):
        for fluid, ends in zip(told, shades(fills, scheme), strict=True):
            fluid[theme] = [hex_code(colour) for colour in (*ends, ends.mean(axis=0))]
    return told
