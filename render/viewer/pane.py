"""One source in a viewer: its pictures, the ranges of its fields, tracers, and histories at points."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from tipfem.render import Renderer, Results, Scene, View
from tipfem.render.colours import HALO, INTERFACE, SUBTLE, dot_colours, dot_colours_on_field, fluid_colours, hex_code
from tipfem.render.flow import Tracers, arrow_speed
from tipfem.render.interface import particle_fluids
from tipfem.render.layers import is_muted, layers_of
from tipfem.render.openings import COLOURS as OPENING_COLOURS
from tipfem.render.openings import Gap, rows_of
from tipfem.render.outlines import Loop, background_fluid, picture_loops, thin_solids, turning_marks
from tipfem.render.scales import MUTED_FIELD, MUTED_SHARE, FieldSample, colour_map_of, muted_fluids, round_limits
from tipfem.render.viewer.choices import Choices
from tipfem.render.viewer.films import Picture, Scanner, told_of_film
from tipfem.render.viewer.packing import fluid_looks, packed, packed_cells, packed_lines
from tipfem.render.viewer.probe import values_at
from tipfem.render.viewer.share import STATES_PER_SECOND, assembled, folder_page, told_of_states
from tipfem.render.viewer.source import PICTURE, PREPARED, Source

from tipfem.results.fields.catalogue import FIELDS
from tipfem.typing import Array

LAYER_PIXEL = 0.9  # a design pixel of layers, in CSS pixels
PALE = 0.62  # share of the ground in fluids under particles
FILMED = "speed"  # field of a run that pages offer where none is shown
FILMED_EVERY = 0.1  # seconds between its pictures, which pages blend
MOST_SEEN = 3000  # states of a run that are kept to be shared
_SAMPLED = 24  # stored times that a fixed range is taken from
_COLOURED = "pressure of the fluids that are coloured"
_HISTORY_POINTS = 200

Range = tuple[float, float]


class Pane:
    """One source in a viewer."""

    def __init__(self, source: Source, backend: str) -> None:
        self.source = source
        first = source.scene(0)
        self.lower, self.upper = first.lower, first.upper
        self._backend = backend
        self._renderers: dict[bool, Renderer] = {}  # of light pictures and of dark ones
        self._ends: dict[str, Range] = {}  # of fields; of the pressure of coloured fluids as _COLOURED
        self._samples: dict[int, dict[str, FieldSample]] = {}  # of stored times, until ranges are settled
        self._settled_for = 0  # number of stored times that the ranges have been settled for
        self._beside: Pane | None = None
        self._spans: dict[str, Range] = {}
        self._joined: set[int] = set()  # stored times that are in these spans
        self._arrow_speed: tuple[Any, float] = (None, 0.0)
        self._sampled: set[int] = set()
        self._tracers: Tracers | None = None
        self._tracer_count = 0
        self._trails: list[Array] = []
        self._first: tuple[Scene, int | None] | None = None  # that has been seen of a run, and the fluid behind all
        self._seen: deque[tuple[float, list[list[Loop]], tuple[Gap, ...]]] = deque(maxlen=MOST_SEEN)
        self._filmed: deque[dict[str, Picture]] = deque(maxlen=MOST_SEEN)  # fields of these states
        self._scanner: Scanner | None = None
        self._film, self._taken = FILMED, -math.inf
        self._outlines: dict[tuple[int, float], tuple[dict[str, Any], bytes]] = {}  # of stored times

    def scene(self, index: int, choices: Choices) -> Scene:
        """The state at a stored time, with tracers if they are wanted and known."""
        scene = self.source.scene(index)
        if choices.layers["tracers"]:
            scene = self._with_trails(scene, index, choices.layers["tracers"])
        if MUTED_FIELD in (choices.field, choices.layers["contours"]):
            self._join_spans(scene, index)
        if choices.field is not None:
            self._widen(choices.field, scene)
        return scene

    def vectors(self, index: int, choices: Choices) -> tuple[dict[str, Any], bytes]:
        """Entry of a stored time in the frame's message, and bytes from which a page draws it.

        These are the cells, where a field or the mesh is seen, the lines of layers, and outlines. `ValueError` if a
        field cannot be drawn.
        """
        self._film = choices.field or FILMED
        head, outlines = self.outlines(index)
        if choices.bare:
            return {**head, "smooth": choices.smooth, "bytes": len(outlines)}, outlines
        scene, layers = self.scene(index, choices), choices.layers
        view = self._settled(choices.view(), scene, choices)
        field = choices.field if layers["fill"] else None
        fills = fluid_colours(scene.fluid_names, scene.fluid_densities)
        dots = dot_colours(fills) if field is None else dot_colours_on_field(fills)
        fade = 1.0 if not layers["fill"] else PALE * (layers["particles"] and field is None)
        muted = (view.muted or ()) if choices.field == MUTED_FIELD else ()
        entry = {**head, "smooth": choices.smooth, "muted": muted, "fade": fade}
        cut = field is None and scene.cell_fluid is None  # by its interfaces, which edges of cells are not
        data: list[bytes] = []
        if field is not None or (layers["mesh"] and not cut):
            plain = np.full(len(scene.cells), field is None)
            if field == MUTED_FIELD:
                low, high = self.field_range(scene, choices) or (0.0, 1.0)
                plain = is_muted(scene, view, MUTED_SHARE * (high - low))
            cells, bytes_ = packed_cells(scene, field, plain)
            entry["cells"] = {**cells, "bytes": len(bytes_), "mesh": layers["mesh"]}
            data.append(bytes_)
        lower, upper = view.bounds(scene)
        if choices.follow is not None:
            entry["window"] = [*lower.tolist(), *upper.tolist()]
        pixel = LAYER_PIXEL * max((upper - lower) / (choices.width, choices.height))
        ground = (view.colour_map or colour_map_of(field)) if field is not None and not muted else None
        there = layers_of(scene, slice(None), lower, upper, pixel, view, ground)
        lines = [(layer.kind, layer.key.line, layer.key.rim, layer.paths) for layer in there]
        if layers["mesh"] and cut:
            lines.insert(0, ("mesh", SUBTLE, HALO, scene.position[scene.geometry.edges.pairs]))
        if layers["particles"]:
            lines = [*_beads(scene, dots), *lines]
        entry["lines"], bytes_ = packed_lines(lines, scene.lower)
        entry["notes"] = [
            key.text if key.length is None else f"arrows: {key.length * pixel:.2g} m long at {key.text}"
            for _, _, key in there
        ]
        if layers["tracers"] and scene.trails is None:
            entry["notes"].append("tracers: following them from the first time")
        data += [bytes_, outlines]
        return {**entry, "bytes": sum(map(len, data))}, b"".join(data)

    def outlines(self, index: int) -> tuple[dict[str, Any], bytes]:
        """The outlines of a stored time for `vectors`."""
        times = self.source.times
        key = None if self.source.live else (index, times[index])
        found = self._outlines.get(key) if key is not None else None
        if found is None:
            scene = self.source.scene(index)
            behind = background_fluid(scene)
            drawn = picture_loops(scene, behind)
            self._keep(scene, behind, drawn)
            found = _told(scene, index, behind, drawn)
            if key is not None:
                self._outlines[key] = found
        return found

    def prepare(self, index: int) -> Callable[[], None] | None:
        """Function that makes the outlines of one of the times to be shown next; None if there are none to be made.

        It may be called in another thread, as long as nothing else does.
        """
        times, reading = self.source.times, getattr(self.source, "reading", None)
        following = range(index, min(index + PREPARED, len(times)))
        missing = next((k for k in following if (k, times[k]) not in self._outlines), None)
        if missing is None or reading is None:
            return None
        return partial(self._make, (missing, times[missing]), reading(missing))

    def _make(self, key: tuple[int, float], read: Callable[[], Scene]) -> None:
        scene = read()
        behind = background_fluid(scene)
        self._outlines[key] = _told(scene, key[0], behind, picture_loops(scene, behind))

    def page(self, choices: Choices) -> Callable[[], str]:
        """Function that makes the page to share, of a results folder, or of the states seen; it may take a while.

        Of a run it has the fields that were shown, or `FILMED` while none was. `ValueError` if nothing has been seen.
        """
        if not self.source.live:
            folder = getattr(self.source, "folder", None)
            if folder is None:
                raise ValueError("share: there is no results folder")
            fields, dark = [] if choices.field is None else [choices.field], choices.dark
            return lambda: folder_page([Results(folder)], fields, dark)[1]
        if self._first is None:
            raise ValueError("share: nothing has been seen of the run yet")
        (first, behind), states, pictures = self._first, list(self._seen), list(self._filmed)
        passed = states[-1][0] - states[0][0]
        rate = (len(states) - 1) / passed if passed > 0 else STATES_PER_SECOND
        still = first.tank is None or not self.source.scene(-1).tank.moved
        title = self.source.title or self.source.name
        fields = sorted(set().union(*pictures), key=lambda field: (field != choices.field, field))
        opens = fields.index(choices.field) if choices.field in fields else -1

        def made() -> str:
            facts, poster, data = told_of_states(first, behind, states, title, still, dark=choices.dark, rate=rate)
            films = [self._told_of_film(field, pictures, first.fluid_names) for field in fields]
            facts |= {"fields": [film for film, _ in films], "opens": opens}
            page: str = assembled([facts], poster, data + b"".join(data for _, data in films))
            return page

        return made

    def _keep(self, scene: Scene, behind: int | None, drawn: list[list[Loop]]) -> None:
        """Keep what is seen of a run, for `page`; one that goes back loses what came later."""
        if not self.source.live:
            return
        while self._seen and self._seen[-1][0] >= scene.time:
            self._seen.pop()
            self._filmed.pop()
        if self._first is None or self._first[1] != behind or not self._seen:
            self._first = scene, behind
            self._seen.clear()
            self._filmed.clear()
        if self._scanner is None:
            self._scanner = Scanner(scene.lower, scene.upper, self.source.spacing)
        self._seen.append((scene.time, drawn, scene.openings))
        due = self._film in scene.fields and time.monotonic() - self._taken >= FILMED_EVERY
        self._filmed.append({self._film: self._scanner.picture(scene, self._film)} if due else {})
        if due:
            self._taken = time.monotonic()

    def _told_of_film(
        self, field: str, pictures: Sequence[dict[str, Picture]], names: Sequence[str]
    ) -> tuple[dict[str, Any], bytes]:
        """Facts and bytes of a field of a run, see `told_of_film`."""
        assert self._scanner is not None, "it has taken the pictures"
        taken = [each.get(field, (0.0, 0.0, b"")) for each in pictures]
        seen = [(low, high) for low, high, data in taken if data]
        low, high = round_limits(field, min(low for low, _ in seen), max(high for _, high in seen))
        plain = [list(names).index(name) for name in muted_fluids(self._spans)] if field == MUTED_FIELD else []
        facts, data = told_of_film(field, self._scanner.box, (float(low), float(high)), plain, taken)
        return facts, data

    def framed(self, index: int, choices: Choices) -> Array:
        """The picture of a stored time with axes and legend, to keep; (H, W, 3) uint8."""
        scene = self.scene(index, choices)
        if choices.dark not in self._renderers:
            self._renderers[choices.dark] = Renderer(PICTURE, self._backend, dark=choices.dark)
        colours, looks = self.field_range(scene, choices), choices.layers
        beside = looks["mesh"], looks["particles"], self._settled(choices.view(framed=True), scene, choices)
        return np.asarray(self._renderers[choices.dark].frame(scene, choices.field, colours, *beside))

    def field_range(self, scene: Scene, choices: Choices) -> Range | None:
        """The range of the colours, or None without a field."""
        field = choices.field
        if field is None:
            return None
        if choices.range_mode == "given":
            given: Range | None = choices.given
            return given
        coloured = field == MUTED_FIELD and not choices.layers["colour_all"]
        name = _COLOURED if coloured else field
        if choices.range_mode == "fixed" and name in self._ends:
            found = [pane._ends[name] for pane in (self, self._beside) if pane is not None and name in pane._ends]
            low, high = round_limits(field, min(low for low, _ in found), max(high for _, high in found))
        else:
            low, high = FieldSample([scene], field).limits(muted_fluids(self._spans) if coloured else ())
        return float(low), float(high)

    def share_ranges(self, other: Pane) -> None:
        """Widen fixed ranges by those of another pane, so that both have the same colours."""
        self._beside = other

    def fields(self) -> list[str]:
        """Names of the fields, the usual ones first."""
        there = self.source.scene(-1).fields
        return [name for name in FIELDS if name in there] + sorted(set(there) - set(FIELDS))

    def sampling(self) -> Iterator[bool]:
        """Look at stored times for the ranges of all fields, one at each step; says whether a range has changed.

        At the end the ranges are those of `tipfem.render.animate`, which looks at the same times.
        """
        count = len(self.source.times)
        chosen = sorted({int(i) for i in np.linspace(0, count - 1, min(count, _SAMPLED)).round()})
        for index in chosen:
            if index not in self._sampled and not self.source.live:
                self._sampled.add(index)
                before = dict(self._ends), muted_fluids(self._spans)
                scene = self.source.scene(index)
                if MUTED_FIELD in scene.fields:
                    self._join_spans(scene, index)
                for field in scene.fields:
                    self._widen(field, scene)
                self._samples[index] = {field: FieldSample([scene], field) for field in scene.fields}
                yield before != (self._ends, muted_fluids(self._spans))
        if self._samples and set(chosen) <= set(self._samples):
            before = dict(self._ends), muted_fluids(self._spans)
            self._settle([self._samples[index] for index in chosen], count)
            yield before != (self._ends, muted_fluids(self._spans))

    def history(self, at: tuple[float, float]) -> Iterator[tuple[list[float], dict[str, list[float | None]], float]]:
        """Times [s], lists of values by field at a point [m], and the share done, which grows with each step."""
        count = len(self.source.times)
        times: list[float] = []
        values: dict[str, list[float | None]] = {}
        chosen = sorted({int(i) for i in np.linspace(0, count - 1, min(count, _HISTORY_POINTS)).round()})
        for number, index in enumerate(chosen):
            scene = self.source.scene(index)
            found, _ = values_at(scene, at)
            for name in scene.fields:
                value = found.get(name)
                column = values.setdefault(name, [None] * len(times))
                column.append(value if value is not None and np.isfinite(value) else None)
            times.append(scene.time)
            yield times, values, (number + 1) / len(chosen)

    def tracing(self, index: int, choices: Choices) -> bool | None:
        """Move the tracers one stored time on; whether they have come to an index, None if before or not wanted."""
        count = choices.layers["tracers"]
        if not count:
            return None
        if count != self._tracer_count or self._tracers is None:
            self._tracers, self._tracer_count, self._trails = None, count, []
        if len(self._trails) > index:
            return None
        self._advance_tracers(self.source.scene(len(self._trails)))
        return len(self._trails) > index

    def hello(self) -> dict[str, Any]:
        """Facts of the flow for the message `hello`."""
        fluids = fluid_looks(self.source.fluid_names, self.source.fluid_densities)
        return {"solid": None, "fluids": fluids, "solids": thin_solids(self.source.scene(0))}

    def close(self) -> None:
        """Free the buffers and the source."""
        for renderer in self._renderers.values():
            renderer.close()
        if self._scanner is not None:
            self._scanner.close()
        self.source.close()

    def _settle(self, samples: list[dict[str, FieldSample]], count: int) -> None:
        """Take fixed ranges and muted fluids from samples by field of stored times, of which there are ``count``."""
        for field in set.intersection(*(set(by_field) for by_field in samples)):
            sample = FieldSample.joined([by_field[field] for by_field in samples])
            self._ends[field] = sample.ends()
            if field == MUTED_FIELD:
                self._spans = sample.spans()
                self._ends[_COLOURED] = sample.ends(sample.muted())
        self._samples, self._settled_for = {}, count

    def _widen(self, field: str, scene: Scene) -> None:
        """Widen the range of a field by that of a scene, unless it has been settled for all stored times."""
        if field not in scene.fields or self._settled_for == len(self.source.times):
            return
        sample = FieldSample([scene], field)
        found = {field: sample.ends()}
        if field == MUTED_FIELD:
            found[_COLOURED] = sample.ends(muted_fluids(self._spans))
        for name, (low, high) in found.items():
            lowest, highest = self._ends.get(name, (low, high))
            self._ends[name] = min(low, lowest), max(high, highest)

    def _join_spans(self, scene: Scene, index: int) -> None:
        """Widen the pressures that decide which fluids are muted by those of a further time."""
        if index in self._joined or self._settled_for == len(self.source.times):
            return
        if not self.source.live:
            self._joined.add(index)
        for name, (low, high) in FieldSample([scene], MUTED_FIELD).spans().items():
            lowest, highest = self._spans.get(name, (low, high))
            self._spans[name] = min(low, lowest), max(high, highest)

    def _settled(self, view: View, scene: Scene, choices: Choices) -> View:
        """A view with the muted fluids, and the arrows' scale, of the times that have been looked at.

        The scale is that of the fastest of these times as long as the same part is shown, so that arrows can be
        compared from time to time; in another part it begins anew.
        """
        if view.muted is None:
            view = replace(view, muted=muted_fluids(self._spans))
        if view.arrows:
            part = (choices.window, choices.follow)
            before = self._arrow_speed[1] if self._arrow_speed[0] == part else 0.0
            self._arrow_speed = part, max(before, arrow_speed([scene], view))
            view = replace(view, arrow_speed=self._arrow_speed[1])
        return view

    def _with_trails(self, scene: Scene, index: int, count: int) -> Scene:
        if self.source.live:
            if self._tracers is None or self._tracer_count != count:
                self._tracers, self._tracer_count = Tracers(scene, count), count
            return replace(scene, trails=self._tracers.advance(scene))
        known = count == self._tracer_count and index < len(self._trails)
        return replace(scene, trails=self._trails[index]) if known else scene

    def _advance_tracers(self, scene: Scene) -> None:
        if self._tracers is None:
            self._tracers = Tracers(scene, self._tracer_count)
        self._trails.append(self._tracers.advance(scene))


def _told(scene: Scene, index: int, behind: int | None, drawn: list[list[Loop]]) -> tuple[dict[str, Any], bytes]:
    """The entry of a frame's message, and the bytes, of the outlines of a stored time."""
    size = float((scene.upper - scene.lower).max())
    lower, scale = scene.lower - size, 3 * size / (2.0**32 - 1) * np.ones(2)
    entry = {
        "time": scene.time,
        "index": index,
        "notes": [],
        "muted": [],
        "lower": lower.tolist(),
        "scale": scale.tolist(),
        "behind": behind,
        "openings": rows_of(scene.openings),
        "marks": OPENING_COLOURS,
        "turns": turning_marks(scene),
        "still": scene.tank is None or not scene.tank.moved,
    }
    return entry, b"".join(packed(loops, lower, scale, wide=True) for loops in drawn)


def _beads(scene: Scene, dots: Array) -> list[tuple[str, str, str, Array]]:
    """The particles as layers of single points, by the colours (F, 3) of their fluids; those of interfaces are dark."""
    fluid, between = scene.fluid, np.zeros(len(scene.position), bool)
    if scene.cell_fluid is not None:
        fluid, between = particle_fluids(scene.cells, fluid, scene.cell_fluid)
    own = ~between & ~scene.geometry.loose[1]
    chosen = [(hex_code(dot), own & (fluid == number)) for number, dot in enumerate(dots)] + [(INTERFACE, between)]
    return [("particles", colour, HALO, scene.position[mask][:, None]) for colour, mask in chosen]
