"""Draw all stored times of a results folder: PNG frames and movies."""

import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from .arrays import Array, Range
from .flow import Tracers
from .movie import MovieWriter, check_movie_name
from .renderer import Renderer
from .results import Results
from .scales import check_range, field_limits
from .scene import Scene
from .view import View

_MOST_SAMPLED = 24  # stored times that are read to find the range of a field


class Animation(NamedTuple):
    """The files that were written.

    Attributes:
        frames: PNG files.
        movies: movie files.
        backend: the back end used.
        field_range: (low, high) of the field's colours; None without a field.
    """

    frames: list[Path]
    movies: list[Path]
    backend: str
    field_range: tuple[float, float] | None


def animate(
    out: str | PathLike[str],
    field: str | None = None,
    frames: bool = True,
    movie: str | Iterable[str] | None = "animation.mp4",
    playback_rate: float = 25.0,
    *,
    size: tuple[int, int] = (1280, 720),
    field_range: Range | None = None,
    mesh: bool = False,
    particles: bool = False,
    backend: str = "auto",
    fluid_colours: Mapping[str, str] | None = None,
    view: View | None = None,
    samples: int = 2,
) -> Animation:
    """Draw every stored time of a results folder, one picture each.

    Frames go to out/frames/frame_0000.png, ..., movies to out. With a field its name is part of theirs:
    out/frames_pressure/, animation_pressure.mp4. Frames with higher numbers than the last stored time, left by
    an earlier and longer run, are removed.

    Args:
        out: results folder.
        field: name of a field to colour by; None shows the fluids.
        frames: write PNG files.
        movie: one or more file names ending in .mp4, .gif or .webp; None or empty for none.
        playback_rate: pictures per second.
        size: (width, height) [px], even numbers.
        field_range: (low, high) of the colours; None takes it from up to 24 stored times, one range for all.
        mesh: draw the edges of the cells.
        particles: draw the particles as dots.
        backend: "ggui", "raster" or "auto", see `Renderer`.
        fluid_colours: colours "#rrggbb" by the names of fluids.
        view: the part shown, the layers and the colour map; None for all of the scene without layers.
        samples: of the rasteriser along a side of a pixel, 1 or 2, see `Renderer`.

    Raises:
        ValueError: an argument is invalid.
        ResultsError: the results folder cannot be read.
        OSError: a file cannot be written.
    """
    names = [movie] if isinstance(movie, str) else list(movie or [])
    names = [check_movie_name(name) for name in names]
    if not 0 < playback_rate <= 1000:
        raise ValueError(f"playback rate {playback_rate:g}: expected pictures a second, above 0 and up to 1000")
    if not (frames or names):
        raise ValueError("nothing to write: neither frames nor a movie is asked for")
    if field_range is not None:
        if field is None:
            raise ValueError("a field range is given, but no field to colour by")
        field_range = check_range(field_range)
    results = Results(out)
    if field is not None:
        results.scene(0).field_values(field)
        if field_range is None:
            field_range = field_limits(_sampled(results), field)

    tail = f"_{field}" if field else ""
    folder = results.folder / f"frames{tail}"
    written = []
    with ExitStack() as stack:
        renderer = stack.enter_context(Renderer(size, backend, fluid_colours, samples))
        progress = stack.enter_context(_progress())
        writers: list[MovieWriter] = []
        tracers: Tracers | None = None
        for name in names:
            path = results.folder / f"{Path(name).stem}{tail}{Path(name).suffix}"
            writers.append(MovieWriter(path, renderer.size, playback_rate))
            stack.callback(writers[-1].discard)
        if frames:
            folder.mkdir(exist_ok=True)
        for i in progress.track(range(len(results)), description="drawing"):
            scene = results.scene(i)
            if view is not None and view.tracers:
                tracers = Tracers(scene, view.tracers) if tracers is None else tracers
                scene = replace(scene, trails=tracers.advance(scene))
            image = renderer.frame(scene, field, field_range, mesh, particles, view)
            if frames:
                written.append(_write_png(folder / f"frame_{i:04d}.png", image))
            for writer in writers:
                writer.append(image)
        movies = [writer.finish() for writer in writers]
        used = renderer.backend
    if frames:
        _remove_beyond(folder, len(results))
    return Animation(written, movies, used, field_range)


def _sampled(results: Results) -> Iterator[Scene]:
    """Scenes at evenly spaced stored times."""
    count = min(len(results), _MOST_SAMPLED)
    return (results.scene(int(i)) for i in np.linspace(0, len(results) - 1, count).round())


def _write_png(path: Path, image: Array) -> Path:
    part = path.with_name(f".{path.name}.part")
    try:
        # Level 1 takes half the time of the default, and such flat pictures are small at any level.
        Image.fromarray(image).save(part, format="png", compress_level=1)
        part.replace(path)
    except OSError as error:
        raise OSError(f"{path}: the frame could not be written: {error}") from None
    finally:
        part.unlink(missing_ok=True)
    return path


def _remove_beyond(folder: Path, count: int) -> None:
    for path in folder.glob("frame_*.png"):
        number = re.fullmatch(r"frame_(\d+)\.png", path.name)
        if number and int(number[1]) >= count:
            path.unlink()


def _progress() -> Progress:
    """A bar on a terminal, nothing elsewhere."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True), disable=not sys.stderr.isatty())
