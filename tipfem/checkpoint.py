"""Checkpoints: all that a run depends on, in a file from which it goes on to the bit.

A checkpoint is an HDF5 file: ``tree``, a JSON text, has the structure and all plain values, ``arrays`` the arrays that
it refers to by number, and the attribute ``checksum`` is the SHA-256 of both. There are no pickles in it: what is read
is data. It is written under another name, flushed to the disk and renamed, so that a file under its own name is whole.
"""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import json
import math
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.case.body import Body
from tipfem.case.boundary import Boundary
from tipfem.case.case import Case
from tipfem.case.fluid import Fluid
from tipfem.case.grading import Grading
from tipfem.case.numerics import FittedRule, Numerics, RelocationRule, SurfaceRule
from tipfem.case.particles import Particles
from tipfem.case.period import Period
from tipfem.case.walls import Wall
from tipfem.errors import CheckpointError
from tipfem.mesh.components import Components
from tipfem.mesh.interface_slip import InterfaceSlip
from tipfem.mesh.mesh import Mesh, Surface
from tipfem.state import InterpolatedMaterial, SharpMaterial, State
from tipfem.typing import Array
from tipfem.walls.bodies import BodyStates
from tipfem.walls.layers import Layers

FORMAT = 1
FOLDER = "checkpoints"
KEPT = 2  # newest checkpoints that stay; the one of the start stays too

# Frozen dataclasses that a state consists of; all others are refused.
_CLASSES: dict[str, type] = {
    cls.__name__: cls
    for cls in (
        State,
        SharpMaterial,
        InterpolatedMaterial,
        Mesh,
        Surface,
        Components,
        Layers,
        BodyStates,
        InterfaceSlip,
    )
}
# What a mesh keeps once it is computed. Computed anew it could differ by round-off, or be in another order.
_COMPUTED = ("measure", "neighbours", "edges")


class CheckpointFolder:
    """The checkpoints in a results folder.

    Args:
        path: of the results folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path) / FOLDER

    def files(self) -> list[Path]:
        """The checkpoints there are, the newest first."""
        return sorted(self.path.glob("step_*.h5"), reverse=True)

    def write(self, step: int, content: Mapping[str, Any]) -> Path:
        """Write the checkpoint of a step, and remove those that are no longer needed.

        Args:
            step: number of the step; that of the start is 0.
            content: nested dicts, lists and tuples of plain values, arrays, and the parts of a state.

        Raises:
            OSError: the file cannot be written; those that were there are left.
            TypeError: the content has a value that cannot be stored.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        path = self.path / file_name(step)
        write_file(path, content)
        for old in self.files()[KEPT:]:
            if old.name != file_name(0):
                old.unlink(missing_ok=True)
        return path

    def read(self, case: Case, warn: Callable[[str], None]) -> dict[str, Any]:
        """The newest checkpoint that can be read.

        Args:
            case: that of the run; its walls and their functions are those of the state.
            warn: told of each file that cannot be read, in one line.

        Raises:
            CheckpointError: there is none.
        """
        return self._newest(case, warn)

    def _newest(self, case: Case | None, warn: Callable[[str], None]) -> dict[str, Any]:
        """See `read` and `newest`."""
        newest = ""
        for path in self.files():
            try:
                return read_file(path, case)
            except CheckpointError as error:
                warn(f"{error}; the one before is tried")
                newest = newest or f": {error}; the run can only be started again"
        raise self._none(newest)

    def _none(self, why: str) -> CheckpointError:
        folder = self.path.parent
        if not folder.is_dir():
            why = ": there is no such folder"
        elif not why:
            why = f": {folder} has none; is it the results folder of a run?"
        return CheckpointError(f"{self.path} holds no checkpoint that can be read{why}")

    def newest(self) -> dict[str, Any]:
        """The content of the newest checkpoint that can be read, without its state.

        Raises:
            CheckpointError: there is none.
        """
        return self._newest(None, lambda _: None)


def file_name(step: int) -> str:
    """Name of the checkpoint of a step."""
    return f"step_{step:09d}.h5"


def write_file(path: Path, content: Mapping[str, Any]) -> None:
    """Write a checkpoint; see `CheckpointFolder.write` for errors."""
    import h5py  # here, for it takes a while and not every run writes checkpoints

    arrays: list[Array] = []
    tree = json.dumps(_encoded(content, arrays))
    temporary = path.with_name(path.name + ".part")
    try:
        with h5py.File(temporary, "w") as file:
            file.attrs["tipfem_checkpoint"] = FORMAT
            file.attrs["checksum"] = _checksum(tree, arrays)
            file["tree"] = tree
            group = file.create_group("arrays")
            for number, array in enumerate(arrays):
                group[str(number)] = array
        with open(temporary, "rb") as written:
            os.fsync(written.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def read_file(path: Path, case: Case | None) -> dict[str, Any]:
    """The content of a checkpoint.

    Args:
        path: the file.
        case: that of the run; without one, the state is left out.

    Raises:
        CheckpointError: the file is damaged, no checkpoint, or of another format.
    """
    import h5py

    try:
        with h5py.File(path, "r") as file:
            found = file.attrs.get("tipfem_checkpoint")
            if found != FORMAT:
                kind = "no checkpoint of tipfem" if found is None else f"a checkpoint of format {found}, not {FORMAT}"
                raise CheckpointError(f"{path} is {kind}")
            tree = file["tree"][()].decode()
            group = file["arrays"]
            arrays = [np.asarray(group[str(number)][()]) for number in range(len(group))]
            if file.attrs["checksum"] != _checksum(tree, arrays):
                raise CheckpointError(f"{path} is damaged: its checksum is wrong")
    except (OSError, KeyError, AttributeError, RuntimeError, ValueError) as error:
        if isinstance(error, CheckpointError):
            raise
        raise CheckpointError(f"{path} is damaged or no checkpoint ({error})") from error
    content = json.loads(tree)
    if case is None:
        content["dict"].pop("state", None)
    return dict(_decoded(content, arrays, case))


def _checksum(tree: str, arrays: list[Array]) -> str:
    total = hashlib.sha256(tree.encode())
    for array in arrays:
        total.update(f"{array.dtype.str}{array.shape}".encode())
        total.update(np.ascontiguousarray(array).data)
    return total.hexdigest()


def _encoded(value: Any, arrays: list[Array]) -> Any:
    """``value`` as a tree of JSON; its arrays are appended to ``arrays``."""
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, np.ndarray):
        for number, known in enumerate(arrays):
            if known is value:  # one array may be a part of several objects
                return {"array": number, "fortran": _is_fortran(value)}
        arrays.append(value)
        return {"array": len(arrays) - 1, "fortran": _is_fortran(value)}
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else {"float": repr(float(value))}
    if isinstance(value, Mapping):
        if not all(isinstance(key, str) for key in value):
            raise TypeError("a checkpoint holds dicts with keys of text only")
        return {"dict": {key: _encoded(item, arrays) for key, item in value.items()}}
    if isinstance(value, list | tuple):
        return {type(value).__name__: [_encoded(item, arrays) for item in value]}
    if isinstance(value, Particles):
        return {"Particles": {key: _encoded(item, arrays) for key, item in vars(value).items()}}
    if isinstance(value, Boundary):
        stored = {key: item for key, item in vars(value).items() if _is_stored(item)}
        return {"Boundary": {key: _encoded(item, arrays) for key, item in stored.items()}}
    if isinstance(value, Period):
        return {"Period": {"width": _encoded(value.width, arrays)}}
    name = type(value).__name__
    if _CLASSES.get(name) is type(value) and dataclasses.is_dataclass(value):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        if isinstance(value, Mesh):
            fields["computed"] = {key: value.__dict__[key] for key in _COMPUTED if key in value.__dict__}
        return {name: {key: _encoded(item, arrays) for key, item in fields.items()}}
    raise TypeError(f"a checkpoint cannot hold a {name}")


def _is_fortran(array: Array) -> bool:
    return bool(array.flags.f_contiguous and not array.flags.c_contiguous)


def _is_stored(value: Any) -> bool:
    """Whether a boundary's attribute is data of its own; its walls and motion are the case's."""
    if isinstance(value, np.ndarray | bool | int | float) or value is None:
        return True
    return isinstance(value, list) and all(
        isinstance(item, tuple) and all(_is_stored(part) or isinstance(part, np.integer) for part in item)
        for item in value
    )


def _decoded(value: Any, arrays: list[Array], case: Case | None) -> Any:
    """The inverse of `_encoded`."""
    if not isinstance(value, dict):
        return value
    if "array" in value:
        number = value["array"]
        if value["fortran"] and not _is_fortran(arrays[number]):
            arrays[number] = np.asfortranarray(arrays[number])
        return arrays[number]
    ((kind, items),) = value.items()
    if kind == "float":
        return float(items)
    if kind in ("list", "tuple"):
        parts = [_decoded(item, arrays, case) for item in items]
        return parts if kind == "list" else tuple(parts)
    parts_by_name = {key: _decoded(item, arrays, case) for key, item in items.items()}
    if kind == "dict":
        return parts_by_name
    if kind == "Particles":
        particles = Particles.__new__(Particles)
        vars(particles).update(parts_by_name)
        return particles
    if kind == "Period":
        return Period(**parts_by_name)
    if kind == "Boundary":
        assert case is not None
        boundary = copy.copy(case.boundary)
        vars(boundary).update(parts_by_name)
        return boundary
    if kind not in _CLASSES:
        raise CheckpointError(f"a checkpoint holds a {kind!r}, which this version of tipfem does not know")
    computed = parts_by_name.pop("computed", {})
    made = _CLASSES[kind](**parts_by_name)
    if computed:
        made.__dict__.update(computed)
    return made


def case_record(case: Case) -> dict[str, Any]:
    """What a case is, as plain values and arrays, to compare it with another and to make it again.

    A function of Python's is recorded by its name alone, as ``{"function": name}``.
    """
    return {
        "fluids": [_plain(fluid) for fluid in case.fluids],
        "gravity": np.asarray(case.gravity, dtype=float).tolist(),
        "body_force": _plain(case.body_force),
        "interface": case.interface,
        "free_surface": case.free_surface,
        "title": case.title,
        "numerics": _plain(case.numerics),
        "walls": [_plain(wall) for wall in case.walls],
        "tank_motion": _plain(case.tank_motion),
        "grading": _plain(case.grading),
        # As polygons, which a body in a tank has.
        "bodies": [{**_plain(body), "shape": body.corners} for body in case.bodies],
        "walls_have_fluids": case.walls_have_fluids,
        "particles": dict(vars(case.particles)),
        **({"period": case.period.width.tolist()} if case.period else {}),
    }


def case_from(record: Mapping[str, Any]) -> Case:
    """The case that a record of `case_record` describes.

    Raises:
        CheckpointError: a part of it is a function of Python's, which no record keeps.
    """
    if functions := python_functions(record):
        raise CheckpointError(
            f"the case has functions of Python's, which no file keeps: {', '.join(functions)}; give the case to "
            "resume, as the script made it"
        )
    particles = Particles.__new__(Particles)
    vars(particles).update(record["particles"])
    numerics = dict(record["numerics"])
    for name, rule in (("relocation", RelocationRule), ("fitting", FittedRule), ("surface", SurfaceRule)):
        numerics[name] = rule(**numerics[name])
    grading = record["grading"]
    case = Case(
        particles,
        [Fluid(**fluid) for fluid in record["fluids"]],
        record["gravity"],
        interface=record["interface"],
        free_surface=record["free_surface"],
        numerics=Numerics(**numerics),
        title=record["title"],
        walls=[Wall(**wall) for wall in record["walls"]],
        grading=None if grading is None else Grading(**grading),
        bodies=[Body(**body) for body in record.get("bodies", [])],
        period=record.get("period"),
    )
    case.walls_have_fluids = record["walls_have_fluids"]
    return case


def python_functions(record: Mapping[str, Any]) -> list[str]:
    """Names of the parts of a record that are functions."""
    leaves = _flat({key: value for key, value in record.items() if key != "particles"})
    return [key for key, value in leaves if _is_function(value)]


def _is_function(value: Any) -> bool:
    return isinstance(value, Mapping) and set(value) == {"function"}


def _plain(value: Any) -> Any:
    """A value as nested dicts of plain values."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value) if field.init}
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if callable(value):
        return {"function": _described(value)}
    return value


def _described(function: Any) -> str:
    """The name of a function; of a form of case files, which is a function with parameters, these as well."""
    inner = getattr(function, "function", function)  # of a force that is the same everywhere
    if not hasattr(inner, "model_dump"):
        return str(getattr(function, "__qualname__", type(function).__name__))
    text = f"{type(inner).__name__}({inner})"
    return text if len(text) <= 200 else f"{text[:100]}... {hashlib.sha256(text.encode()).hexdigest()[:16]}"


def differences(recorded: Mapping[str, Any], present: Mapping[str, Any]) -> list[str]:
    """What differs between two records of cases, a line for each value: ``numerics.rho_inf: 0.0, now 0.5``."""
    before, after = dict(_flat(recorded)), dict(_flat(present))
    lines = []
    for key in [*before, *(key for key in after if key not in before)]:
        old, new = before.get(key, "nothing"), after.get(key, "nothing")
        if isinstance(old, np.ndarray) or isinstance(new, np.ndarray):
            if not (np.shape(old) == np.shape(new) and np.array_equal(old, new)):
                lines.append(f"{key}: other values at the start")
        elif old != new:
            lines.append(f"{key}: {old!r}, now {new!r}")
    return lines


def _flat(tree: Any, name: str = "") -> list[tuple[str, Any]]:
    """The leaves of nested dicts and lists, by dotted names."""
    if isinstance(tree, Mapping) and set(tree) != {"function"}:
        items = tree.items()
    elif isinstance(tree, list) and any(isinstance(item, Mapping | list) for item in tree):
        items = {
            str(item.get("name", k) if isinstance(item, Mapping) else k): item for k, item in enumerate(tree)
        }.items()
    else:
        return [(name, tree)]
    return [leaf for key, item in items for leaf in _flat(item, f"{name}.{key}" if name else str(key))]


def table_of(history: list[dict[str, float]]) -> dict[str, Any]:
    """Rows of a history as one array (K, C), with the names of the columns and which of them are whole numbers."""
    names = list(history[0]) if history else []
    return {
        "columns": names,
        "whole": [name for name in names if isinstance(history[0][name], (int, np.integer))],
        "rows": np.array([[row[name] for name in names] for row in history], dtype=float).reshape(
            len(history), len(names)
        ),
    }


def rows_of(table: Mapping[str, Any]) -> list[dict[str, float]]:
    """The inverse of `table_of`."""
    whole = set(table["whole"])
    return [
        {name: int(value) if name in whole else float(value) for name, value in zip(table["columns"], row, strict=True)}
        for row in table["rows"]
    ]


def what_changed(
    content: Mapping[str, Any],
    case: Case,
    columns: Sequence[str],
    present: Mapping[str, Any],
    out: str | Path,
    *,
    allow_changes: bool,
) -> list[str]:
    """Lines on what has changed since a checkpoint that may change the results.

    Args:
        content: of the checkpoint.
        case: with which the run is to go on.
        columns: names of those with which it is to go on.
        present: the environment and the settings of the runtime.
        out: the results folder.
        allow_changes: whether numbers of the method may have changed.

    Raises:
        CheckpointError: the case or the columns are not those of the run.
    """
    changed = differences(content["case"], case_record(case))
    if changed and not (allow_changes and all(line.startswith("numerics.") for line in changed)):
        remedy = "" if allow_changes else "; numbers of the method may change with allow_changes"
        raise CheckpointError(f"{out}: the case is not that of the run: {'; '.join(changed)}{remedy}")
    before = content["settings"]["columns"]
    if sorted(columns) != sorted(before):
        raise CheckpointError(f"{out}: the run had the columns {before}, and {list(columns)} are given")
    return [f"changed: {line}" for line in changed] + [
        f"{key}: {value}, now {present.get(key)}; the results may differ by round-off from those of one run"
        for key, value in content["environment"].items()
        if key != "threads" and present.get(key) != value
    ]


def environment() -> dict[str, str]:
    """What results depend on to the bit, beside the case: processor and versions."""
    packages = {name: version(name) for name in ("tipfem", "taichi", "numpy", "scipy")}
    return {"processor": _processor(), "python": platform.python_version(), **packages}


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            names = [line.split(":", 1)[1].strip() for line in file if line.startswith("model name")]
        return names[0]
    except (OSError, IndexError):
        return platform.processor() or platform.machine()
