"""The fields at one stored time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tipfem.results.fields.catalogue import STORED
from tipfem.typing import Array

# Cell types of VTK, by the number of particles of a cell.
VTK_CELLS = {1: 1, 3: 5, 4: 10}


@dataclass(frozen=True, eq=False)
class FieldState:
    """The fields at one stored time: N particles and M cells in d dimensions.

    Attributes:
        step: number of the step.
        time: [s].
        position: (N, d) of the particles [m].
        velocity: (N, d) [m/s].
        pressure: (N,) [Pa].
        fluid: (N,) number of each particle's fluid.
        density: (N,) of that fluid [kg/m^3].
        wall: (N,) whether the particle is of a wall.
        cells: (M, d + 1) particles of each cell.
        cell_fluid: (M,) number of each cell's fluid, or None where interfaces cut through cells.
        loose: (L,) numbers of the particles that are in no cell: spray.
    """

    step: int
    time: float
    position: Array
    velocity: Array
    pressure: Array
    fluid: Array
    density: Array
    wall: Array
    cells: Array
    cell_fluid: Array | None
    loose: Array

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return int(self.position.shape[1])

    def point_data(self, real: str) -> dict[str, Array]:
        """The quantities of the particles as they are written, vectors with 3 components.

        Args:
            real: NumPy's name of the type of real numbers.
        """
        return {name: kind.written(getattr(self, name), real) for name, kind in STORED.items()}

    def _repr_html_(self) -> str:
        return f"<pre>{self!r}</pre>"

    def __repr__(self) -> str:
        speed = float(np.linalg.norm(self.velocity, axis=1).max()) if len(self.position) else 0.0
        return (
            f"FieldState at t = {self.time:g} s (step {self.step}): {len(self.position)} particles, "
            f"{len(self.cells)} cells, {self.dimension} dimensions, largest speed {speed:.3g} m/s"
        )
