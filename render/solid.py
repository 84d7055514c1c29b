"""Pictures of flows in three dimensions: the densest fluid in a transparent tank."""

from collections.abc import Mapping
from dataclasses import fields

import numpy as np

from . import colours
from .annotation import SMALL, Annotator, clock
from .arrays import Array
from .camera import USUAL, Camera
from .drawing import Drawing
from .layout import DEFAULT, Layout, check_size
from .rasterizer import SAMPLES, Rasterizer
from .scales import round_ticks
from .surface import fluid_surface
from .view import View
from .volume import Volume
from .water import Empty, Light, Scenery, empty, look_at, scenery, shaded

EDGE_WIDTH = 1.6  # [design pixels]
CLEAR = 0.35  # of the tank's size: depth of fluid that takes about two thirds of the light
_HEAD, _FOOT, _SIDE = 56, 66, 28  # room above the tank, below it and beside it [design pixels]


def check_solid(view: View, looks: Mapping[str, object]) -> None:
    """`ValueError` for the first of a view and of options by name that is not drawn of a volume."""
    usual = View()
    kept = ("camera", "slice", "muted", "look", "smooth", "arrow_speed", "interval", "colour_map")
    asked = {one.name.replace("_", " "): getattr(view, one.name) != getattr(usual, one.name) for one in fields(View)}
    for name in kept:
        asked.pop(name.replace("_", " "), None)
    asked |= {"flat look": view.look == "flat", "outlines": view.smooth is not None}
    asked |= {name: bool(value) for name, value in looks.items()}
    if beside := [name for name, there in asked.items() if there]:
        text = f"flows in 3-D are drawn without {beside[0]}; leave it out, or choose a plane, for example slice y=0.5"
        raise ValueError(text)


class SolidRenderer:
    """Draws volumes at one size, by default 1280x720, as `tipfem.render.renderer.Renderer` draws scenes."""

    backend = "raster"

    def __init__(
        self,
        size: tuple[int, int] | None = None,
        fluid_colours: Mapping[str, str] | None = None,
        samples: int = 2,
        dark: bool = False,
    ) -> None:
        if samples not in SAMPLES:
            raise ValueError(f"samples {samples!r}: expected 1 or 2, the samples along a side of a pixel")
        self.size, self.samples = check_size(size or DEFAULT), samples
        self.scheme = colours.DARK if dark else colours.LIGHT
        self.fluid_colours = dict(fluid_colours or {})
        self._lines = Rasterizer(self.size, 2)
        self._kept: tuple[Scenery, Empty] | None = None  # the picture without fluid, while its tank stays the same

    def frame(self, volume: Volume, view: View | None = None, lapse: str = "") -> Array:
        """A picture of a volume, (H, W, 3) uint8; `ValueError` if there are more than two fluids."""
        names, scheme = volume.fluid_names, self.scheme
        if len(names) > 2:
            raise ValueError(f"{', '.join(names)}: flows of three fluids or more in 3-D are drawn as a slice only")
        fluid = volume.drawn
        own = colours.fluid_colours(names, volume.fluid_densities, self.fluid_colours)[fluid]
        room = volume.room
        layout = self._layout()
        camera = Camera.around(room.corners, volume.up, (view and view.camera) or USUAL, layout.box)
        up, size = np.eye(3)[volume.up], float(np.ptp(room.corners, axis=0).max())
        ticks = round_ticks(0.0, size, 9)
        step = float(ticks[1] - ticks[0])
        ground = np.array(scheme.background)
        wall = colours.rgb(scheme.wall)
        light = Light(
            ground=ground,
            wall=colours.mix(ground, wall, 0.10),
            line=colours.mix(ground, wall, 0.26),
            sky=colours.mix(ground, [0.85, 0.93, 1.0], 0.5),
            horizon=colours.mix(ground, [0.55, 0.68, 0.8], 0.7),
            fluid=colours.mix(own, 1.0, 0.12),
            clear=CLEAR * size,
        )
        tank = scenery(camera, room, volume.blocks_now, up, light, wall, step, volume.spacing)
        if self._kept is None or not all(map(np.array_equal, tank, self._kept[0])):
            edges = Drawing()
            before = camera.seen(room.edges[room.before(camera)])[..., :2]
            edges.lines(before, EDGE_WIDTH * layout.unit, (1, 1, 1), cap=0.3)
            share = 0.8 / 255 * self._lines.paint(edges, (0, 0, 0))[..., 0].astype(np.float32)
            self._kept = tank, empty(tank, share, self.samples)
        seen = look_at(fluid_surface(volume, fluid), camera, self.size, self.samples, volume.spacing)
        picture = shaded(seen, *self._kept)
        lengths = np.ptp(room.corners, axis=0)
        return self._annotated(picture, volume, layout, lengths, step, lapse, colours.mix(own, 1.0, 0.12))

    def _layout(self) -> Layout:
        """Places of tank and text, with the panel below."""
        (width, height), unit = self.size, max(0.5625, min(self.size[0] / DEFAULT[0], self.size[1] / DEFAULT[1]))
        side, head, foot = _SIDE * unit, _HEAD * unit, _FOOT * unit
        box = (side, head, width - side, height - foot)
        panel = (side, height - foot, width - side, height - 8 * unit)
        return Layout(self.size, unit, (0.0, 0.0), (1.0, 1.0), 1.0, box, False, panel)

    def _annotated(
        self, image: Array, volume: Volume, layout: Layout, lengths: Array, step: float, lapse: str, fill: Array
    ) -> Array:
        fluid = volume.drawn
        annotator = Annotator(image, layout, scheme=self.scheme)
        if volume.title:
            annotator.title(volume.title)
        left, top, right = layout.panel[:3]
        u, at = layout.unit, left + 190 * layout.unit
        annotator.text((left, top + 50 * u), lapse, SMALL, self.scheme.subtle)
        clear = [name for k, name in enumerate(volume.fluid_names) if k != fluid]
        name = volume.fluid_names[fluid] + "".join(f" ({other} is not shown)" for other in clear)
        annotator.swatch((at, top + 20 * u), name, fill, right - at)
        size = " x ".join(f"{length:.4g}" for length in lengths)
        annotator.text((right, top + 24 * u), f"{size} m, lines every {step:g} m", SMALL, self.scheme.subtle, "rt")
        done = np.array(annotator.image)
        clock(done, volume, layout, self.scheme)
        return done

    def close(self) -> None:
        """Free the buffers."""
        self._lines.close()

    def __enter__(self) -> "SolidRenderer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
