"""The command line: tipfem render OUT, which is also python -m tipfem.render OUT."""

import os
import re
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from cyclopts import App, CycloptsError, Parameter

from .animation import animate
from .camera import USUAL
from .results import Results
from .strips import moved
from .strips import strip as draw_strip
from .vector import draw_vectors
from .view import View

EXAMPLES = """\
Examples:

tipfem render out

tipfem render out --field pressure --range 0 3000

tipfem render out --mesh --particles --size 1920x1080

tipfem render out --movie animation.gif animation.webp --no-frames

tipfem render out --follow front --arrows --mesh

tipfem render out --window 0 0 0.3 0.2 --contours pressure --no-fill

tipfem render out --strip 0 0.1 0.2 0.3 --no-frames --no-movie

tipfem render out --strip 0 0.1 0.2 0.3 --svg --pdf

tipfem render out3d --azimuth 40 --elevation 30

tipfem render out3d --slice y=0.5 --field pressure

It reads the times that are stored when it starts, so it can also be used while a run is under way. One stored time is
one picture; the movie shows them evenly, at the playback rate. The options are part of the names of what is written, so
that pictures of different options stand side by side; --name sets a shorter name, and movies that are named by --movie
have that name.
"""
MOVIE = "animation.mp4"  # by default
TRACERS = 200  # by default
PAUSE = 0.1  # between looks at a run that is under way [s]

T = TypeVar("T")
Several = Annotated[tuple[T, ...], Parameter(consume_multiple=True)]
Flag = Annotated[bool, Parameter(show_default=False)]


def _size(_type: Any, tokens: Sequence[Any]) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)[xX](\d+)", tokens[0].value)
    if not match:
        raise ValueError(f"{tokens[0].value!r}: expected WIDTHxHEIGHT in pixels, for example 1280x720")
    return int(match[1]), int(match[2])


_SIZE = Parameter(converter=_size, n_tokens=1, accepts_keys=False, metavar="WIDTHxHEIGHT")


def render(
    out: Path,
    /,
    *,
    field: str = "none",
    range: tuple[float, float] | None = None,
    colour_all: Flag = False,
    mesh: Flag = False,
    particles: Flag = False,
    window: tuple[float, float, float, float] | None = None,
    follow: str | None = None,
    slice: str | None = None,
    azimuth: float | None = None,
    elevation: float | None = None,
    frame: Literal["room", "tank"] = "room",
    no_fill: Flag = False,
    outlines: Literal["smooth", "mesh"] | None = None,
    look: Literal["lit", "flat"] = "lit",
    arrows: Flag = False,
    arrow_speed: float | None = None,
    streamlines: Flag = False,
    contours: str | None = None,
    interval: float | None = None,
    tracers: Annotated[tuple[int, ...] | None, Parameter(consume_multiple=(0, 1))] = None,
    colour_map: Literal["viridis", "cividis", "blue-red"] | None = None,
    samples: Literal[1, 2] = 2,
    size: Annotated[tuple[int, int] | None, _SIZE] = None,
    backend: Literal["auto", "ggui", "raster"] = "auto",
    movie: Several[str] | None = None,
    no_movie: Flag = False,
    playback_rate: float = 25.0,
    frame_rate: float | None = None,
    strip: Annotated[tuple[float, ...] | None, Parameter(consume_multiple=(0, 1000))] = None,
    columns: int | None = None,
    width: int | None = None,
    svg: Flag = False,
    pdf: Flag = False,
    dark: Flag = False,
    transparent: Flag = False,
    title: str | None = None,
    name: str | None = None,
    no_frames: Flag = False,
    colour: list[str] | None = None,
    as_it_runs: Flag = False,
) -> int:
    """Draw the results folder of a run as pictures and a movie.

    Args:
        out: Results folder of a run.
        field: Colour by speed [m/s], velocity_x [m/s], velocity_y [m/s], pressure [Pa], density [kg/m^3], vorticity
            [1/s], shear_rate [1/s], with laws of viscosity viscosity [Pa s] and yielded, or another scalar of the
            results; none shows the fluids.
        range: Values at the ends of the colours, LOW HIGH, in the field's unit; by default from the results, the same
            for all pictures.
        colour_all: Colour every fluid by the pressure; by default a gas whose pressure hardly varies keeps its own
            colour.
        mesh: Draw the edges of the cells.
        particles: Draw the particles as dots.
        window: Part of the domain that is shown, X0 Y0 X1 Y1 [m]; by default all of it.
        follow: Move the window with the front of the heaviest fluid (front), of another one (front:NAME) or with the
            centre of a fluid (NAME); its size is that of --window, else a third of the domain.
        slice: Plane that is shown of a flow in 3-D, such as y=0.5 [m]; without it the fluid is seen in its tank.
        azimuth: From which a flow in 3-D is seen, around the tank and anticlockwise from above [degrees]; -25 by
            default.
        elevation: From which a flow in 3-D is seen [degrees]; 18 by default.
        frame: tank draws a tank that moves as if it rested: what moves relative to it is seen. Velocities stay those in
            the room, given along the tank's axes.
        no_fill: Leave the cells white: the interface alone, or with --particles dots by fluid.
        outlines: Of the fluids: smooth, as the legend says, or along the edges of the mesh; by default smooth where the
            fluids alone are shown, without a field, mesh or particles.
        look: Of the fluids: lit, shaded by depth; or flat, of one colour each, for print. SVG and PDF are flat.
        arrows: Draw arrows of the velocity, to one scale in all pictures.
        arrow_speed: Of the arrow in the legend [m/s]; by default a round one, the same for all pictures.
        streamlines: Draw streamlines of the velocity.
        contours: Draw contours of a field, for example pressure.
        interval: Between contours, in their field's unit; by default a round one, the same for all pictures.
        tracers: Draw points that move with the fluids, with tails; 200 of them without a number.
        colour_map: Colours of the field; by default blue-red for components of the velocity, else viridis.
        samples: Of the rasteriser along a side of a pixel: 2 for smooth edges, 1 to be faster.
        size: Of the pictures in pixels, WIDTHxHEIGHT, even numbers; by default what the tank needs of 1280x720.
        backend: ggui: Taichi's GGUI, offscreen, needs a Vulkan driver; raster: Taichi kernels alone; auto: ggui where
            there is a GPU's driver, else raster.
        movie: Movies to write in OUT, ending in .mp4, .gif or .webp; by default animation.mp4.
        no_movie: Write no movie.
        playback_rate: Stored times shown a second [1/s].
        frame_rate: Pictures a second, at the same pace, in place of one of each stored time: 60 move evenly. Between
            stored times fluids are carried by their velocities.
        strip: Draw these times [s] side by side in one picture, OUT/strip.png; four over the run without a number.
        columns: Of --strip: tanks in a row; at most 4 by default, and fewer of flat tanks.
        width: Of --strip in pixels; 1600 by default, 800 of a single time.
        svg: Write the times of --strip, or the last one, as vectors, OUT/strip.svg or OUT/picture.svg, and no movie or
            frames unless they are named; needs tipfem[plot].
        pdf: The same as PDF.
        dark: Light text on a dark background.
        transparent: No background; writes no movie.
        title: A line above the tank; by default the title of the case.
        name: In place of the options in the names of what is written: OUT/frames_NAME, OUT/animation_NAME.mp4,
            OUT/strip_NAME.png.
        no_frames: Write no PNG files.
        colour: Colour of a fluid, as water=#0072b2; may be given several times.
        as_it_runs: Draw a run that is under way as it goes on, until standard input ends, with what the run leaves of
            the processor; pictures whose scale needs all times, and --strip, follow at the end.
    """
    under_way = _until_input_ends() if as_it_runs else lambda: False
    movies = () if no_movie else movie or (MOVIE,) * (not transparent)
    colours, missing, camera = {}, False, None
    if azimuth is not None or elevation is not None:
        camera = USUAL[0] if azimuth is None else azimuth, USUAL[1] if elevation is None else elevation
    try:
        for text in colour or ():
            fluid, _, code = text.partition("=")
            if not (fluid and code):
                raise ValueError(f"--colour {text!r}: expected FLUID=#RRGGBB, for example water=#0072b2")
            colours[fluid] = code
        looks: dict[str, Any] = dict(field_range=range, mesh=mesh, particles=particles, fluid_colours=colours)
        looks |= dict(name=name, frame=frame, dark=dark, transparent=transparent, backend=backend, samples=samples)
        looks["field"] = None if field == "none" else field
        seen: dict[str, Any] = dict(window=window, follow=follow, slice=slice, camera=camera, look=look)
        seen |= dict(arrows=arrows, arrow_speed=arrow_speed, streamlines=streamlines, contours=contours)
        looks["view"] = View(
            **seen,
            fill=not no_fill,
            interval=interval,
            tracers=0 if tracers is None else (*tracers, TRACERS)[0],
            colour_map=colour_map,
            muted=() if colour_all else None,
            smooth=None if outlines is None else outlines == "smooth",
        )
        if strip is None and (columns or width):
            raise ValueError(f"--{'columns' if columns else 'width'} needs --strip")
        if as_it_runs and (svg or pdf or (no_frames and not movies)):
            while under_way():
                pass
        if svg or pdf:
            if width:
                raise ValueError("--width is in pixels; SVG and PDF are as wide as a page")
            suffixes = [".svg"] * svg + [".pdf"] * pdf
            kept = {key: value for key, value in looks.items() if key not in ("backend", "samples")}
            for line in moved(Results(out, slice=slice).times, strip or ()):
                print(line)
            for path in draw_vectors(out, strip, suffixes, columns=columns, title=title, **kept):
                print(path)
            if not movie:
                return 0
            strip, no_frames = None, True
        shown: dict[str, Any] = dict(frames=not no_frames, movie=movies, size=size, title=title)
        shown |= dict(playback_rate=playback_rate, frame_rate=frame_rate)
        done = None
        if as_it_runs and (movies or not no_frames):
            done = animate(out, under_way=under_way, **shown, **looks)
        if strip is not None:
            try:
                for line in moved(Results(out, slice=slice).times, strip):
                    print(line)
                print(draw_strip(out, strip, columns=columns, width=width, **looks))
            except ValueError as error:
                if no_frames and not movies:
                    raise
                # One picture that does not fit does not cost the others.
                print(f"error: {error}", file=sys.stderr)
                missing = True
            if no_frames and not movies:
                return 0
        if done is None:
            done = animate(out, **shown, **looks)
        # Movies have the names that were given, whatever the options.
        named = [path.replace(path.with_name(given)) for path, given in zip(done.movies, movie or (), strict=False)]
    except BrokenPipeError:  # the reader of the output, such as head, has closed it
        raise
    except (ValueError, OSError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    if done.field_range is not None:
        print(f"{field}: colours from {done.field_range[0]:g} to {done.field_range[1]:g}")
    for fluid in done.muted:
        print(f"{fluid}: not coloured, its pressure hardly varies; --colour-all colours it")
    if done.frames:
        print(f"{done.frames[0].parent}: {len(done.frames)} frames, drawn with {done.backend}")
    for path in named or done.movies:
        print(path)
    return 2 if missing else 0


def _until_input_ends() -> Callable[[], bool]:
    """A function that waits for a moment and says whether standard input is still open; this process gives way."""
    if hasattr(os, "nice"):
        os.nice(10)
    ended = threading.Event()

    def read() -> None:
        while sys.stdin.read(1 << 16):
            pass
        ended.set()

    threading.Thread(target=read, daemon=True).start()
    return lambda: not ended.wait(PAUSE)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line; returns 0, 2 after an error, which is one line on stderr, or 130 after an interrupt."""
    app = App(name="tipfem render", help_epilogue=EXAMPLES, version_flags=[], default_parameter=Parameter(negative=()))
    app.default(render)
    try:
        result = app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
    except CycloptsError as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return result if isinstance(result, int) else 0
