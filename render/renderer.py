"""Draw scenes as pictures, with either back end."""

import sys
from collections.abc import Mapping

import numpy as np

from . import colours
from .annotation import annotate, panel_width
from .ggui import DriverError, GGUICanvas
from .layout import Layout, check_size, make_layout
from .picture import draw_scene
from .rasterizer import Rasterizer
from .scales import check_range, field_limits
from .scene import Scene

BACKENDS = ("auto", "ggui", "raster")
_told = False


class Renderer:
    """Draws many scenes at one size, with buffers used again. Use as a context manager, or `close()` it.

    size: (width, height) [px], even numbers. backend: "ggui" (offscreen, needs a Vulkan driver), "raster"
    (Taichi kernels alone), or "auto": GGUI, and without a driver the rasteriser, said in a line on stderr.
    fluid_colours: name of a fluid -> '#rrggbb', for those that shall not have their default colour.

    Raises ValueError on a bad argument, RuntimeError where "ggui" is asked for and there is no driver.
    """

    def __init__(self, size=(1280, 720), backend="auto", fluid_colours: Mapping[str, str] | None = None):
        self.size = check_size(size)
        self.fluid_colours = dict(fluid_colours or {})
        self._canvas = _canvas(self.size, backend)

    @property
    def backend(self) -> str:
        """The back end in use: "ggui" or "raster"."""
        return self._canvas.name

    def frame(self, scene: Scene, field=None, field_range=None, mesh=False, particles=False) -> np.ndarray:
        """A picture of the scene, (H, W, 3) uint8; arguments as in `render_frame`."""
        if field is not None:
            scene.field_values(field)
            field_range = field_limits([scene], field) if field_range is None else check_range(field_range)
        fills = colours.fluid_colours(scene.fluid_names, scene.fluid_densities, self.fluid_colours)
        layout = make_layout(self.size, scene.lower, scene.upper, bool(scene.title), panel_width(scene, field))
        drawing = draw_scene(scene, layout, fills, field=field, field_range=field_range, mesh=mesh, particles=particles)
        image = self._canvas.paint(*drawing.arrays(), colours.BACKGROUND)
        return annotate(image, scene, layout, fills, field, field_range)

    def tank(self, scene: Scene, layout: Layout) -> np.ndarray:
        """The fluids in their tank alone, without any text, (H, W, 3) uint8; the layout is of this renderer's size."""
        fills = colours.fluid_colours(scene.fluid_names, scene.fluid_densities, self.fluid_colours)
        return self._canvas.paint(*draw_scene(scene, layout, fills).arrays(), colours.BACKGROUND)

    def close(self):
        """Free the back end's window or buffers; a later frame opens them again."""
        self._canvas.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


def render_frame(
    scene: Scene,
    size=(1280, 720),
    field=None,
    field_range=None,
    mesh=False,
    particles=False,
    backend="auto",
    fluid_colours: Mapping[str, str] | None = None,
) -> np.ndarray:
    """One picture of a scene, (H, W, 3) uint8.

    field: name of a field in `scene.fields` to colour by; None shows the fluids.
    field_range: (low, high) of the colours in the field's SI unit; None takes them from the scene.
    mesh, particles: draw the edges of the cells, and the particles as dots.
    size, backend, fluid_colours: as in `Renderer`.
    """
    with Renderer(size, backend, fluid_colours) as renderer:
        return renderer.frame(scene, field, field_range, mesh, particles)


def _canvas(size, backend):
    global _told
    if backend not in BACKENDS:
        raise ValueError(f"backend {backend!r}: expected one of {', '.join(BACKENDS)}")
    if backend == "raster":
        return Rasterizer(size)
    try:
        return GGUICanvas(size)
    except DriverError as error:
        if backend == "ggui":
            raise RuntimeError(
                f"backend 'ggui' needs a Vulkan driver: {error}; install one (on Debian "
                "libvulkan1 and mesa-vulkan-drivers) or choose backend 'raster'"
            ) from None
    if not _told:
        _told = True
        print("tipfem.render: no Vulkan driver for GGUI, drawing with the rasteriser", file=sys.stderr)
    return Rasterizer(size)
