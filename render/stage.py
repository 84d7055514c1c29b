"""Pictures of a part of a scene without text, for viewers that have their own axes and legends."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from . import colours
from .arrays import Array, Range
from .layers import INTERFACE
from .layout import Layout
from .picture import draw_scene
from .renderer import Canvas, make_canvas
from .scales import check_range, field_limits
from .scene import Scene
from .view import View


class Stage:
    """Draws windows of scenes that fill pictures of one size, edge to edge; it reuses its buffers.

    Args:
        size: (width, height) [px].
        backend: see `Renderer`.
        fluid_colours: colours "#rrggbb" by the names of fluids, in place of the default colours.

    Raises:
        ValueError: an argument is invalid.
        RuntimeError: the back end is "ggui" and there is no driver.
    """

    def __init__(
        self, size: tuple[int, int], backend: str = "auto", fluid_colours: Mapping[str, str] | None = None
    ) -> None:
        self.size = size
        self.fluid_colours = dict(fluid_colours or {})
        self._backend = backend
        self._canvases: dict[int, Canvas] = {}

    def window(self, scene: Scene, view: View) -> tuple[float, float, float, float]:
        """The part of a scene that fills a picture, (x0, y0, x1, y1) [m].

        Args:
            scene: what is drawn.
            view: what is shown; the part is as wide as its window, and extends as far up and down from its middle as
                the picture is tall.

        Raises:
            ValueError: the fluid that the view follows is not in the scene.
        """
        lower, upper = view.bounds(scene)
        half = float(upper[0] - lower[0]) / self.size[0] * self.size[1] / 2
        middle = float(lower[1] + upper[1]) / 2
        return float(lower[0]), middle - half, float(upper[0]), middle + half

    def draw(
        self,
        scene: Scene,
        view: View,
        field: str | None = None,
        field_range: Range | None = None,
        mesh: bool = False,
        particles: bool = False,
        *,
        unit: float = 1.0,
        samples: int = 1,
        scheme: colours.Scheme = colours.LIGHT,
    ) -> tuple[Array, list[str]]:
        """A picture of the view's window, and lines of text on the scales of its layers.

        Args:
            scene: what is drawn.
            view: what is shown, see `window`.
            field: name of a field in `scene.fields` to colour by; None shows the fluids.
            field_range: (low, high) of the colours in the field's SI unit; None takes them from the scene.
            mesh: draw the edges of the cells.
            particles: draw the particles as dots.
            unit: size of a design pixel [px]; lines scale with it.
            samples: along a side of a pixel, 1 or 2, see `Renderer`.
            scheme: the colours around the fluids.

        Returns:
            (H, W, 3) uint8, and the lines.

        Raises:
            ValueError: there is no such field, or a value is invalid.
        """
        if field is not None:
            field_range = field_limits([scene], field) if field_range is None else check_range(field_range)
        if samples not in self._canvases:
            self._canvases[samples] = make_canvas(self.size, self._backend, samples)
        x0, y0, x1, y1 = window = self.window(scene, view)
        width, height = map(float, self.size)
        lower, upper, box = np.array([x0, y0]), np.array([x1, y1]), (0.0, 0.0, width, height)
        layout = Layout(self.size, unit, lower, upper, width / (x1 - x0), box, True, box)
        drawing, keys = draw_scene(
            scene,
            layout,
            colours.fluid_colours(scene.fluid_names, scene.fluid_densities, self.fluid_colours),
            field=field,
            field_range=field_range,
            mesh=mesh,
            particles=particles,
            view=replace(view, window=window, follow=None),
            scheme=scheme,
            bare=True,
        )
        notes = [
            key.text if key.length is None else f"arrows: {key.length * unit / layout.scale:.2g} m long at {key.text}"
            for key in keys
            if key.text != INTERFACE
        ]
        return self._canvases[samples].paint(drawing, scheme.background), notes

    def close(self) -> None:
        """Free the back ends' windows or buffers; a later picture opens them again."""
        for canvas in self._canvases.values():
            canvas.close()
        self._canvases.clear()
