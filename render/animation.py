"""Draw all stored times of a results folder: PNG frames and movies."""

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from .arrays import Array, Range
from .flow import Tracers
from .movie import MovieWriter, check_movie_name
from .renderer import Renderer, natural_size, settled
from .results import Results, ResultsError
from .scales import MUTED_FIELD, check_range, digits_of, fitting
from .scene import Scene
from .solid import SolidRenderer, check_solid
from .view import View

TAIL = 12  # stored times that the path of a tracer reaches back
FEWEST = 3  # stored times, before those of a run under way are drawn: they tell how far they are apart


class Animation(NamedTuple):
    """The files that were written.

    Attributes:
        frames: PNG files.
        movies: movie files.
        backend: the back end used.
        field_range: (low, high) of the field's colours; None without a field.
        muted: names of the fluids that were left uncoloured.
    """

    frames: list[Path]
    movies: list[Path]
    backend: str
    field_range: tuple[float, float] | None
    muted: tuple[str, ...]


def animate(
    out: str | PathLike[str],
    field: str | None = None,
    frames: bool = True,
    movie: str | Iterable[str] | None = "animation.mp4",
    playback_rate: float = 25.0,
    *,
    size: tuple[int, int] | None = None,
    field_range: Range | None = None,
    mesh: bool = False,
    particles: bool = False,
    backend: str = "auto",
    fluid_colours: Mapping[str, str] | None = None,
    view: View | None = None,
    samples: int = 2,
    title: str | None = None,
    name: str | None = None,
    frame: str = "room",
    dark: bool = False,
    transparent: bool = False,
    under_way: Callable[[], bool] | None = None,
    frame_rate: float | None = None,
) -> Animation:
    """Draw every stored time of a results folder, one picture each.

    Frames go to out/frames/frame_0000.png, ..., movies to out. The options that change what is seen are part of their
    names, see `picture_name`: out/frames_pressure_mesh/, animation_pressure_mesh.mp4. Frames with higher numbers than
    the last stored time, left by an earlier and longer run, are removed.

    Args:
        out: results folder.
        field: name of a field to colour by; None shows the fluids.
        frames: write PNG files.
        movie: one or more file names ending in .mp4, .gif or .webp; None or empty for none.
        playback_rate: pictures per second.
        size: (width, height) [px], even numbers; None takes what the tank needs of 1280x720.
        field_range: (low, high) of the colours; None takes it from up to 24 stored times, one range for all.
        mesh: draw the edges of the cells.
        particles: draw the particles as dots.
        backend: "ggui", "raster" or "auto", see `Renderer`.
        fluid_colours: colours "#rrggbb" by the names of fluids.
        view: the part shown, the layers and the colour map; None for all of the scene without layers.
        samples: of the rasteriser along a side of a pixel, 1 or 2, see `Renderer`.
        title: a line above the tank; None takes that of the case.
        name: in place of the options in the names of what is written: out/frames_NAME/, animation_NAME.mp4.
        frame: "tank" draws a tank that moves as if it rested, see `Results`.
        dark: draw light text on a dark background.
        transparent: draw frames without a background; movies have one.
        under_way: waits for a moment, and says whether a run still adds stored times. They are drawn as they come; at
            the end all are drawn again if the later ones change how pictures look, their title or digits of their
            times for instance. A field, contours or arrows, whose range needs all times, are drawn at the end.
        frame_rate: pictures per second, in place of one of each stored time: 60 move evenly, at the same pace. Between
            stored times particles are carried by their velocities.

    Raises:
        ValueError: an argument is invalid.
        ResultsError: the results folder cannot be read.
        OSError: a file cannot be written.
    """
    if name is not None and not re.fullmatch(r"[\w.=+-]+", name):
        raise ValueError(f"name {name!r}: expected letters, digits and any of . _ = + -, without spaces or folders")
    names = [movie] if isinstance(movie, str) else list(movie or [])
    names = [check_movie_name(file) for file in names]
    if not 0 < playback_rate <= 1000:
        raise ValueError(f"playback rate {playback_rate:g}: expected pictures a second, above 0 and up to 1000")
    if frame_rate is not None and not 0 < frame_rate <= 120:
        raise ValueError(f"frame rate {frame_rate:g}: expected pictures a second, above 0 and up to 120")
    if not (frames or names):
        raise ValueError("nothing to write: neither frames nor a movie was asked for")
    if transparent and names:
        raise ValueError(f"{names[0]}: movies have a background; draw frames alone, or leave out transparent")
    if field_range is not None:
        if field is None:
            raise ValueError("a field range is given, but no field to colour by")
        field_range = check_range(field_range)
    view = View() if view is None else view
    shown, view = view, view.for_files(field, mesh, particles)
    tail = name
    if tail is None:
        tail = picture_name(field, field_range, mesh, particles, shown, size, fluid_colours or {}, frame)
        tail = "_".join([tail] * bool(tail) + ["dark"] * dark + ["transparent"] * transparent)
    tail = f"_{tail}" if tail else ""
    ranged = field is not None or view.contours is not None or view.arrows or frame_rate is not None
    if under_way is not None:
        while under_way() and (ranged or _count(out) < FEWEST):
            pass
    results = Results(out, frame=frame, slice=view.slice, solid=True)
    solid = results.dimension == 3 and view.slice is None
    if solid:
        others = {"a field": field, "the mesh": mesh, "particles": particles}
        check_solid(
            shown,
            others | {"a frame rate": frame_rate, "transparent": transparent, "the backend ggui": backend == "ggui"},
        )
    if not solid and shown.camera is not None:
        raise ValueError("a camera looks at flows in 3-D without a slice; leave it out")
    if field is not None:
        results.scene(0).field_values(field)
    if view.contours is not None:
        results.scene(0).field_values(view.contours)
    if ranged:
        view, field_range = settled(view, results.sampled(), field, field_range)
    folder = results.folder / f"frames{tail}"
    files = [results.folder / f"{Path(file).stem}{tail}{Path(file).suffix}" for file in names]

    times, rate = results.times, frame_rate or playback_rate
    if frame_rate is not None:
        last = len(times) - 1
        times = np.interp(np.arange(0, last + 1e-9, playback_rate / frame_rate), np.arange(last + 1), times).tolist()

    def scene_at(number: int) -> Scene:
        scene = results.scene(number) if frame_rate is None else results.scene_at(times[number])
        return scene if title is None else replace(scene, title=title)

    def drawn(numbers: Callable[[], Iterator[int]]) -> Animation:
        """All pictures of these times."""
        lapse = time_lapse(results.times, playback_rate)
        written = []
        with ExitStack() as stack:
            if solid:
                solids = stack.enter_context(SolidRenderer(size, fluid_colours, samples, dark))
                shape, used = solids.size, solids.backend
            else:
                shape = natural_size(scene_at(0), field, view) if size is None else size
                renderer = stack.enter_context(Renderer(shape, backend, fluid_colours, samples, dark, transparent))
                shape, used = renderer.size, renderer.backend
            progress = stack.enter_context(_progress())
            writers: list[MovieWriter] = []
            tracers: Tracers | None = None
            for file in files:
                writers.append(MovieWriter(file, shape, rate))
                stack.callback(writers[-1].discard)
            if frames:
                folder.mkdir(exist_ok=True)
            for i in progress.track(numbers(), total=len(times), description="drawing"):
                if solid:
                    volume = results.volume(i)
                    volume = volume if title is None else replace(volume, title=title)
                    image = solids.frame(volume, view, lapse)
                else:
                    scene = scene_at(i)
                    if view.tracers:
                        if tracers is None:
                            tracers = Tracers(scene, view.tracers, round(TAIL * rate / playback_rate))
                        scene = replace(scene, trails=tracers.advance(scene))
                    image = renderer.frame(scene, field, field_range, mesh, particles, view, lapse)
                if frames:
                    written.append(_write_png(folder / f"frame_{i:04d}.png", image))
                for writer in writers:
                    writer.append(image)
            movies = [writer.finish() for writer in writers]
            muted = (view.muted or ()) if field == MUTED_FIELD else ()
            return Animation(written, movies, used, field_range, muted)

    def as_stored() -> Iterator[int]:
        """The numbers of the stored times, and of those that a run adds."""
        look, first, more = _look(results, playback_rate), 0, under_way is not None
        while True:
            yield from range(first, len(results) if frame_rate is None else len(times))
            first = len(results)
            if not more:
                return
            more = under_way is not None and under_way()
            results.refresh()
            if _look(results, playback_rate) != look or len(results) < first:
                raise _ChangedError

    try:
        done = drawn(as_stored)
    except _ChangedError:
        while under_way is not None and under_way():
            pass
        results.refresh()
        done = drawn(lambda: iter(range(len(results))))
    if frames:
        _remove_beyond(folder, len(done.frames))
    return done


class _ChangedError(Exception):
    """A run has stored times that change how the pictures of earlier ones look."""


def _look(results: Results, playback_rate: float) -> tuple[Any, ...]:
    """Values that pictures take from all stored times."""
    lapse = time_lapse(results.times, playback_rate)
    unit = fitting(float(np.ptp(results.times)), "s")
    return lapse, digits_of(results.times), unit, results.lower.tolist(), results.upper.tolist(), results.title


def _count(out: str | PathLike[str]) -> int:
    """Number of stored times in a results folder."""
    try:
        return len(Results(out, solid=True))
    except ResultsError:
        return 0


def picture_name(
    field: str | None,
    field_range: Range | None,
    mesh: bool,
    particles: bool,
    view: View,
    size: tuple[int, int] | None,
    fluid_colours: Mapping[str, str],
    frame: str = "room",
) -> str:
    """Part of the names of pictures for the options of `animate`, as "speed_streamlines_window_0_0_0.3_0.2".

    Pictures of different options have different names, except for options that change neither what is seen nor its
    scale: the back end, the samples, and the title.
    """

    def numbers(values: Iterable[float]) -> str:
        return "_".join(f"{value:.6g}" for value in values)

    words = [field] if field else []
    words += ["in_the_tank"] * (frame == "tank")
    words += [f"range_{numbers(field_range)}"] if field_range is not None else []
    words += ["all"] * (view.muted == ()) + [f"without_{name}" for name in view.muted or ()]
    words += [view.colour_map] if view.colour_map else []
    words += ["mesh"] * mesh + ["particles"] * particles + ["nofill"] * (not view.fill)
    words += ["edges"] * (view.smooth is False) + ["flat"] * (view.look == "flat")
    words += ["arrows"] * view.arrows
    words += [f"of_{view.arrow_speed:.6g}"] if view.arrows and view.arrow_speed else []
    words += ["streamlines"] * view.streamlines
    words += [f"contours_{view.contours}"] if view.contours else []
    words += [f"every_{view.interval:.6g}"] if view.contours and view.interval else []
    words += [f"tracers_{view.tracers}"] if view.tracers else []
    words += [f"window_{numbers(view.window)}"] if view.window is not None else []
    words += [f"follow_{view.follow}"] if view.follow else []
    words += [view.slice] if view.slice else []
    words += [f"camera_{numbers(view.camera)}"] if view.camera else []
    words += [f"{size[0]}x{size[1]}"] if size is not None else []
    words += [f"{fluid}={code.lstrip('#')}" for fluid, code in sorted(fluid_colours.items())]
    # Names of fluids and fields may hold anything.
    return re.sub(r"[^\w.=+-]+", "-", "_".join(words))


def time_lapse(times: Sequence[float], playback_rate: float) -> str:
    """Rate of times (K,) [s] played at so many per second, as "10 times slower", "real time"; "" for uneven times."""
    apart = np.diff(times)
    if not len(apart) or apart.max() > 1.5 * np.median(apart):
        return ""
    pace = float(np.median(apart)) * playback_rate
    told = f"{max(pace, 1 / pace):.2g}"
    return "real time" if told == "1" else f"{float(told):g} times {'slower' if pace < 1 else 'faster'}"


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
