"""Bubbles of a light fluid in a heavy one, each a coarse unknown of the pressure's multigrid."""

from __future__ import annotations

from typing import Any

import numpy as np

from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import launch
from tipfem.linalg.multigrid import deflation_kernels
from tipfem.typing import Array

# Without a jump of the density as large as this nothing is a bubble; with one, what is lighter than the geometric
# mean of the heaviest and the lightest element is.
JUMP = 10.0
# More particles than this are not a bubble: coarse grids know them.
LARGEST = 2000


class Bubbles:
    """The bubbles of a step.

    Args:
        cells: (M, d + 1) device array.
        density: (M,) device array [kg/m^3].
        extremes: of the density, lowest and highest.
        shape: M, N and d + 1.
        matrix: the pressure Laplacian in CSR: row offsets, columns, values.
        buffers: where arrays live between steps.
    """

    def __init__(
        self,
        cells: Any,
        density: Any,
        extremes: tuple[float, float],
        shape: tuple[int, int, int],
        matrix: tuple[Any, Any, Any],
        buffers: Buffers,
    ) -> None:
        self.count, self._matrix = 0, matrix
        names = {"offsets": True, "at": True, "energy": False}
        # Offsets, members and energies; nobody looks at them without bubbles.
        self.arrays = tuple(buffers.get(f"bubbles.{name}", 1, integer=kind) for name, kind in names.items())
        (lowest, highest), (elements, nodes, width) = extremes, shape
        if highest < JUMP * lowest:
            return
        label = buffers.get("bubbles.label", nodes, integer=True)
        limit = float(np.sqrt(lowest * highest))
        launch(deflation_kernels.connect_light, cells, density, label, limit, elements, nodes, width)
        offsets, members = _small(download(label, nodes))
        self.count = len(offsets) - 1
        if not self.count:
            return
        energy = buffers.get("bubbles.energy", self.count)
        self.arrays = (buffers.upload("bubbles.offsets", offsets), buffers.upload("bubbles.at", members), energy)
        launch(deflation_kernels.bubble_energies, *matrix, label, *self.arrays, self.count)

    def lift(self, b: Any, x: Any) -> None:
        """Set the level of x (N,) in every bubble so that the equations for b hold in the sum over its particles."""
        if self.count:
            launch(deflation_kernels.lift_bubbles, b, x, *self._matrix, *self.arrays, self.count)


def _small(label: Array) -> tuple[Array, Array]:
    """Offsets (B + 1,) and particles of the bubbles, from labels (N,) that are -1 outside the light fluid."""
    light = np.flatnonzero(label >= 0)
    of_light = label.take(light)
    size = np.bincount(of_light, minlength=1)
    size[np.argmax(size)] = LARGEST + 1  # the largest is no bubble, however small
    inside = light[size.take(of_light) <= LARGEST]
    inside = inside[np.argsort(label[inside], kind="stable")]
    starts = np.flatnonzero(np.diff(label[inside], prepend=-1))
    return np.append(starts, len(inside)).astype(np.int32), inside.astype(np.int32)
