"""The words and scales around a picture: none lies over another, whatever the shape of the tank."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from PIL import ImageDraw
from tipfem.render import Scene, View, annotation
from tipfem.render.colours import LIGHT, fluid_colours
from tipfem.render.layers import Key
from tipfem.render.layout import make_layout
from tipfem.render.renderer import contents, natural_size, settled, swatches_of

SHAPES = [
    (1, 1),
    (2, 1),
    (3, 1),
    (5, 1),
    (8, 1),
    (20, 1),
    (1, 1.2),
    (1, 2),
    (1, 3),
    (1, 8),
    (4, 3),
    (16, 9),
    (0.02, 0.03),
]
SIZES = [None, (1080, 1080), (720, 1280), (480, 360)]
FLUIDS = [("water",), ("water", "air"), ("water", "sunflower oil", "air")]


def scene_of(shape, fluids):
    """A scene of a tank of a shape, of few particles."""
    at = np.random.default_rng(3).uniform(0, 1, (40, 2)) * shape
    fields = {"speed": np.linspace(0, 3, 40), "density": np.linspace(1, 1000, 40), "velocity_x": at[:, 0]}
    fluid = np.arange(40) % len(fluids)
    velocity = {"velocity_y": at[:, 1]}
    return Scene(
        position=at,
        cells=[],
        fluid=fluid,
        fluid_names=fluids,
        fields=fields | velocity,
        upper=shape,
        lower=(0, 0),
        title="A tank",
    )


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_no_text_or_scale_lies_over_another(shape, size, monkeypatch):
    """Time, lapse, ticks, legend, colour bar and its ticks, with one to three fluids, with and without a field."""
    boxes: list[tuple[str, tuple[float, ...]]] = []
    write, bar, clock = ImageDraw.ImageDraw.text, annotation.Annotator.bar, annotation.clock

    def write_noted(self, xy, text, fill=None, font=None, anchor=None, **more):
        if self.im.size == layout.size:
            boxes.append((text, self.textbbox(xy, text, font=font, anchor=anchor)))
        write(self, xy, text, fill=fill, font=font, anchor=anchor, **more)

    def clock_noted(image, scene, layout, scheme):
        blank = np.zeros_like(image)
        clock(blank, scene, layout, scheme)
        y, x = np.nonzero(blank.any(axis=2))
        boxes.append(("clock", (x.min(), y.min(), x.max(), y.max())))

    monkeypatch.setattr(ImageDraw.ImageDraw, "text", write_noted)
    monkeypatch.setattr(
        annotation.Annotator,
        "bar",
        lambda self, box, *more, **how: boxes.append(("bar", box)) or bar(self, box, *more, **how),
    )
    monkeypatch.setattr(annotation, "clock", clock_noted)
    keys = [Key("interface", "#000000", "#ffffff"), Key("paths of tracers", "#000000", "#ffffff")]
    for fluids in FLUIDS:
        for field in (None, "speed", "density"):
            scene = scene_of(shape, fluids)
            view, ends = settled(View(streamlines=True, smooth=False), [scene], field, None)
            lower, upper, title, width, entries, coloured = contents(scene, field, view)
            width = max([width, *(annotation.text_width(key.text, annotation.NORMAL) + 42 for key in keys)])
            entries = entries[: -1 - (field is not None and len(fluids) > 1)] + [
                annotation.entry_width(key.text) for key in keys
            ]
            layout = make_layout(
                size or natural_size(scene, field, view), lower, upper, title, width, entries, coloured
            )
            fills = fluid_colours(fluids)
            image = np.zeros((layout.size[1], layout.size[0], 3), np.uint8)
            annotation._constant_pixels.cache_clear()
            boxes.clear()
            swatches = tuple(swatches_of(scene, field, view, fills, LIGHT))
            legend = annotation.Legend(swatches, field, ends, None, tuple(keys), "12 times slower")
            annotation.annotate(image, scene, layout, legend)
            assert len(boxes) > 8
            for (one, a), (other, b) in combinations(boxes, 2):
                apart = a[2] <= b[0] + 1 or b[2] <= a[0] + 1 or a[3] <= b[1] + 1 or b[3] <= a[1] + 1
                assert apart, f"{one} {a} over {other} {b}: {fluids}, {field}, {layout.size}"
            (wide, high), beyond = layout.size, []
            beyond = [(text, b) for text, b in boxes if b[0] < -1 or b[2] > wide + 1 or b[3] > high + 1]
            assert beyond == [], (fluids, field, layout)
