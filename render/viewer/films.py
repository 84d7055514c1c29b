"""Fields over time as small grey pictures, which page/film.js colours, blends and reads values from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt
from tipfem.render import Results, Scene, View
from tipfem.render.colours import COLOUR_MAPS
from tipfem.render.drawing import Drawing
from tipfem.render.layout import Layout
from tipfem.render.outlines import SPRAY_RADIUS
from tipfem.render.renderer import make_canvas, settled
from tipfem.render.scales import colour_map_of
from tipfem.render.viewer.packing import webp

from tipfem.results.fields.catalogue import field_of
from tipfem.typing import Array

MOST_PIXELS = 256  # of the longer side
PIXELS = 2  # to a spacing, if they are not more than that
QUALITY = 80  # of WebP: values within about 1 % of the range of their time


class Camera:
    """Takes grey pictures of fields in a box.

    Args:
        lower: (2,) corner of the box [m].
        upper: (2,) the other corner [m].
        spacing: of the particles [m].
    """

    def __init__(self, lower: Array, upper: Array, spacing: float) -> None:
        pixel = max(float((upper - lower).max()) / MOST_PIXELS, spacing / PIXELS)
        lower, upper = lower - pixel, upper + pixel  # between the middles of pixels lies all that is seen
        size = upper - lower
        across, up = (max(2, round(float(side) / pixel)) for side in size)
        box = (0.0, 0.0, float(across), float(up))
        self._layout = Layout((across, up), 1.0, lower, upper, across / float(size[0]), box, True, box)
        self.box = [*lower.tolist(), *upper.tolist()]
        self._canvas = make_canvas((across, up), "raster", 2)

    def picture(self, scene: Scene, field: str) -> tuple[float, float, bytes]:
        """A field at one time: its lowest and its highest value, which are black and white, and a picture as WebP.

        Pixels outside the fluids have the value of the nearest within, so that outlines may be drawn anywhere.

        Raises:
            ValueError: the field is not there, or not finite.
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
        assert scene.spacing is not None, "a Scene fills in what was left out"
        drawing.dots(pixels[loose], max(SPRAY_RADIUS * scene.spacing * self._layout.scale, 1.0), seen[loose])
        value, there = np.moveaxis(self._canvas.paint(drawing, (0.0, 0.0, 0.0))[:, :, :2].astype(float), 2, 0)
        grey = np.rint(255 * value / np.maximum(there, 1.0)).clip(0, 255).astype(np.uint8)
        if (there > 127).any():
            grey = grey[tuple(distance_transform_edt(there <= 127, return_distances=False, return_indices=True))]
        return low, high, webp(np.repeat(grey[:, :, None], 3, axis=2), QUALITY)

    def close(self) -> None:
        """Release the canvas."""
        self._canvas.close()


def films(results: Results, fields: Sequence[str]) -> tuple[list[dict[str, Any]], bytes]:
    """Fields of all stored times.

    Args:
        results: the folder.
        fields: their names.

    Returns:
        What a page needs of each field, see `told`; and the pictures, those of a field one after another.

    Raises:
        ValueError: there is no such field, or it is not finite.
    """
    if not fields:
        return [], b""
    first = results.scene(0)
    for field in fields:
        first.field_values(field)
    ends = [settled(View(), results.sampled(), field, None) for field in fields]
    assert first.spacing is not None, "a Scene fills in what was left out"
    camera = Camera(results.lower, results.upper, first.spacing)
    taken = [[camera.picture(scene, field) for field in fields] for scene in map(results.scene, range(len(results)))]
    camera.close()
    names = results.fluid_names
    told = [
        {
            "box": camera.box,
            **told_of(field, [each[k] for each in taken], limits or (0.0, 1.0), view.muted or (), names),
        }
        for k, (field, (view, limits)) in enumerate(zip(fields, ends, strict=True))
    ]
    return told, b"".join(each[k][2] for k in range(len(fields)) for each in taken)


def told_of(
    field: str,
    pictures: Iterable[tuple[float, float, bytes]],
    limits: tuple[float, float],
    muted: Sequence[str],
    fluids: Sequence[str],
) -> dict[str, Any]:
    """A field as facts of a page: its name, colours and their range, the fluids that keep theirs, and its pictures.

    Args:
        field: its name.
        pictures: see `Camera.picture`; without bytes where none was taken.
        limits: of the colours.
        muted: names of fluids.
        fluids: names of all of them.
    """
    return {
        "name": field_of(field).title,
        "low": limits[0],
        "high": limits[1],
        "stops": COLOUR_MAPS[colour_map_of(field)],
        "plain": [fluids.index(name) for name in muted],
        "pictures": [[float(f"{low:.4g}"), float(f"{high:.4g}"), len(data)] for low, high, data in pictures],
    }
