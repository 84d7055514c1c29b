"""Checkpoints: all that a run depends on, in a file from which it goes on to the bit.

A checkpoint is an HDF5 file: ``tree``, a JSON text, has the structure and all plain values, ``arrays`` the arrays that
it refers to by number. Behind it stand the format and the SHA-256 of the whole, which is checked before HDF5 sees it.
There are no pickles in it: what is read is data. It is written under another name, flushed to the disk and renamed, so
that a file under its own name is whole.
"""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import io
import json
import math
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any, cast

import numpy as np

from tipfem.case.boundary.boundary import Boundary
from tipfem.case.case import Case
from tipfem.case.particles import Particles
from tipfem.errors import CheckpointError
from tipfem.geometry.period import Period
from tipfem.results.whole_file import replaced
from tipfem.typing import Array

_MAGIC = b"\ntipfem checkpoint 2\n"  # with the number of the format
_SEALED = len(_MAGIC) + hashlib.sha256().digest_size
FOLDER = "checkpoints"
KEPT = 2  # newest checkpoints that stay; the one of the start stays too

# Of a mesh, kept once they are computed. Computed anew they could differ by round-off, or be in another order.
_COMPUTED = ("measure", "neighbours", "edges")


class CheckpointFolder:
    """The checkpoints in a results folder."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path) / FOLDER

    def files(self) -> list[Path]:
        """The checkpoints there are, the newest first."""
        return sorted(self.path.glob("step_*.h5"), reverse=True)

    def write(self, step: int, content: Mapping[str, Any]) -> Path:
        """Write the checkpoint of a step, that of the start 0, and remove those that are no longer needed.

        ``content`` has nested dicts, lists and tuples of plain values, arrays, and the parts of a state, else
        `TypeError`. `OSError` leaves the files that were there.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        path = self.path / file_name(step)
        write_file(path, {"step": step, **content})
        for old in self.files()[KEPT:]:
            if old.name != file_name(0):
                old.unlink(missing_ok=True)
        return path

    def remove_after(self, step: int) -> None:
        """Remove the checkpoints of later steps."""
        for path in self.files():
            if path.name > file_name(step):
                path.unlink(missing_ok=True)

    def read(self, case: Case | None = None, warn: Callable[[str], None] = lambda _: None) -> dict[str, Any]:
        """The newest checkpoint that can be read; `CheckpointError` if there is none.

        The state has the walls of ``case`` and their functions; without it, it is left out. ``warn`` is told of each
        file that cannot be read, in one line.
        """
        newest = ""
        for path in self.files():
            try:
                content = read_file(path, case)
                if path.name == file_name(content["step"]):
                    return content
                raise CheckpointError(f"{path} is the checkpoint of step {content['step']}")
            except CheckpointError as error:
                warn(f"{error}; the one before is tried")
                newest = newest or f"{error}; the run can only be started again"
        folder = self.path.parent
        why = newest or f"{folder} has none; is it the results folder of a run?"
        why = why if folder.is_dir() else "there is no such folder"
        raise CheckpointError(f"{self.path} holds no checkpoint that can be read: {why}")


def file_name(step: int) -> str:
    """Name of the checkpoint of a step."""
    return f"step_{step:09d}.h5"


def write_file(path: Path, content: Mapping[str, Any]) -> None:
    """Write a checkpoint; see `CheckpointFolder.write` for errors."""
    import h5py  # here, for it takes a while and not every run writes checkpoints

    arrays: list[Array] = []
    tree = json.dumps(_encoded(content, arrays))
    # In memory: HDF5 ends the process if the disk is full when it closes a file.
    image = io.BytesIO()
    with h5py.File(image, "w") as file:
        file["tree"] = tree
        for number, array in enumerate(arrays):
            file[f"arrays/{number}"] = array
    data = image.getvalue()
    with replaced(path) as temporary, open(temporary, "wb") as written:
        written.write(data + _seal(data))
        written.flush()
        os.fsync(written.fileno())


def read_file(path: Path, case: Case | None) -> dict[str, Any]:
    """The content of a checkpoint, without the state if there is no ``case``; `CheckpointError` if it is damaged."""
    import h5py

    try:
        data = path.read_bytes()
    except OSError as error:
        raise CheckpointError(f"{path} cannot be read ({error.strerror})") from error
    data, seal = data[:-_SEALED], data[-_SEALED:]
    if not seal.startswith(_MAGIC):
        raise CheckpointError(f"{path} is damaged, or no checkpoint of this version of tipfem")
    if seal != _seal(data):
        raise CheckpointError(f"{path} is damaged: its checksum is wrong")
    with h5py.File(io.BytesIO(data), "r") as file:
        content = json.loads(file["tree"][()])
        arrays = [np.asarray(file[f"arrays/{number}"][()]) for number in range(len(file.get("arrays", ())))]
    if case is None:
        content["dict"].pop("state", None)
    return dict(_decoded(content, arrays, case))


def _seal(data: bytes) -> bytes:
    """The end of a file, behind what HDF5 reads: the format, and a checksum of all that is before it."""
    return _MAGIC + hashlib.sha256(data).digest()


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
        return {"Boundary": {key: _encoded(item, arrays) for key, item in value.stored().items()}}
    if isinstance(value, Period):
        axial = {"axial": True} if value.axial else {}
        return {"Period": {"width": _encoded(value.width, arrays), **axial}}
    if _is_stored_class(type(value)):
        parts = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        parts["computed"] = {key: vars(value)[key] for key in _COMPUTED if key not in parts and key in vars(value)}
        name = f"{type(value).__module__}:{type(value).__qualname__}"
        return {name: {key: _encoded(item, arrays) for key, item in parts.items()}}
    raise TypeError(f"a checkpoint cannot hold a {type(value).__name__}")


def _is_stored_class(kind: Any) -> bool:
    """Whether objects of a class are stored by their fields: a frozen dataclass of tipfem."""
    return (
        isinstance(kind, type)
        and dataclasses.is_dataclass(kind)
        and kind.__dataclass_params__.frozen  # type: ignore[attr-defined]
        and kind.__module__.startswith("tipfem.")
    )


def _class_named(name: str) -> type:
    """The class that `_encoded` has named; CheckpointError for any that it would not store."""
    module, _, qualname = name.partition(":")
    if module.startswith("tipfem."):
        with suppress(ImportError, AttributeError):
            kind = attrgetter(qualname)(import_module(module))
            if _is_stored_class(kind):
                return cast(type, kind)
    raise CheckpointError(f"a checkpoint holds a {name!r}, which this version of tipfem does not know")


def _is_fortran(array: Array) -> bool:
    return bool(array.flags.f_contiguous and not array.flags.c_contiguous)


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
    computed = parts_by_name.pop("computed")
    try:
        made = _class_named(kind)(**parts_by_name)
    except TypeError as error:
        raise CheckpointError(f"a checkpoint holds a {kind!r} of another version of tipfem ({error})") from error
    vars(made).update(computed)
    return made
