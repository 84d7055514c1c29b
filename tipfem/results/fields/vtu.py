"""States as VTU files, one a stored time."""

from __future__ import annotations

import contextlib
import io
import threading
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.results.fields.catalogue import three_components
from tipfem.results.fields.field_output import FieldOutput
from tipfem.results.fields.field_state import FieldState, StoredState
from tipfem.typing import Array

_READING = threading.Lock()  # of one file at a time, for what is said meanwhile is the process's


def write(path: Path, state: FieldState, output: FieldOutput | None = None) -> None:
    """Write a state, with the precision and quantities of ``output``; `OSError` if it cannot be written."""
    import meshio  # here, for it takes a while and not every run writes fields

    output = output or FieldOutput()
    real = output.real
    # meshio cannot write an empty block.
    blocks = [("triangle" if state.dimension == 2 else "tetra", state.cells)] if len(state.cells) else []
    if len(state.loose):
        blocks.append(("vertex", state.loose[:, None]))
    cell_data = state.cell_data(real, output.quantities) if blocks else {}
    ends = [len(state.cells)] if len(state.cells) and len(state.loose) else []
    content = meshio.Mesh(
        three_components(state.position).astype(real, copy=False),
        blocks,
        point_data=state.point_data(real, output.quantities),
        cell_data={name: np.split(values, ends) for name, values in cell_data.items()},
    )
    with _quick():
        meshio.write(path, content, file_format="vtu")


def read(path: Path, dimension: int) -> StoredState:
    """Read a state in d dimensions; `ValueError`, which names the file, if it is missing or damaged."""
    mesh = _read(path)
    kind = "triangle" if dimension == 2 else "tetra"
    chosen = [number for number, block in enumerate(mesh.cells) if block.type == kind]
    owners = mesh.cell_data.get("fluid")
    none = np.zeros((0, dimension + 1), dtype=np.int64)
    return StoredState(
        file=path,
        points=mesh.points,
        cells=np.concatenate([none, *(mesh.cells[number].data for number in chosen)]),
        cell_fluid=None if owners is None else _joined([owners[number] for number in chosen]),
        loose=_joined([np.ravel(block.data) for block in mesh.cells if block.type == "vertex"]),
        data=mesh.point_data,
    )


@contextlib.contextmanager
def _quick() -> Iterator[None]:
    """Compression of meshio by isal, which is quicker than zlib."""
    from isal import isal_zlib
    from meshio.vtu import _vtu

    _vtu.zlib = isal_zlib
    try:
        yield
    finally:
        _vtu.zlib = zlib


def _joined(parts: list[Array]) -> Array:
    """Whole numbers of several blocks, as one array."""
    return np.concatenate([np.zeros(0, dtype=np.int64), *(np.ravel(part).astype(np.int64) for part in parts)])


def _read(path: Path) -> Any:
    import meshio

    if not path.is_file():
        raise ValueError(f"{path}: fields.pvd lists it, but there is no such file")
    said = io.StringIO()
    try:
        # meshio prints its complaint and ends the process on a bad file.
        with _READING, contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), _quick():
            return meshio.read(path, file_format="vtu")
    except SystemExit:
        reason = " ".join(said.getvalue().split())
    except Exception as error:  # a truncated file fails anywhere between the XML and zlib
        reason = f"{type(error).__name__}: {error}"
    raise ValueError(f"{path}: not a VTU file that can be read (truncated?): {reason}")
