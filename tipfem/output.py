"""Output: a results folder with the history, the fields over time and a summary.

    case.json       what was simulated: fluids, walls' box, spacing
    history.csv     one row a step, SI units
    fields.pvd      the fields over time, for ParaView; fields/step_*.vtu
    summary.json    settings, versions, and figures of the whole run
    .tipfem         names of these files: a later run in the folder removes them, and nothing else

Every file but the history, which grows row by row, is written under another name and then renamed:
a reader, or a full disk, never meets half a file.
"""

from __future__ import annotations

import csv
import json
import os
import platform
from collections.abc import Callable, Collection, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from tipfem.case.case import Case
from tipfem.case.particles import Particles
from tipfem.mesh.mesh import Mesh
from tipfem.typing import Array

MANIFEST = ".tipfem"
# What every run writes beside its fields; a file of that name that is not in the manifest belongs to somebody else.
_NAMES = ("case.json", "history.csv", "summary.json", "fields.pvd")


class ResultsFolder:
    """Writes the results of one run; what an earlier run of tipfem wrote there is removed, all other files stay.

    Args:
        path: the folder; made when it is not there.

    Raises:
        ValueError: the folder cannot be made or written to, or a file is in the way that no run of tipfem wrote.
    """

    def __init__(self, path: str | Path) -> None:
        if not str(path):
            raise ValueError("out is '', which would be the present folder; name a folder for the results")
        self.path = Path(path)
        self._history: TextIO | None = None
        self._columns: list[str] = []
        self._times: dict[str, float] = {}
        self._case: dict[str, Any] = {}
        self._listed: list[str] = []
        try:
            earlier = self._earlier_files()
            foreign = [name for name in _NAMES if name not in earlier and (self.path / name).exists()]
            if foreign:
                raise ValueError(
                    f"out is {str(path)!r}, where {foreign[0]} is no file of an earlier run ({MANIFEST} lists those), "
                    "so it is not replaced; name another folder, or remove the file"
                )
            (self.path / "fields").mkdir(parents=True, exist_ok=True)
            probe = self.path / ".writable"
            probe.write_text("")
            probe.unlink()
            for name in earlier:
                # The .part is of a run that was killed.
                for old in (self.path / name, self.path / (name + ".part")):
                    old.unlink(missing_ok=True)
            (self.path / MANIFEST).unlink(missing_ok=True)
        except OSError as error:
            raise ValueError(
                f"out is {str(path)!r}, which cannot be written to ({error.strerror}); name a folder that can"
            ) from error

    def _earlier_files(self) -> list[str]:
        """Names of the files that the manifest lists, as far as they lie in the folder."""
        try:
            names = (self.path / MANIFEST).read_text(encoding="utf-8").splitlines()
        except FileNotFoundError:
            return []
        inside = [name for name in names if name and not Path(name).is_absolute() and ".." not in Path(name).parts]
        return [name for name in inside if not (self.path / name).is_dir()]

    def _list(self, name: str) -> None:
        """Put a file into the manifest, before it is written."""
        if name not in self._listed:
            with open(self.path / MANIFEST, "a", encoding="utf-8") as manifest:
                manifest.write(name + "\n")
            self._listed.append(name)

    def has_fields(self, step: int) -> bool:
        """Whether the fields of a step have been written."""
        return _field_file(step) in self._times

    def write_case(self, case: Case) -> None:
        """Write case.json."""
        position = case.particles.position[case.particles.wall]
        self._case = {
            "format": 1,
            "title": case.title,
            "dimension": case.particles.dimension,
            "fluids": [vars(f) for f in case.fluids],
            "lower": position.min(axis=0).tolist(),
            "upper": position.max(axis=0).tolist(),
            "spacing": case.particles.spacing,
            "gravity": np.asarray(case.gravity).tolist(),
            "interface": case.interface,
            "free_surface": case.free_surface,
        }
        self._write_json("case.json", self._case)

    def _widen_case(self, position: Array) -> None:
        """Let the box in case.json, which pictures show, hold walls that have moved out of it; position (N, d)."""
        lower, upper = np.array(self._case["lower"]), np.array(self._case["upper"])
        low, high = position.min(axis=0), position.max(axis=0)
        slack = 1e-6 * self._case["spacing"]
        if (low < lower - slack).any() or (high > upper + slack).any():
            self._case |= {"lower": np.minimum(low, lower).tolist(), "upper": np.maximum(high, upper).tolist()}
            self._write_json("case.json", self._case)

    def append_history(self, row: Mapping[str, float]) -> None:
        """Add a step's row to history.csv; the first one decides on the columns.

        After `close` the file is opened again and goes on.
        """
        if self._history is None:
            self._list("history.csv")
            # No newline is translated: the csv module writes them itself, those within a name too.
            self._history = open(self.path / "history.csv", "a", encoding="utf-8", newline="")
        lines = csv.writer(self._history, lineterminator="\n")
        if not self._columns:
            self._columns = list(row)
            lines.writerow(self._columns)
        lines.writerow([_number(row[name]) for name in self._columns])
        self._history.flush()

    def write_fields(self, step: int, time: float, mesh: Mesh, particles: Particles, density: Array) -> None:
        """Write the state as a VTU file and list it in fields.pvd; a step written again replaces the earlier one.

        Args:
            step: number of the step, for the file's name.
            time: [s].
            mesh: simplices on the particles' positions.
            particles: the state.
            density: (N,) of each particle's fluid [kg/m^3].
        """
        import meshio  # here, for it takes a while and not every run writes fields

        if self._case:
            self._widen_case(particles.position)
        name = _field_file(step)
        points, velocity = _three_dimensional(particles.position), _three_dimensional(particles.velocity)
        # Where interfaces run along edges, every triangle has its fluid, too.
        cell_data = {} if mesh.fluid is None else {"fluid": [mesh.fluid.astype(np.int32)]}
        blocks = [("triangle" if particles.dimension == 2 else "tetra", mesh.cells)]
        if not len(mesh.cells):  # meshio cannot write an empty block
            blocks = []
        if mesh.surface.loose.any():
            blocks.append(("vertex", np.flatnonzero(mesh.surface.loose)[:, None]))
        content = meshio.Mesh(
            points,
            blocks,
            point_data={
                "velocity": velocity,
                "pressure": particles.pressure,
                "fluid": particles.fluid.astype(np.int32),
                "density": density,
                "wall": particles.wall.astype(np.int32),
            },
            cell_data=cell_data,
        )
        self._replace(name, lambda path: meshio.write(path, content, file_format="vtu"))
        self._times[name] = time
        entries = "\n".join(
            f'    <DataSet timestep="{t:.9g}" part="0" file="{file}"/>' for file, t in self._times.items()
        )
        text = (
            '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n'
            f"  <Collection>\n{entries}\n  </Collection>\n</VTKFile>\n"
        )
        self._replace("fields.pvd", lambda path: path.write_text(text, encoding="utf-8"))

    def write_summary(self, content: Mapping[str, Any]) -> None:
        """Write summary.json, with the versions of what the run was made with."""
        packages = {name: version(name) for name in ("tipfem", "taichi", "numpy", "scipy", "meshio")}
        self._write_json("summary.json", {**content, "versions": {"python": platform.python_version(), **packages}})

    def close(self) -> None:
        """Close the history."""
        if self._history is not None:
            self._history.close()
            self._history = None

    def _write_json(self, name: str, content: Mapping[str, Any]) -> None:
        text = json.dumps(content, indent=2, default=_plain) + "\n"
        self._replace(name, lambda path: path.write_text(text, encoding="utf-8"))

    def _replace(self, name: str, write: Callable[[Path], Any]) -> None:
        temporary = self.path / (name + ".part")
        self._list(name)
        try:
            write(temporary)
            os.replace(temporary, self.path / name)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise


# Columns of the history beside those of the budgets, which stand before the wall-clock time.
STEP_COLUMNS = (
    "step",
    "time",
    "time_step",
    "particles",
    "newton_iterations",
    "krylov_iterations",
    "newton_residual",
    "refused_steps",
    "relocated",
    "rebuilt",
    "max_speed",
    "wall_seconds",
)


def own_columns(
    columns: Mapping[str, Callable[[Any], float]], others: Collection[str] = ()
) -> dict[str, Callable[[Any], float]]:
    """A copy of a user's columns.

    Args:
        columns: functions, by name.
        others: names of further columns that the history has.

    Raises:
        ValueError: one has the name of a column that the history has, or is no function.
    """
    for name, column in columns.items():
        if name in STEP_COLUMNS or name in others:
            raise ValueError(f"columns: {name!r} is a column of every history; choose another name")
        if not callable(column):
            raise ValueError(f"columns: {name!r} is {column!r}; it must be a function of the simulation")
    return dict(columns)


def fill_columns(row: dict[str, float], columns: Mapping[str, Callable[[Any], float]], source: Any) -> Exception | None:
    """Put the values of further columns into a row of the history, as far as they can be had.

    Args:
        row: the row; a column that fails stays as it is.
        columns: functions of ``source``, by name.
        source: what they are evaluated on.

    Returns:
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


def _number(value: float) -> str:
    return str(value) if isinstance(value, (int, np.integer)) else f"{value:.9g}"


def _three_dimensional(vectors: Array) -> Array:
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))


def _plain(value: Any) -> Any:
    """NumPy values as plain Python ones, for JSON."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} cannot be written to JSON")
