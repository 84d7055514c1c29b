"""Output: a results folder with the history, the fields over time, and a summary.

    case.json       what was simulated: fluids, walls' box, spacing
    history.csv     one row per step, SI units
    fields.pvd      the fields over time, for ParaView; fields/step_*.vtu
    walls.pvd       walls, and what is rigid between them, as lines, in three dimensions as faces; walls/step_*.vtu
    fields.vtkhdf   the fields in one file, see `tipfem.results.fields.FieldOutput`
    summary.json    settings, versions, and figures of the whole run
    probes/*.csv    what probes have measured; checkpoints/*.h5
    steering.jsonl  commands given to the run, see `tipfem.run.steering`
    .tipfem         names of these files: a later run in the folder removes them, and nothing else

Every file but the history, which grows row by row, is written under another name and then renamed:
so no reader sees a partial file, even when the disk is full.
"""

from __future__ import annotations

import csv
import json
import logging
import platform
from collections.abc import Callable, Collection, Mapping, Sequence
from datetime import timedelta
from importlib.metadata import version
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from tipfem.arguments import path_of
from tipfem.case.particles import Particles
from tipfem.errors import FolderRefused
from tipfem.logs import log
from tipfem.mesh.mesh import Mesh
from tipfem.results.fields import FieldOutput, FieldState, vtkhdf, vtu, walls
from tipfem.results.fields.atomic_file import journal_of
from tipfem.results.folder_lock import FolderLock
from tipfem.results.tables import last_row
from tipfem.results.whole_file import replaced
from tipfem.typing import Array

CASE_FILE = "case.toml"  # the whole case
MANIFEST = ".tipfem"
SHORT = 600.0  # wall-clock time of a run whose results a later one in the folder replaces unasked [s]
# What every run writes besides its fields; a file of such a name that is not in the manifest is not tipfem's.
_NAMES = ("case.json", "history.csv", "summary.json", "fields.pvd", "walls.pvd", vtkhdf.NAME, "steering.jsonl")


def listed(folder: Path) -> list[str]:
    """The names in the manifest of a folder; none without one. `FolderRefused` if it is damaged."""
    try:
        text = (folder / MANIFEST).read_bytes().decode("utf-8", errors="replace")
    except FileNotFoundError:
        return []
    names = [name for name in text.split("\n") if name]
    for number, name in enumerate(names, 1):
        if "\ufffd" in name or not name.isprintable():
            text = f"{str(folder / MANIFEST)!r}, which lists the files of an earlier run, is damaged: it has no name "
            raise FolderRefused(f"{text}of a file in line {number}; remove that line, or the folder")
    return names


class ResultsFolder:
    """Writes the results of one run; what an earlier run of tipfem wrote there is removed, all other files stay.

    Args:
        path: the folder; made when it is not there.
        overwrite: whether an earlier run's results are removed; if not, they are an error. By default, None, they are
            removed if that run took less than `SHORT` of wall-clock time, as a script does that is run again.
        fields: how fields are written.

    Raises:
        ValueError: the folder cannot be made or written to, a file is in the way that no run of tipfem wrote, another
            run is writing into it, or it holds results that are not to be overwritten.
    """

    def __init__(self, path: str | Path, *, overwrite: bool | None = None, fields: FieldOutput | None = None) -> None:
        self.fields = fields or FieldOutput()
        if not (overwrite is None or isinstance(overwrite, bool)):
            raise ValueError(f"Simulation: overwrite is {overwrite!r}; it must be True, False or None")
        if isinstance(path, str) and not path:
            raise ValueError("out is '', which would be the present folder; name a folder for the results")
        self.path = path_of("out", path)
        self._lock = FolderLock(self.path)
        self._resumed: int | None = None
        self._history: TextIO | None = None
        self._columns: list[str] = []
        self._times: dict[str, float] = {}
        self._case: dict[str, Any] = {}
        self._rows: list[Mapping[str, float]] = []  # the last two of the history
        self._listed: list[str] = []
        try:
            earlier = self._earlier_files()
            foreign = [name for name in _NAMES if name not in earlier and (self.path / name).exists()]
            if foreign:
                text = f"out is {str(path)!r}, where {foreign[0]} is no file of an earlier run ({MANIFEST} lists "
                raise FolderRefused(f"{text}those), so it is not replaced; name another folder, or remove the file")
            taken = self._wall_seconds() if earlier else 0.0
            if earlier and (overwrite is False or (overwrite is None and taken >= SHORT)):
                text = f"out is {str(path)!r}, which holds the results of a run of {timedelta(seconds=round(taken))}; "
                raise FolderRefused(f"{text}name another folder, resume that run, or replace it by overwrite=True")
            (self.path / "fields" if self.fields.vtu else self.path).mkdir(parents=True, exist_ok=True)
            self._lock.take()
            for name in earlier:
                # A run that was killed may have left a .part file.
                for old in (self.path / name, self.path / (name + ".part")):
                    old.unlink(missing_ok=True)
            (self.path / MANIFEST).unlink(missing_ok=True)
        except OSError as error:
            text = f"out is {str(path)!r}, which cannot be written to ({error.strerror}); name a folder that can"
            raise FolderRefused(text) from error

    @classmethod
    def continued(
        cls, path: str | Path, content: Mapping[str, Any], history: Sequence[Mapping[str, float]], step: int
    ) -> ResultsFolder:
        """The folder of a run that goes on from a checkpoint of a step; what was written after it is removed.

        ``content`` is what the checkpoint holds of `content`, ``history`` the rows up to it; `ValueError` if another
        run is writing into the folder, or it cannot be written to.
        """
        folder = cls.__new__(cls)
        folder.path, folder._history, folder._columns = Path(path), None, []
        folder._lock, folder._resumed = FolderLock(folder.path), step
        try:
            folder._lock.take()
            folder._listed = folder._earlier_files()
            folder._times, folder._case = dict(content["times"]), dict(content["case"])
            folder.fields = FieldOutput(**content.get("fields", {}))
            for name in folder._listed:
                fields, inside = f"fields/{Path(name).name}", name.startswith(("fields/", "walls/"))
                later = inside and fields not in folder._times
                if later or name.endswith(".part"):
                    (folder.path / name).unlink(missing_ok=True)
                (folder.path / (name + ".part")).unlink(missing_ok=True)
            folder._rows = list(history[-2:])
            if folder._case:
                folder._write_json("case.json", folder._case)
            if folder._times and folder.fields.vtu:
                folder._write_times()
            vtkhdf.truncate(folder.path / vtkhdf.NAME, [_step_of(name) for name in folder._times])
            if history:
                folder._columns = list(history[0])
                folder.replace_rows("history.csv", folder._columns, [list(row.values()) for row in history])
            else:
                (folder.path / "history.csv").unlink(missing_ok=True)
        except OSError as error:
            raise ValueError(f"{str(path)!r} cannot be written to ({error.strerror})") from error
        return folder

    def content(self) -> dict[str, Any]:
        """Contents of the folder that a checkpoint keeps: times of the fields, their format, and case.json."""
        return {"times": dict(self._times), "case": dict(self._case), "fields": self.fields.record()}

    def _earlier_files(self) -> list[str]:
        """Names of the files that the manifest lists and that are inside the folder."""
        inside = [name for name in listed(self.path) if not Path(name).is_absolute() and ".." not in Path(name).parts]
        return [name for name in inside if not (self.path / name).is_dir()]

    def _wall_seconds(self) -> float:
        """Duration of the run in the folder, by the last whole row of its history [s]; 0 without one."""
        try:
            return float(last_row(self.path / "history.csv")["wall_seconds"])
        except (ValueError, KeyError):
            return 0.0

    def list_file(self, name: str) -> None:
        """Put a file into the manifest, before it is written."""
        if name not in self._listed:
            with open(self.path / MANIFEST, "a", encoding="utf-8") as manifest:
                manifest.write(name + "\n")
            self._listed.append(name)

    def has_fields(self, step: int) -> bool:
        """Whether the fields of a step have been written, or were not due at it."""
        return step == self._resumed or _field_file(step) in self._times

    def write_case(self, facts: Mapping[str, Any]) -> None:
        """Write case.json."""
        self._case = dict(facts)
        self._write_json("case.json", self._case)

    def _widen_case(self, position: Array) -> None:
        """Enlarge the box in case.json, which pictures show, by walls that have moved out of it; position (N, d)."""
        lower, upper = np.array(self._case["lower"]), np.array(self._case["upper"])
        low, high = position.min(axis=0), position.max(axis=0)
        slack = 1e-6 * self._case["spacing"]
        if (low < lower - slack).any() or (high > upper + slack).any():
            self._case |= {"lower": np.minimum(low, lower).tolist(), "upper": np.maximum(high, upper).tolist()}
            self._write_json("case.json", self._case)

    def append_history(self, row: Mapping[str, float]) -> None:
        """Append a step's row to history.csv, reopened after `close`; the first row determines the columns."""
        if self._history is None:
            self.list_file("history.csv")
            self.open()
            # newline='': the csv module writes line ends itself.
            self._history = open(self.path / "history.csv", "a", encoding="utf-8", newline="")
        lines = csv.writer(self._history, lineterminator="\n")
        if not self._columns:
            self._columns = list(row)
            lines.writerow(self._columns)
        lines.writerow([_number(row[name]) for name in self._columns])
        self._history.flush()
        self._rows = [*self._rows[-1:], row]

    def write_fields(
        self, step: int, time: float, mesh: Mesh, particles: Particles, density: Array, laws: Array | None = None
    ) -> None:
        """Write the state, see `FieldOutput`; a step written again replaces the earlier one.

        Errors leave earlier states as they were. ``density`` (N,) is of the particles' fluids [kg/m^3], ``laws`` are
        those of viscosity, see `law_table`.
        """
        if self._case:
            self._widen_case(particles.position)
        # Where interfaces run along edges, every cell has its fluid, too. Cells across periodic sides have copies of
        # particles.
        whole, node = mesh.unrolled
        of_node: Array | slice = node if mesh.period else slice(None)
        state = FieldState(
            step,
            time,
            whole.position,
            particles.velocity[of_node],
            particles.pressure[of_node],
            particles.fluid[of_node],
            density[of_node],
            particles.wall[of_node],
            whole.cells,
            whole.fluid,
            np.flatnonzero(mesh.surface.loose),
            laws,
            mesh.period.width if mesh.period else None,
            particles.spacing,
            mesh.period.axial,
        )
        name = _field_file(step)
        if self.fields.vtu:
            self._replace(name, lambda path: vtu.write(path, state, self.fields))
            self._write_walls(name, time, particles)
        if self.fields.vtkhdf:
            path = self.path / vtkhdf.NAME
            for file in (path, journal_of(path)):
                self.list_file(file.name)
            vtkhdf.append(path, state, self.fields)
        self._times[name] = time
        if self.fields.vtu:
            self._write_times()
        log(logging.DEBUG, "fields", f"fields at t = {time:.6g} s", {"t": time})

    def _write_walls(self, name: str, time: float, particles: Particles) -> None:
        """Write walls, and what is rigid between them, at a time [s]; what never moves is written once."""
        case, tank = self._case, self._case.get("tank")
        rigid = walls.rigid(case)
        poses = walls.poses_between(self._rows, time, [*(one["name"] for one in rigid), "tank"])
        if not case or (tank and not rigid and not poses and any(self._walls())):
            return
        around = particles.position[particles.wall]
        if case["dimension"] == 3:
            blocks, row = case.get("blocks"), self._rows[-1] if self._rows else {}
            found = walls.faces(around) if blocks is None else walls.boxes(blocks, row)
        else:
            loops = [np.array(loop["corners"]) for loop in tank["loops"]] if tank else []
            if not tank and not case.get("period"):
                loops = [walls.hull(around)]
            outlines = [walls.Outline("tank", loop, tank["reference"] if tank else (0, 0), -1) for loop in loops]
            outlines += [
                walls.Outline(one["name"], np.array(one["corners"]), one["reference"], k) for k, one in enumerate(rigid)
            ]
            found = walls.lines(outlines, poses)
        if len(found[1]):
            (self.path / "walls").mkdir(exist_ok=True)
            self._replace(_walls_file(name), lambda path: walls.write(path, *found))

    def _walls(self) -> dict[str, float]:
        """The files of walls that are there, and their times [s]."""
        there = {_walls_file(name): time for name, time in self._times.items()}
        return {name: time for name, time in there.items() if (self.path / name).is_file()}

    def _write_times(self) -> None:
        """Write fields.pvd and walls.pvd."""
        for collection, files in (("fields.pvd", self._times), ("walls.pvd", self._walls())):
            entries = "\n".join(
                f'    <DataSet timestep="{t:.9g}" part="0" file="{file}"/>' for file, t in files.items()
            )
            text = (
                '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n'
                f"  <Collection>\n{entries}\n  </Collection>\n</VTKFile>\n"
            )
            if files:
                self.replace_lines(collection, text.splitlines())

    def write_summary(self, content: Mapping[str, Any]) -> None:
        """Write summary.json, with the versions of Python and of the packages used."""
        packages = {name: version(name) for name in ("tipfem", "taichi", "numpy", "scipy", "meshio")}
        self._write_json("summary.json", {**content, "versions": {"python": platform.python_version(), **packages}})

    def append_rows(self, name: str, header: Sequence[str], rows: Sequence[Sequence[float]]) -> None:
        """Add rows in full precision to a table, a CSV file; a new one begins with its header."""
        self.list_file(name)
        path = self.path / name
        path.parent.mkdir(exist_ok=True)
        with open(path, "a", encoding="utf-8", newline="") as file:
            lines = csv.writer(file, lineterminator="\n")
            if file.tell() == 0:
                lines.writerow(header)
            lines.writerows([_exact(value) for value in row] for row in rows)

    def replace_rows(self, name: str, header: Sequence[str], rows: Sequence[Sequence[float]]) -> None:
        """Write a table anew, see `append_rows`; history.csv with as many digits as it has."""
        number = _number if name == "history.csv" else _exact

        def write(path: Path) -> None:
            with open(path, "w", encoding="utf-8", newline="") as file:
                lines = csv.writer(file, lineterminator="\n")
                lines.writerow(header)
                lines.writerows([number(value) for value in row] for row in rows)

        (self.path / name).parent.mkdir(exist_ok=True)
        self._replace(name, write)

    def append_line(self, name: str, line: str) -> None:
        """Add a line to a text file and flush it, so that a run that is killed after it has it."""
        self.list_file(name)
        with open(self.path / name, "a", encoding="utf-8") as file:
            file.write(line + "\n")

    def replace_lines(self, name: str, lines: Sequence[str]) -> None:
        """Write a text file anew."""
        text = "".join(line + "\n" for line in lines)
        self._replace(name, lambda path: path.write_text(text, encoding="utf-8"))

    def open(self) -> None:
        """Keep other runs out of the folder, until `close`; `ValueError` if one is writing into it."""
        self._lock.take()

    def show_door(self, path: str) -> None:
        """Show `tipfem view` the socket by which the run can be seen; see `FolderLock.show_door`."""
        self._lock.show_door(path)

    def close(self) -> None:
        """Close the history, and let other runs write into the folder."""
        if self._history is not None:
            self._history.close()
            self._history = None
        self._lock.release()

    def _write_json(self, name: str, content: Mapping[str, Any]) -> None:
        text = json.dumps(content, indent=2, default=_plain) + "\n"
        self._replace(name, lambda path: path.write_text(text, encoding="utf-8"))

    def _replace(self, name: str, write: Callable[[Path], Any]) -> None:
        self.list_file(name)
        with replaced(self.path / name) as file:
            write(file)


# Columns of the history besides those of the budgets, which come before the wall-clock time.
STEP_COLUMNS = tuple(
    "step time time_step particles newton_iterations krylov_iterations newton_residual refused_steps "
    "impact relocated rebuilt max_speed wall_seconds".split()
)


def own_columns(
    columns: Mapping[str, Callable[[Any], float]], others: Collection[str] = ()
) -> dict[str, Callable[[Any], float]]:
    """A copy of a user's columns, functions by name; `ValueError` if one has a name of the history's, or is none."""
    if not isinstance(columns, Mapping):
        raise ValueError(f"columns is {columns!r}; it must be a dict of functions of the simulation, by their names")
    for name, column in columns.items():
        if name in STEP_COLUMNS or name in others:
            raise ValueError(f"columns: {name!r} is a column of every history; choose another name")
        if not callable(column):
            raise ValueError(f"columns: {name!r} is {column!r}; it must be a function of the simulation")
    return dict(columns)


def fill_columns(row: dict[str, float], columns: Mapping[str, Callable[[Any], float]], source: Any) -> Exception | None:
    """Put the values of further columns, functions of ``source`` by name, into a row, except those that fail.

    None, or an error that names the first column that failed, with its own error as the cause.
    """
    failure: Exception | None = None
    for name, column in columns.items():
        try:
            row[name] = float(column(source))
        except Exception as error:  # whatever a user's function raises
            if failure is None:
                failure = ValueError(f"column {name!r} of the history failed: {error!r}")
                failure.__cause__ = error
    return failure


def _field_file(step: int) -> str:
    return f"fields/step_{step:06d}.vtu"


def _walls_file(name: str) -> str:
    """The file of the walls beside one of fields."""
    return f"walls/{Path(name).name}"


def _step_of(name: str) -> int:
    """The inverse of `_field_file`."""
    return int(Path(name).stem.removeprefix("step_"))


def _exact(value: float) -> str:
    return str(int(value)) if isinstance(value, (int, np.integer)) else repr(float(value))


def _number(value: float) -> str:
    return str(value) if isinstance(value, (int, np.integer)) else f"{value:.9g}"


def _plain(value: Any) -> Any:
    """NumPy values as plain Python ones, for JSON."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} cannot be written to JSON")
