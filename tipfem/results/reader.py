"""Read results: what a run has left in its folder, or has written so far."""

from __future__ import annotations

import dataclasses
import json
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tipfem.arguments import is_number, path_of
from tipfem.notebook import Movie, facts
from tipfem.results.fields import FieldOutput, FieldState, vtkhdf, vtu, walls
from tipfem.results.fields.catalogue import FIELDS, STORED, three_components
from tipfem.results.fields.field_state import VTK_CELLS, StoredState
from tipfem.results.folder_lock import FolderLock
from tipfem.results.history_columns import contents_of, history_columns
from tipfem.results.output import MANIFEST, listed
from tipfem.results.remeshing_table import Sums, remeshing_sums, remeshing_table
from tipfem.results.steered import Laws
from tipfem.results.tables import Table, package
from tipfem.typing import Array

FORMAT = 1
# Units of the history's columns; in 2-D, budgets are per metre of depth.


def read_results(out: str | Path) -> RunResults:
    """The results in a folder; of a run that is finished, still going, or was interrupted.

    Args:
        out: the results folder of a run.

    Raises:
        ValueError: it is none; the message names the file and says what would be right.
    """
    return RunResults(out)


class RunResults:
    """Results of a run in its folder, complete or written so far; see `read_results`.

    Nothing but case.json is read before it is asked for. Stored states are numbered: ``len(results)`` is how many
    there are, ``results[-1]`` the last.

    Args:
        out: the results folder.

    Attributes:
        folder: its path.
        case: content of case.json.
    """

    def __init__(self, out: str | Path) -> None:
        self.folder = path_of("read_results: out", out)
        if not self.folder.is_dir():
            raise ValueError(f"{self.folder}: there is no such folder; give the results folder of a run")
        case = self._json("case.json")
        if case is None:
            raise ValueError(f"{self.folder}: it has no case.json and is no results folder; give that of a run")
        if case.get("format") != FORMAT or case.get("dimension") not in (2, 3):
            text = f"{self.folder / 'case.json'}: format {case.get('format')!r} in {case.get('dimension')!r} "
            raise ValueError(f"{text}dimensions; it must be format {FORMAT} in 2 or 3")
        self.case = case
        self.dimension = int(case["dimension"])

    def refresh(self) -> RunResults:
        """Forget what has been read, of a run that has gone on; returns itself."""
        for name in ("history", "probes", "summary", "_stored"):
            self.__dict__.pop(name, None)
        return self

    @cached_property
    def history(self) -> Table:
        """One row per step, with units, and which columns are of a step; see their table in the documentation."""
        table = Table.read(self.folder / "history.csv")
        moving = [one["name"] for one in walls.rigid(self.case)]
        contents = contents_of(self.dimension, self.case.get("coordinates", "planar"))
        columns = history_columns(table, contents, self.fluids, moving)
        units = {name: column.unit for name, column in columns.items() if column.unit}
        return Table(table, units, table.name, [name for name, column in columns.items() if column.of_step])

    @cached_property
    def probes(self) -> dict[str, Table]:
        """Measurements of the probes, by their names, with units."""
        return _Probes({path.stem: Table.read(path) for path in sorted((self.folder / "probes").glob("*.csv"))})

    @cached_property
    def summary(self) -> dict[str, Any]:
        """Content of summary.json: settings, versions, status and figures; empty before the run has ended."""
        return self._json("summary.json") or {}

    def remeshing_sums(self) -> Sums:
        """Sums of energy and momentum that each kind of repair of the mesh added: by fluid, kind and quantity [J, N s].

        Empty for a run without ``Numerics(budget="detailed")``.
        """
        return remeshing_sums({name: float(values.sum()) for name, values in self.history.items()})

    def remeshing_table(self) -> str:
        """The same as a text in columns, to be printed."""
        return remeshing_table(self.remeshing_sums())

    @property
    def status(self) -> str:
        """Status of the run: "running", "complete", "interrupted" and others from the summary, or "no summary"."""
        if FolderLock(self.folder).is_held():
            return "running"
        return str(self.summary.get("status", "no summary: killed, or not started"))

    @property
    def times(self) -> Array:
        """(K,) stored times [s]."""
        return np.array([time for _, time, _ in self._stored])

    @property
    def fluids(self) -> list[str]:
        """Names of the fluids, in the order of their numbers."""
        return [str(fluid["name"]) for fluid in self.case["fluids"]]

    def __len__(self) -> int:
        return len(self._stored)

    def __getitem__(self, number: int) -> FieldState:
        """A stored state, by its number.

        Raises:
            IndexError: there is none of that number.
            ValueError: its file cannot be read; the message names it.
        """
        if not isinstance(number, int | np.integer) or not -len(self) <= number < len(self):
            raise IndexError(f"stored state {number!r}: {self.folder} has {len(self)}, numbered from 0")
        step, time, _ = self._stored[number]
        state = self.stored(int(number)).fields(step, time)
        period = self.case.get("period")
        return dataclasses.replace(
            state,
            laws=Laws(self.case, self.folder).at(time),
            period=None if period is None else np.asarray(period, float),
            spacing=float(self.case["spacing"]),
            axial=self.case.get("coordinates") == "axisymmetric",
        )

    def stored(self, number: int) -> StoredState:
        """A stored state as its file has it; see `__getitem__`."""
        place = self._stored[number][2]
        if isinstance(place, Path):
            return vtu.read(place, self.dimension)
        return vtkhdf.read(self.folder / vtkhdf.NAME, place, self.dimension)

    @property
    def files(self) -> list[Path]:
        """The files of the stored times, in their order: VTU files, or as often fields.vtkhdf."""
        return [place if isinstance(place, Path) else self.folder / vtkhdf.NAME for *_, place in self._stored]

    def __iter__(self) -> Iterator[FieldState]:
        return (self[number] for number in range(len(self)))

    def at(self, time: float, *, tolerance: float | None = None) -> FieldState:
        """The stored state nearest to a time.

        Args:
            time: [s].
            tolerance: how far from it the state may be [s]; any distance by default, 0 for none but round-off.

        Raises:
            ValueError: there is none, none so near, or its file cannot be read.
        """
        if not len(self):
            raise ValueError(f"{self.folder}: no fields have been written; `run` writes them, `step` does not")
        if not is_number(time):
            raise ValueError(f"time is {time!r} s; it must be a number")
        if tolerance is not None and not (is_number(tolerance) and tolerance >= 0):
            raise ValueError(f"tolerance is {tolerance!r} s; it must be a number >= 0, or None for any distance")
        times = self.times
        number = int(np.argmin(np.abs(times - time)))
        off = abs(times[number] - time)
        if tolerance is not None and not off <= tolerance + 1e-8 * abs(time):
            text = f"{self.folder}: no state is stored at t = {time:g} s; the nearest is at {times[number]:g} s, and "
            raise ValueError(f"{text}there are {len(times)} from {times[0]:g} to {times[-1]:g} s")
        return self[number]

    def mean(self, field: str, places: Any, start: float = -math.inf, end: float = math.inf) -> Array:
        """Means over time of a field at places that stand still, over the times at which a fluid is there.

        Of the stored states, by the trapezoidal rule; NaN where there never is a fluid.

        Args:
            field: see `FieldState.field`.
            places: (K, d) [m].
            start, end: first and last time [s].

        Returns:
            (K,), or (K, d) of a vorticity in 3-D.

        Raises:
            ValueError: no state is stored between these times; see `FieldState.at`.
        """
        numbers = np.flatnonzero((self.times >= start) & (self.times <= end))
        if not len(numbers):
            raise ValueError(f"{self.folder}: none of {len(self)} stored states is from {start:g} to {end:g} s")
        times = self.times[numbers]
        lengths = np.diff(times) if len(times) > 1 else np.ones(1)
        shares = np.convolve(lengths, [0.5, 0.5]) if len(times) > 1 else lengths
        total = known = np.zeros(1)
        for number, share in zip(numbers, shares, strict=True):
            values = self[int(number)].at(field, places)
            total = total + share * np.nan_to_num(values)
            known = known + share * np.isfinite(values)
        return np.asarray(np.divide(total, known, out=np.full_like(total, np.nan), where=known > 0))

    def to_pyvista(self, time: float) -> Any:
        """The stored state nearest to a time, as a `pyvista.UnstructuredGrid`.

        Args:
            time: [s].

        Raises:
            ImportError: pyvista is not installed.
            ValueError: see `at`.
        """
        pyvista = package("pyvista", "to_pyvista")
        state = self.at(time)
        corners = state.dimension + 1
        cells = [
            np.column_stack([np.full(len(part), width), part.reshape(len(part), width)]).ravel()
            for part, width in ((state.cells, corners), (state.loose, 1))
        ]
        types = np.repeat([VTK_CELLS[corners], VTK_CELLS[1]], [len(state.cells), len(state.loose)])
        grid = pyvista.UnstructuredGrid(np.concatenate(cells), types, three_components(state.position))
        for name, values in state.point_data("f8").items():
            grid.point_data[name] = values
        if state.cell_fluid is not None:
            grid.cell_data["fluid"] = np.concatenate([state.cell_fluid, state.fluid[state.loose]])
        grid.field_data["time"] = [state.time]
        return grid

    def to_xarray(self, time: float | None = None) -> Any:
        """The stored state nearest to a time, or without one the history, as an `xarray.Dataset`.

        Args:
            time: [s].

        Raises:
            ImportError: xarray is not installed.
            ValueError: see `at`.
        """
        if time is None:
            return self.history.to_xarray()
        xarray = package("xarray", "to_xarray")
        state = self.at(time)
        data: dict[str, Any] = {"position": (("particle", "axis"), state.position, {"units": "m"})}
        for name, kind in STORED.items():
            unit = FIELDS[name].unit.replace("^", "")
            of = ("particle", "axis") if kind.vector else "particle"
            data[name] = of, getattr(state, name), {"units": unit} if unit else {}
        data["cells"] = ("cell", "corner"), state.cells
        if state.cell_fluid is not None:
            data["cell_fluid"] = ("cell", state.cell_fluid)
        axes = list("xyz"[: state.dimension])
        return xarray.Dataset(data, {"axis": axes}, {"time": state.time, "step": state.step})

    def picture(self, time: float, field: str | None = None, **options: Any) -> Any:
        """The stored state nearest to a time as a picture, a `PIL.Image.Image`.

        Args:
            time: [s].
            field: to colour by: pressure, speed, density ...; the fluids by default.
            options: see `tipfem.render.render_frame`; the attributes of its `tipfem.render.View` may be given, too:
                ``streamlines=True``, or in 3-D ``slice="y=0.5"``.

        Raises:
            ValueError: see `at`; or the state cannot be drawn.
        """
        from PIL import Image

        from tipfem.render import Results, View, render_frame

        if not is_number(time):
            raise ValueError(f"time is {time!r} s; it must be a number")
        options = _with_view(options)
        view = options.pop("view", None) or View()
        drawn = Results(self.folder, slice=view.slice, solid=True)
        number = int(np.argmin(np.abs(np.array(drawn.times) - time)))
        if drawn.dimension == 3 and view.slice is None:
            return Image.fromarray(render_frame(drawn.volume(number), field=field, view=view, **options))
        view = view.for_files(field, options.get("mesh", False), options.get("particles", False))
        return Image.fromarray(render_frame(drawn.scene(number), field=field, view=view, **options))

    def movie(self, field: str | None = None, name: str = "animation.mp4", **options: Any) -> Movie:
        """A movie of all stored states, in the results folder; notebooks show it.

        Args:
            field: see `picture`.
            name: of the file: .mp4, .gif or .webp; the field's name is added to it.
            options: see `tipfem.render.animate`, and as for `picture`.

        Raises:
            ValueError: see `tipfem.render.animate`.
            OSError: it cannot be written.
        """
        from tipfem.render import animate

        return Movie(animate(self.folder, field, frames=False, movie=name, **_with_view(options)).movies[0])

    def __repr__(self) -> str:
        return f"RunResults({str(self.folder)!r}): " + ", ".join(f"{key} {value}" for key, value in self._facts())

    def _repr_html_(self) -> str:
        return facts(f"Results in {self.folder}", dict(self._facts()))

    def _facts(self) -> list[tuple[str, str]]:
        times, history = self.times, self.history
        until = f" to t = {history['time'][-1]:g} s" if history.rows else ""
        return [
            ("case", self.case.get("title") or "without a title"),
            ("status", self.status),
            ("steps", f"{history.rows}{until}"),
            ("stored states", f"{len(times)}" + (f" from {times[0]:g} to {times[-1]:g} s" if len(times) else "")),
            ("fluids", ", ".join(self.fluids)),
            ("probes", ", ".join(self.probes) or "none"),
        ]

    @cached_property
    def _stored(self) -> list[tuple[int, float, Path | int]]:
        """Step, time [s] and place of each stored state: a VTU file, or its number in the VTKHDF file."""
        listing = self.folder / "fields.pvd"
        if listing.is_file():
            try:
                sets = [
                    (float(one.attrib["timestep"]), one.attrib["file"])
                    for one in ElementTree.parse(listing).iter("DataSet")
                ]
                found: list[tuple[int, float, Path | int]] = [
                    (int(Path(name).stem.split("_")[-1]), time, self.folder / name) for time, name in sets
                ]
                return sorted(found, key=lambda entry: entry[:2])
            except (ElementTree.ParseError, KeyError, ValueError) as error:
                text = f"{listing}: not a collection of ParaView that tipfem has written ({error}); remove it and the "
                raise ValueError(f"{text}states are read from {vtkhdf.NAME}, if there is one") from None
        if (self.folder / vtkhdf.NAME).is_file():
            steps, times = vtkhdf.times(self.folder / vtkhdf.NAME)
            return [(step, float(time), number) for number, (step, time) in enumerate(zip(steps, times, strict=True))]
        return []

    def _json(self, name: str) -> dict[str, Any] | None:
        path = self.folder / name
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, RecursionError) as error:
            raise ValueError(f"{path}: it cannot be read ({error}); it may be damaged, or of another program") from None
        if not isinstance(content, dict):
            raise ValueError(f"{path}: it must hold a JSON object; it may be of another program")
        return content


class _Probes(dict[str, Table]):
    """Tables by the names of probes; one that is not there is told with those that are."""

    def __missing__(self, name: str) -> Table:
        raise KeyError(f"there is no probe {name!r}; there are: {', '.join(self) or 'none'}")


def _with_view(options: dict[str, Any]) -> dict[str, Any]:
    """Options of pictures, those that are attributes of a `tipfem.render.View` put into one."""
    from tipfem.render import View

    names = {one.name for one in dataclasses.fields(View)} & options.keys()
    rest = {name: value for name, value in options.items() if name not in names}
    if names:
        view = rest.get("view") or View()
        rest["view"] = dataclasses.replace(view, **{name: options[name] for name in names})
    return rest


def to_vtkhdf(
    out: str | Path,
    *,
    precision: Literal["double", "single"] = "double",
    compression: int = 4,
    quantities: Sequence[str] = (),
) -> Path:
    """Write all stored states of a results folder into one VTKHDF file there, fields.vtkhdf.

    Args:
        out: the results folder.
        precision: "double" or "single", see `FieldOutput`.
        compression: 0 to 9, see `FieldOutput`.
        quantities: names of fields that are computed and written besides, see `FieldOutput`.

    Returns:
        Path of the file.

    Raises:
        ValueError: the folder holds no states, a file in it cannot be read, a run is writing into it, or an argument is
            out of range.
        OSError: the file cannot be written.
    """
    output = FieldOutput(format="both", precision=precision, compression=compression, quantities=quantities)
    results = RunResults(out)
    output.require_laws(Laws(results.case, results.folder).at(np.inf))
    path = results.folder / vtkhdf.NAME
    if results.status == "running":
        raise ValueError(f"{out}: a run is writing into it; convert its results when it has ended")
    if not len(results):
        raise ValueError(f"{out}: no fields have been written; `run` writes them, `step` does not")
    if vtkhdf.NAME not in listed(results.folder):  # so that a later run in the folder may remove it
        with open(results.folder / MANIFEST, "a", encoding="utf-8") as file:
            file.write(vtkhdf.NAME + "\n")
    vtkhdf.write(path, results, output)
    return path
