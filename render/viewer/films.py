"""Fields over time as small grey pictures, which page/film.js colours, blends and reads values from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt
from tipfem.render import Results, Scene, View
from tipfem.render.colours import COLOUR_MAPS
from tipfem.render.drawing import Drawing
from tipfem.render.layout import Layout, point
from tipfem.render.outlines import SPRAY_RADIUS
from tipfem.render.renderer import make_canvas, settled
from tipfem.render.scales import colour_map_of
from tipfem.render.viewer.packing import webp

from tipfem.results.fields.catalogue import field_of
from tipfem.typing import Array

MOST_PIXELS = 256  # of the longer side
PIXELS = 2  # to a spacing, if they are not more than that
QUALITY = 80  # of WebP: values within about 1 % of the range of their time


class Scanner:
    """Takes grey pictures of fields in a box between two corners (2,) [m]."""

    def __init__(self, lower: Array, upper: Array, spacing: float) -> None:
        pixel = max(float((upper - lower).max()) / MOST_PIXELS, spacing / PIXELS)
        lower, upper = lower - pixel, upper + pixel  # between the middles of pixels lies all that is seen
        size = upper - lower
        across, up = (max(2, round(float(side) / pixel)) for side in size)
        box = (0.0, 0.0, float(across), float(up))
        self._layout = Layout((across, up), 1.0, point(lower), point(upper), across / float(size[0]), box, True, box)
        self.box = [*lower.tolist(), *upper.tolist()]
        self._canvas = make_canvas((across, up), "raster", 1)

    def picture(self, scene: Scene, field: str) -> tuple[float, float, bytes]:
        """A field at one time: its lowest and its highest value, which are black and white, and a picture as WebP.

        Pixels outside the fluids have the value of the nearest within, so that outlines may be drawn anywhere.
        `ValueError` if the field is not there, or not finite.
        """
        values = scene.field_values(field)
        low, high = float(values.min()), float(values.max())
        seen = np.zeros((len(values), 3))
        seen[:, 0], seen[:, 1] = (values - low) / ((high - low) or 1.0), 1.0  # the value, and that there is one
        pixels, drawing = self._layout.pixels(scene.position), Drawing()
        if field in scene.cell_fields:
            cells = np.ones((len(scene.cells), 3))
            cells[:, 0] = (scene.cell_values(field) - low) / ((high - low) or 1.0)
            drawing.triangles(pixels[scene.cells], cells)
        else:
            drawing.triangles(pixels[scene.cells], seen[scene.cells])
        loose = scene.geometry.loose[0]
        drawing.dots(pixels[loose], max(SPRAY_RADIUS * scene.spacing * self._layout.scale, 1.0), seen[loose])
        value, there = np.moveaxis(self._canvas.paint(drawing, (0.0, 0.0, 0.0))[:, :, :2].astype(float), 2, 0)
        grey = np.rint(255 * value / np.maximum(there, 1.0)).clip(0, 255).astype(np.uint8)
        if (there > 127).any():
            grey = grey[tuple(distance_transform_edt(there <= 127, return_distances=False, return_indices=True))]
        return low, high, webp(np.repeat(grey[:, :, None], 3, axis=2), QUALITY)

    def close(self) -> None:
        """Release the canvas."""
        self._canvas.close()


Picture = tuple[float, float, bytes]  # see `Scanner.picture`


class Films:
    """Fields of a results folder at all times, of which pictures are taken as its scenes are read.

    Raises:
        ValueError: there is no such field, or it is not finite.
    """

    def __init__(self, results: Results, fields: Sequence[str]) -> None:
        first = results.scene(0)
        for field in fields:
            first.field_values(field)
        self._ends = {field: settled(View(), results.sampled(), field, None) for field in fields}
        self._scanner = Scanner(results.lower, results.upper, first.spacing) if fields else None
        self._names = results.fluid_names
        self._taken: dict[str, list[Picture]] = {field: [] for field in fields}

    def take(self, scene: Scene) -> None:
        """Take a picture of each field; scenes come in order of time."""
        for field, pictures in self._taken.items():
            assert self._scanner is not None, "there are fields"
            pictures.append(self._scanner.picture(scene, field))

    def told(self) -> tuple[list[dict[str, Any]], bytes]:
        """Facts of a page on each field, and the pictures, those of a field one after another; there are no more."""
        if self._scanner is None:
            return [], b""
        self._scanner.close()
        told = []
        for field, (view, ends) in self._ends.items():
            plain = [self._names.index(name) for name in view.muted or ()]
            told.append(told_of_film(field, self._scanner.box, ends or (0.0, 1.0), plain, self._taken[field]))
        return [facts for facts, _ in told], b"".join(data for _, data in told)


def told_of_film(
    field: str, box: Sequence[float], ends: tuple[float, float], plain: Sequence[int], pictures: Sequence[Picture]
) -> tuple[dict[str, Any], bytes]:
    """Facts of a page on a field in a `Scanner`'s box, and its pictures, one per time or empty, one after another.

    ``ends`` are values at the ends of the colours, ``plain`` the fluids that keep their own colours.
    """
    facts = {
        "box": box,
        "name": field_of(field).title,
        "low": ends[0],
        "high": ends[1],
        "stops": COLOUR_MAPS[colour_map_of(field)],
        "plain": plain,
        "pictures": [[float(f"{low:.4g}"), float(f"{high:.4g}"), len(data)] for low, high, data in pictures],
    }
    return facts, b"".join(data for *_, data in pictures)
