"""The source term that restores the volume each fluid lost by remeshing and relocation."""

from __future__ import annotations

import math

import numpy as np

from tipfem.mesh.mesh import Mesh
from tipfem.typing import Array

# Largest |s_f| of a step. Otherwise a fluid of which almost nothing is left would have to grow many times over in one
# step, and the elements around it to negative volumes.
LARGEST_GROWTH = 0.05

# Largest part of the missing volume that is restored in a step: where almost nothing is missing, and where CALM of a
# fluid's volume or more is. Edge flips at an interface change volumes by less than CALM, back and forth; a source that
# followed them within a step or two would make the pressure jump at each flip.
SMALLEST_PART, LARGEST_PART = 0.1, 0.5
CALM = 0.005


class VolumeControl:
    """Restores the volumes of the fluids smoothly, because jumps of the source are jumps of the pressure.

    A remeshing changes volumes by jumps, back and forth. What counts as missing therefore follows the measured
    loss with a delay of 1 / (4 rate): together with the source, this is a critically damped loop with the decay rate 2
    rate. Where steps are long compared with 1 / rate, it takes ten steps while little is missing, see `part`.

    Args:
        wanted: (F,) volume that each fluid should have [m^2, or m^3 in 3-D].
        rate: part of the missing volume that is restored per time [1/s]; 0 for no source.
        balanced: whether walls surround the fluids; see `volume_source`.
    """

    def __init__(self, wanted: Array, rate: float, *, balanced: bool = True) -> None:
        self.wanted, self.rate, self.balanced = wanted, rate, balanced
        self.missing = np.zeros(len(wanted))

    def part(self, dt: float) -> float:
        """Part of the missing volume that is restored in a step of length ``dt`` [s]."""
        error = np.divide(np.abs(self.missing), self.wanted, out=np.zeros(len(self.wanted)), where=self.wanted > 0)
        urgent = min(float(error.max()) / CALM, 1.0)
        return min(self.rate * dt, SMALLEST_PART + urgent * (LARGEST_PART - SMALLEST_PART))

    def observe(self, volume: Array, dt: float) -> None:
        """Update the missing volumes from the volumes (F,) after a step of length ``dt`` [s]."""
        change = (1 - math.exp(-4 * self.part(dt))) * (self.wanted - volume - self.missing)
        self.missing = self.missing + change

    def source(self, mesh: Mesh, fraction: Array, dt: float) -> Array:
        """Growth s (M,) of a mesh's elements in a step of length ``dt`` [s]; see `volume_source`."""
        wanted = mesh.measure @ fraction + self.missing
        return volume_source(mesh, fraction, wanted, self.part(dt), balanced=self.balanced)


def volume_source(mesh: Mesh, fraction: Array, initial_volume: Array, part: float, *, balanced: bool = True) -> Array:
    """Growth s (M,) of each element in the constraint J = 1 + s.

    s_f = part (V0_f - V_f) / V_f with one part of the missing volume for all fluids: if ``balanced``, in a closed tank,
    where one fluid loses what the others gain, the elements' total growth is zero. If any |s_f| would exceed 0.05, the
    part is reduced, again equally for all fluids. ``fraction`` (M, F) is that of each fluid in each element.
    """
    volume = mesh.measure @ fraction
    missing = np.divide(initial_volume - volume, volume, out=np.zeros(len(volume)), where=volume > 0)
    largest = part * float(np.abs(missing).max())
    if largest > LARGEST_GROWTH:
        part *= LARGEST_GROWTH / largest
    growth = part * fraction @ missing
    if not balanced:
        return np.asarray(growth)
    # A fluid that has vanished from the mesh cannot grow; the total must still be zero.
    return np.asarray(growth - float(growth @ mesh.measure) / float(mesh.measure.sum()))
