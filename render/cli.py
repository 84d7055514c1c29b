"""The command line: python -m tipfem.render OUT."""

import argparse
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from .animation import animate
from .colours import COLOUR_MAPS
from .renderer import BACKENDS
from .strips import strip
from .view import View

EPILOG = """\
examples:
  python -m tipfem.render out
  python -m tipfem.render out --field pressure --range 0 3000
  python -m tipfem.render out --mesh --particles --size 1920x1080
  python -m tipfem.render out --movie animation.gif animation.webp --no-frames
  python -m tipfem.render out --follow front --arrows --mesh
  python -m tipfem.render out --window 0 0 0.3 0.2 --contours pressure --no-fill
  python -m tipfem.render out --strip 0 0.1 0.2 0.3 --no-frames --no-movie

It reads the times that are stored when it starts, so it can also be used while a run is under way.
One stored time is one picture; the movie shows them evenly, at the playback rate. The options are part of the names of
what is written, so that pictures of different options stand side by side; --name sets a shorter name.
"""


MOVIE = "animation.mp4"  # by default


def parser() -> argparse.ArgumentParser:
    """The parser of the command line."""
    made = argparse.ArgumentParser(
        prog="tipfem render",
        description="Draw the results folder of a run as pictures and a movie.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    made.add_argument("out", metavar="OUT", type=Path, help="results folder of a run")
    made.add_argument(
        "--field",
        default="none",
        metavar="NAME",
        help="colour by speed [m/s], velocity_x [m/s], velocity_y [m/s], pressure [Pa], "
        "density [kg/m^3] or another scalar of the results; none shows the fluids "
        "(default)",
    )
    made.add_argument(
        "--range",
        nargs=2,
        type=float,
        metavar=("LOW", "HIGH"),
        dest="field_range",
        help="values at the ends of the colours, in the field's unit "
        "(default: from the results, the same for all pictures)",
    )
    made.add_argument(
        "--colour-all",
        action="store_true",
        help="colour every fluid by the pressure (default: a gas whose pressure hardly varies keeps its own)",
    )
    made.add_argument("--mesh", action="store_true", help="draw the edges of the cells")
    made.add_argument("--particles", action="store_true", help="draw the particles as dots")
    made.add_argument(
        "--window",
        nargs=4,
        type=float,
        metavar=("X0", "Y0", "X1", "Y1"),
        help="part of the domain that is shown [m] (default: all of it)",
    )
    made.add_argument(
        "--follow",
        metavar="WHAT",
        help="move the window with the front of the heaviest fluid (front), of another one (front:NAME) or with the "
        "centre of a fluid (NAME); its size is that of --window, else a third of the domain",
    )
    made.add_argument(
        "--no-fill",
        action="store_true",
        help="leave the cells white: the interface alone, or with --particles dots by fluid",
    )
    made.add_argument("--arrows", action="store_true", help="draw arrows of the velocity, to one scale in all pictures")
    made.add_argument(
        "--arrow-speed",
        type=float,
        metavar="SPEED",
        help="of the arrow in the legend [m/s] (default: a round one, the same for all pictures)",
    )
    made.add_argument("--streamlines", action="store_true", help="draw streamlines of the velocity")
    made.add_argument("--contours", metavar="NAME", help="draw contours of a field, for example pressure")
    made.add_argument(
        "--interval",
        type=float,
        metavar="VALUE",
        help="between contours, in their field's unit (default: a round one, the same for all pictures)",
    )
    made.add_argument(
        "--tracers",
        nargs="?",
        type=int,
        default=0,
        const=200,
        metavar="COUNT",
        help="draw points that move with the fluids, with tails (200 without a COUNT)",
    )
    made.add_argument(
        "--colour-map",
        choices=list(COLOUR_MAPS),
        help="colours of the field (default: blue-red for components of the velocity, else viridis)",
    )
    made.add_argument(
        "--samples",
        type=int,
        choices=(1, 2),
        default=2,
        help="samples of the rasteriser along a side of a pixel: 2 for smooth edges (default), 1 to be faster",
    )
    made.add_argument(
        "--size",
        type=_size,
        metavar="WIDTHxHEIGHT",
        help="size of the pictures in pixels, even numbers (default: what the tank needs of 1280x720)",
    )
    made.add_argument(
        "--backend",
        choices=BACKENDS,
        default="auto",
        help="ggui: Taichi's GGUI, offscreen, needs a Vulkan driver; "
        "raster: Taichi kernels alone; "
        "auto: ggui where there is a GPU's driver, else raster (default)",
    )
    made.add_argument(
        "--movie",
        nargs="*",
        default=[],
        metavar="FILE",
        help="movies to write in OUT, ending in .mp4, .gif or .webp (default: animation.mp4)",
    )
    made.add_argument("--no-movie", action="store_true", help="write no movie")
    made.add_argument(
        "--playback-rate", type=float, default=25.0, metavar="RATE", help="pictures shown a second [1/s] (default: 25)"
    )
    made.add_argument(
        "--strip",
        nargs="+",
        type=float,
        default=[],
        metavar="TIME",
        help="draw these times [s] side by side in one picture, OUT/strip.png",
    )
    made.add_argument("--title", help="a line above the tank (default: the title of the case)")
    made.add_argument(
        "--name",
        help="in place of the options in the names of what is written: OUT/frames_NAME, OUT/animation_NAME.mp4, "
        "OUT/strip_NAME.png",
    )
    made.add_argument("--no-frames", action="store_true", help="write no PNG files")
    made.add_argument(
        "--colour",
        action="append",
        default=[],
        type=_colour,
        metavar="FLUID=#RRGGBB",
        help="colour of a fluid; may be given several times",
    )
    return made


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command.

    Args:
        arguments: of the command line; by default those of the process.

    Returns:
        The exit status: 0, 2 after an error, which is one line on stderr, or 130 after an interrupt.
    """
    given = parser().parse_args(arguments)
    movies = [] if given.no_movie else given.movie or [MOVIE]
    field = None if given.field == "none" else given.field
    try:
        view = View(
            window=given.window,
            follow=given.follow,
            fill=not given.no_fill,
            arrows=given.arrows,
            arrow_speed=given.arrow_speed,
            streamlines=given.streamlines,
            contours=given.contours,
            interval=given.interval,
            tracers=given.tracers,
            colour_map=given.colour_map,
            muted=() if given.colour_all else None,
        )
        if given.strip:
            drawn = strip(
                given.out,
                given.strip,
                backend=given.backend,
                fluid_colours=dict(given.colour),
                field=field,
                field_range=given.field_range,
                mesh=given.mesh,
                particles=given.particles,
                view=view,
                samples=given.samples,
                name=given.name,
            )
            print(drawn)
            if given.no_frames and not movies:
                return 0
        done = animate(
            given.out,
            field,
            not given.no_frames,
            movies,
            given.playback_rate,
            size=given.size,
            field_range=given.field_range,
            mesh=given.mesh,
            particles=given.particles,
            backend=given.backend,
            fluid_colours=dict(given.colour),
            view=view,
            samples=given.samples,
            title=given.title,
            name=given.name,
        )
    except (ValueError, OSError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    if done.field_range is not None:
        print(f"{given.field}: colours from {done.field_range[0]:g} to {done.field_range[1]:g}")
    for fluid in done.muted:
        print(f"{fluid}: not coloured, its pressure hardly varies; --colour-all colours it")
    if done.frames:
        print(f"{done.frames[0].parent}: {len(done.frames)} frames, drawn with {done.backend}")
    for movie in done.movies:
        print(movie)
    return 0


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)[xX](\d+)", text)
    if not match:
        raise argparse.ArgumentTypeError(f"{text!r}: expected WIDTHxHEIGHT in pixels, for example 1280x720")
    return int(match[1]), int(match[2])


def _colour(text: str) -> tuple[str, str]:
    name, equals, code = text.partition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"{text!r}: expected FLUID=#RRGGBB, for example water=#0072b2")
    return name, code
