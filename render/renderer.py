"""Draw scenes as pictures, with either back end."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

from . import colours
from .annotation import Legend, annotate, entry_width, panel_width
from .arrays import Array, Range
from .drawing import Drawing
from .flow import arrow_speed
from .ggui import DriverError, GGUICanvas
from .layers import Key, layer_texts
from .layout import Layout, check_size, fitted_size, make_layout
from .picture import draw_scene
from .rasterizer import Rasterizer
from .scales import MUTED_FIELD, FieldSample, check_range
from .scene import Scene
from .solid import SolidRenderer, check_solid
from .view import Look, View
from .volume import Volume
from .vulkan import software_driver


class Canvas(Protocol):
    """A back end that paints drawings of one size."""

    name: str

    def paint(self, drawing: Drawing, background: Sequence[float]) -> Array:
        """Picture (H, W, 3) uint8 of a drawing on a background (3,) in [0, 1]."""

    def close(self) -> None:
        """Free the window or buffers."""


BACKENDS = ("auto", "ggui", "raster")


class Renderer:
    """Draws many scenes at one size and reuses its buffers. Use it as a context manager, or call `close`.

    Args:
        size: (width, height) [px], even numbers.
        backend: "ggui" (offscreen, needs a Vulkan driver), "raster" (Taichi kernels only), or "auto": GGUI with
            the driver of a GPU, else the rasteriser; see `backend`.
        fluid_colours: colours "#rrggbb" by the names of fluids, in place of the default colours.
        samples: of the rasteriser along a side of a pixel: 2 for smooth edges, 1 for pictures in half the time.
        dark: draw light text on a dark background.
        transparent: draw no background: pictures have a fourth channel, which takes twice the time.

    Raises:
        ValueError: an argument is invalid.
        RuntimeError: the back end is "ggui" and there is no driver.
    """

    def __init__(
        self,
        size: tuple[int, int] = (1280, 720),
        backend: str = "auto",
        fluid_colours: Mapping[str, str] | None = None,
        samples: int = 2,
        dark: bool = False,
        transparent: bool = False,
    ) -> None:
        self.size, self.transparent = check_size(size), transparent
        self.scheme = colours.DARK if dark else colours.LIGHT
        self.fluid_colours = dict(fluid_colours or {})
        self._canvas = make_canvas(self.size, backend, samples)

    @property
    def backend(self) -> str:
        """The back end in use: "ggui" or "raster"."""
        return self._canvas.name

    def frame(
        self,
        scene: Scene,
        field: str | None = None,
        field_range: Range | None = None,
        mesh: bool = False,
        particles: bool = False,
        view: View | None = None,
        lapse: str = "",
    ) -> Array:
        """A picture of a scene, (H, W, 3) uint8, or (H, W, 4) without its background.

        Args:
            scene: what is drawn.
            field: name of a field in `scene.fields` to colour by; None shows the fluids.
            field_range: (low, high) of the colours in the field's SI unit; None takes them from the scene.
            mesh: draw the edges of the cells.
            particles: draw the particles as dots.
            view: the part shown, the layers and the colour map; None for all of the scene without layers.
            lapse: of the movie that the picture is for, see `tipfem.render.animation.time_lapse`.

        Raises:
            ValueError: there is no such field, or the range is invalid.
        """
        if field is not None:
            scene.field_values(field)
            field_range = None if field_range is None else check_range(field_range)
        fills = colours.fluid_colours(scene.fluid_names, scene.fluid_densities, self.fluid_colours)
        view, field_range = settled(View() if view is None else view, [scene], field, field_range)
        layout = make_layout(self.size, *contents(scene, field, view))

        def drawn(scheme: colours.Scheme) -> Array:
            image, keys = self.tank(scene, layout, Look(field, field_range, mesh, particles, view), scheme)
            swatches = tuple(swatches_of(scene, field, view, fills, scheme))
            legend = Legend(swatches, field, field_range, view.colour_map, tuple(keys), lapse)
            return annotate(image, scene, layout, legend, scheme)

        return colours.on_transparent(drawn, self.scheme) if self.transparent else drawn(self.scheme)

    def tank(
        self, scene: Scene, layout: Layout, look: Look, scheme: colours.Scheme = colours.LIGHT
    ) -> tuple[Array, list[Key]]:
        """A picture of a tank without text, (H, W, 3) uint8, and the entries of the legend for its lines.

        The layout is of this renderer's size, and the view of `settled`.
        """
        fills = colours.fluid_colours(scene.fluid_names, scene.fluid_densities, self.fluid_colours)
        drawing, keys = draw_scene(scene, layout, fills, look, scheme)
        return self._canvas.paint(drawing, scheme.background), keys

    def close(self) -> None:
        """Free the back end's window or buffers; a later frame opens them again."""
        self._canvas.close()

    def __enter__(self) -> "Renderer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def settled(
    view: View, scenes: Iterable[Scene], field: str | None, field_range: Range | None
) -> tuple[View, Range | None]:
    """A view and a range with what they leave open taken from scenes.

    That is: muted fluids, the interval of contours, the speed of the arrows in the legend, and the range.
    """
    samples = {name: FieldSample(scenes, name) for name in {field, view.contours} if name is not None}
    if view.muted is None:
        view = replace(view, muted=samples[MUTED_FIELD].muted() if MUTED_FIELD in samples else ())

    def left_out(name: str) -> tuple[str, ...]:
        return (view.muted or ()) if name == MUTED_FIELD else ()

    if view.contours is not None and view.interval is None:
        view = replace(view, interval=samples[view.contours].interval(left_out(view.contours)))
    if view.arrows and view.arrow_speed is None:
        view = replace(view, arrow_speed=arrow_speed(scenes, view))
    if field is not None and field_range is None:
        field_range = samples[field].limits(left_out(field))
    return view, field_range


def natural_size(scene: Scene, field: str | None, view: View) -> tuple[int, int]:
    """The size (width, height) [px] of a picture without empty margins, at most 1280x720."""
    return fitted_size(*contents(scene, field, settled(view, [scene], field, (0.0, 1.0))[0]))


def swatches_of(
    scene: Scene, field: str | None, view: View, fills: Array, scheme: colours.Scheme
) -> list[tuple[str, tuple[float, ...]]]:
    """Texts of the legend for the fluids that keep their own colours, with these (3,), of ``fills`` (F, 3)."""
    fills = colours.shades(fills, scheme, view.look).mean(axis=1)
    return [
        (text, tuple(fills[scene.fluid_names.index(name)].tolist()))
        for name, text in _named(scene, field, view).items()
    ]


def _named(scene: Scene, field: str | None, view: View) -> dict[str, str]:
    """Texts of the fluids with a swatch in the legend, by their names."""
    if field is None:
        return {name: name for name in scene.fluid_names}
    muted = (view.muted or ()) if field == MUTED_FIELD else ()
    # With three fluids or more the interfaces have stripes of their colours.
    names = scene.fluid_names if len(scene.fluid_names) > 2 else muted
    return {name: f"{name} (not coloured)" if name in muted else name for name in names}


def contents(scene: Scene, field: str | None, view: View) -> tuple[Array, Array, bool, float, list[float], bool]:
    """Contents that a layout depends on: corners of the part shown, title, widths of panel and entries, colour bar."""
    lower, upper = view.bounds(scene)
    texts = layer_texts(scene, view, field)
    texts = [*_named(scene, field, view).values(), *texts]
    entries = [entry_width(text) for text in texts]
    return lower, upper, bool(scene.title), panel_width(scene, field, texts), entries, field is not None


def render_frame(
    scene: Scene | Volume,
    size: tuple[int, int] | None = None,
    field: str | None = None,
    field_range: Range | None = None,
    mesh: bool = False,
    particles: bool = False,
    backend: str = "auto",
    fluid_colours: Mapping[str, str] | None = None,
    view: View | None = None,
    samples: int = 2,
) -> Array:
    """One picture of a scene or a volume, (H, W, 3) uint8.

    Args:
        scene: what is drawn; of a volume the densest fluid, from the camera of the view.
        size: (width, height) [px], even numbers; None takes what the tank needs of 1280x720.
        field: name of a field in `scene.fields` to colour by; None shows the fluids.
        field_range: (low, high) of the colours in the field's SI unit; None takes them from the scene.
        mesh: draw the edges of the cells.
        particles: draw the particles as dots.
        backend: "ggui", "raster" or "auto", see `Renderer`.
        fluid_colours: colours "#rrggbb" by the names of fluids.
        view: the part shown, the layers and the colour map; None for all of the scene without layers.
        samples: along a side of a pixel, see `Renderer`.

    Raises:
        ValueError: an argument is invalid.
        RuntimeError: the back end is "ggui" and there is no driver.
    """
    if isinstance(scene, Volume):
        check_solid(view or View(), {"a field": field, "the mesh": mesh, "particles": particles})
        with SolidRenderer(size, fluid_colours, samples) as solid:
            return solid.frame(scene, view)
    if size is None:
        if field is not None:
            scene.field_values(field)
        size = natural_size(scene, field, view or View())
    with Renderer(size, backend, fluid_colours, samples) as renderer:
        return renderer.frame(scene, field, field_range, mesh, particles, view)


def make_canvas(size: tuple[int, int], backend: str, samples: int) -> Canvas:
    """The back end of a name, or with "auto" the one that `Renderer` chooses.

    Raises:
        ValueError: the name is none of `BACKENDS`.
        RuntimeError: the back end is "ggui" and there is no driver.
    """
    if backend not in BACKENDS:
        raise ValueError(f"backend {backend!r}: expected one of {', '.join(BACKENDS)}")
    if backend == "raster" or (backend == "auto" and software_driver() is not None):  # `tipfem doctor` says so
        return Rasterizer(size, samples)
    try:
        return GGUICanvas(size)
    except DriverError as error:
        if backend == "ggui":
            raise RuntimeError(
                f"backend 'ggui' needs a Vulkan driver: {error}; install one (on Debian "
                "libvulkan1 and mesa-vulkan-drivers) or choose backend 'raster'"
            ) from None
    return Rasterizer(size, samples)
