"""States of a whole run in one VTKHDF file, which ParaView and VTK open as a time series.

The format is Kitware's: HDF5 with the group VTKHDF of the type UnstructuredGrid. The arrays of all stored times stand
one behind the other in each dataset, and the group Steps has the time of each and where its parts begin; particles and
cells may differ from time to time. The group tipfem, which VTK passes over, has the numbers of the steps. See
https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/.

A change comes into force in one piece, see `tipfem.results.fields.atomic_file`: a run that is killed while it appends
leaves the file with the states before.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.results.fields.atomic_file import AtomicFile, recover
from tipfem.results.fields.catalogue import STORED, three_components
from tipfem.results.fields.field_output import FieldOutput
from tipfem.results.fields.field_state import VTK_CELLS, FieldState, StoredState
from tipfem.typing import Array

NAME = "fields.vtkhdf"
VERSION = (2, 0)
_CHUNKS = (512, 16384)  # fewest and most rows of a chunk
_STEP_CHUNK = 256
# Datasets with a row for each state, in the group VTKHDF; offsets of cells have a column for each kind of topology, and
# there is one.
_COUNTS = ("NumberOfPoints", "NumberOfCells", "NumberOfConnectivityIds")
_COLUMNS = ("Steps/CellOffsets", "Steps/ConnectivityIdOffsets")
_OF_STATES = (*_COUNTS, "Steps/Values", "Steps/PartOffsets", "Steps/NumberOfParts", "Steps/PointOffsets", *_COLUMNS)


def append(path: Path, state: FieldState, output: FieldOutput) -> None:
    """Add a state at the end of a file, made if it is not there; later steps and the same one are removed.

    `OSError` leaves the file as it was; `ValueError` if it is none of tipfem.
    """
    if not path.exists():
        write(path, [state], output)
        return
    with _changing(path) as file:
        steps = file["tipfem/step"][:]
        _truncate(file, int(np.searchsorted(steps, state.step)))
        _append(file, state)


def truncate(path: Path, steps: Iterable[int]) -> None:
    """Keep the states of steps, by number, up to the first that is not among them; nothing without a file."""
    recover(path)
    if not path.exists():
        return
    kept = set(steps)
    stored, _ = times(path)
    count = next((number for number, step in enumerate(stored) if step not in kept), len(stored))
    if count == 0:
        path.unlink()
    elif count < len(stored):
        with _changing(path) as file:
            _truncate(file, count)


def write(path: Path, states: Iterable[FieldState], output: FieldOutput) -> None:
    """Write a file of some states, at least one, in order of time; it takes its name when it is whole.

    `OSError` leaves a file that was there as it was; `ValueError` if there is no state.
    """
    import h5py  # here, for it takes a while and not every run writes such a file

    recover(path)
    temporary = path.with_name(path.name + ".part")
    try:
        count = 0
        for count, state in enumerate(states, start=1):
            if count == 1:
                empty = io.BytesIO()
                with h5py.File(empty, "w") as file:
                    _lay_out(file, state, output)
                temporary.write_bytes(empty.getvalue())
            with _changing(temporary, durable=False) as file:
                _append(file, state)
        if not count:
            raise ValueError(f"{path}: there is no state to be written")
        with open(temporary, "rb") as written:
            os.fsync(written.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def times(path: Path) -> tuple[list[int], Array]:
    """Numbers of a file's steps, and their times (K,) [s]; `ValueError`, with its name, if it cannot be read."""
    with _reading(path) as file:
        return [int(step) for step in file["tipfem/step"][:]], np.asarray(file["VTKHDF/Steps/Values"][:])


def read(path: Path, number: int, dimension: int) -> StoredState:
    """State number ``number``, from 0, in d dimensions; `ValueError`, with the file's name, if it cannot be read."""
    with _reading(path) as file:
        group = file["VTKHDF"]
        steps = group["Steps"]
        points = _part(steps["PointOffsets"][number], group["NumberOfPoints"][number])
        cells = _part(steps["CellOffsets"][number, 0], group["NumberOfCells"][number])
        corners = _part(steps["ConnectivityIdOffsets"][number, 0], group["NumberOfConnectivityIds"][number])
        types, connectivity = group["Types"][cells], group["Connectivity"][corners]
        owners = group["CellData"].get("fluid")
        real = types != VTK_CELLS[1]
        count = int(real.sum()) * (dimension + 1)  # vertices stand behind the cells
        return StoredState(
            file=path,
            points=group["Points"][points],
            cells=connectivity[:count].reshape(-1, dimension + 1),
            cell_fluid=None if owners is None else owners[cells][real].astype(np.int64),
            loose=connectivity[count:],
            data={name: values[points] for name, values in group["PointData"].items()},
        )


def _part(start: Any, count: Any) -> slice:
    return slice(int(start), int(start) + int(count))


@contextmanager
def _reading(path: Path) -> Iterator[Any]:
    import h5py

    if not path.is_file():
        raise ValueError(f"{path}: there is no such file")
    try:
        with AtomicFile(path) as raw, h5py.File(raw, "r") as file:
            if "tipfem" not in file or "VTKHDF" not in file:
                raise ValueError(f"{path}: no VTKHDF file of tipfem; convert makes one of VTU files")
            yield file
    except (OSError, KeyError, RuntimeError, IndexError) as error:
        raise ValueError(f"{path}: not a VTKHDF file that can be read: {error}") from error


@contextmanager
def _changing(path: Path, *, durable: bool = True) -> Iterator[Any]:
    """The file for changes, which come into force at the end of the block; not if it fails. See `AtomicFile.commit`."""
    import h5py

    with AtomicFile(path, write=True) as raw:
        file = h5py.File(raw, "r+")
        try:
            if "tipfem" not in file:
                raise ValueError(f"{path}: no VTKHDF file of tipfem; remove it, or name another folder")
            yield file
        finally:
            file.close()
        raw.commit(durable=durable)


def _lay_out(file: Any, state: FieldState, output: FieldOutput) -> None:
    """Make all groups and datasets, empty."""
    options: dict[str, Any] = {"compression": output.compression, "shuffle": True} if output.compression else {}

    def make(group: Any, name: str, dtype: Any, rows: int, width: int = 0) -> None:
        chunk = _STEP_CHUNK if rows == 0 else int(np.clip(rows // 8, *_CHUNKS))
        group.create_dataset(
            name,
            dtype=dtype,
            shape=(0, width) if width else (0,),
            maxshape=(None, width) if width else (None,),
            chunks=(chunk, width) if width else (chunk,),
            **options,
        )

    group = file.create_group("VTKHDF")
    group.attrs["Version"] = np.array(VERSION, dtype="i8")
    group.attrs["Type"] = np.bytes_("UnstructuredGrid")
    steps = group.create_group("Steps")
    steps.attrs["NSteps"] = np.int64(0)
    for name in _OF_STATES:
        make(group, name, "f8" if name == "Steps/Values" else "i8", 0, int(name in _COLUMNS))
    count, cells = len(state.position), len(state.cells)
    make(group, "Points", output.real, count, 3)
    make(group, "Connectivity", "i8", cells * (state.dimension + 1))
    make(group, "Offsets", "i8", cells)
    make(group, "Types", "u1", cells)
    for kind, fields, rows in (
        ("Point", state.point_data(output.real, output.quantities), count),
        ("Cell", state.cell_data(output.real, output.quantities), cells),
    ):
        data, offsets = group.create_group(f"{kind}Data"), steps.create_group(f"{kind}DataOffsets")
        for name, values in fields.items():
            make(data, name, values.dtype, rows, values.shape[1] if values.ndim == 2 else 0)
            make(offsets, name, "i8", 0)
    make(file.create_group("tipfem"), "step", "i8", 0)


def _append(file: Any, state: FieldState) -> None:
    group, steps = file["VTKHDF"], file["VTKHDF/Steps"]
    number = int(steps.attrs["NSteps"])
    first_point, first_cell = len(group["Points"]), len(group["Types"])
    first_corner = len(group["Connectivity"])
    sizes = np.repeat([state.dimension + 1, 1], [len(state.cells), len(state.loose)])
    types = np.repeat([VTK_CELLS[state.dimension + 1], VTK_CELLS[1]], [len(state.cells), len(state.loose)])
    corners = np.concatenate([np.ravel(state.cells), state.loose])
    _extend(group["Points"], three_components(state.position))
    _extend(group["Connectivity"], corners)
    _extend(group["Offsets"], np.concatenate([[0], np.cumsum(sizes)]))
    _extend(group["Types"], types)
    quantities = [name for name in group["PointData"] if name not in STORED]
    for kind, first, data in (
        ("PointData", first_point, state.point_data("f8", quantities)),
        ("CellData", first_cell, state.cell_data("f8", quantities)),
    ):
        for name in group[kind]:
            _extend(group[kind][name], data.get(name, np.full(len(types), -1)))  # -1: of cells that have no fluid
            _extend(steps[f"{kind}Offsets"][name], [first])
    counts = len(state.position), len(types), len(corners)
    row = *counts, state.time, number, 1, first_point, first_cell, first_corner
    for name, value in zip(_OF_STATES, row, strict=True):
        _extend(group[name], [[value]] if name in _COLUMNS else [value])
    _extend(file["tipfem/step"], [state.step])
    steps.attrs["NSteps"] = np.int64(number + 1)


def _truncate(file: Any, count: int) -> None:
    """Keep the first states."""
    group, steps = file["VTKHDF"], file["VTKHDF/Steps"]
    if count >= int(steps.attrs["NSteps"]):
        return
    points, cells = int(steps["PointOffsets"][count]), int(steps["CellOffsets"][count, 0])
    corners = int(steps["ConnectivityIdOffsets"][count, 0])
    lengths = {"Points": points, "Types": cells, "Offsets": cells + count, "Connectivity": corners}
    for name, length in lengths.items():
        group[name].resize(length, axis=0)
    for kind, length in (("PointData", points), ("CellData", cells)):
        for data in group[kind].values():
            data.resize(length, axis=0)
        for offsets in steps[f"{kind}Offsets"].values():
            offsets.resize(count, axis=0)
    for name in _OF_STATES:
        group[name].resize(count, axis=0)
    file["tipfem/step"].resize(count, axis=0)
    steps.attrs["NSteps"] = np.int64(count)


def _extend(dataset: Any, values: Any) -> None:
    values = np.asarray(values)
    before = len(dataset)
    dataset.resize(before + len(values), axis=0)
    if len(values):
        dataset[before:] = values
