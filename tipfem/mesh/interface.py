"""Interface rules: the properties of elements whose particles belong to several fluids.

The rule of Carvalho & Sanches: particles carry the fluid's properties, the shape functions
interpolate them, and the interface runs through the mid-points of the edges between two fluids.
The sharp rule: every cell belongs to one fluid, and the interface is a chain of edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tipfem.backend.arrays import taken
from tipfem.case.fluid import Fluid, typical_viscosity
from tipfem.mesh.mesh import Mesh
from tipfem.typing import Array


class InterfaceRule(Protocol):
    """The interface of a rule for elements between fluids."""

    def element_properties(self, mesh: Mesh, fluid: Array, fluids: Sequence[Fluid]) -> tuple[Array, Array]:
        """Density (M,) [kg/m^3] and viscosity (M,) [Pa s] of a mesh's elements, from the particles' ``fluid`` (N,)."""

    def fluid_fraction(self, mesh: Mesh, fluid: Array, count: int) -> Array:
        """Volume fraction (M, count) of each fluid in each element, from the particles' ``fluid`` (N,)."""


@dataclass(frozen=True)
class InterpolatedInterface:
    """Properties interpolated by the linear shape functions; each element has one value, their mean.

    Using that value in inertia, gravity and stabilisation alike keeps layers at rest within
    2 % of hydrostatic pressure; weights per node do not, or are unstable.
    """

    def element_properties(self, mesh: Mesh, fluid: Array, fluids: Sequence[Fluid]) -> tuple[Array, Array]:
        """Density (M,) [kg/m^3] and viscosity (M,) [Pa s] of a mesh's elements, from the particles' ``fluid`` (N,)."""
        density = np.array([f.density for f in fluids], dtype=float)
        viscosity = np.array([typical_viscosity(f) for f in fluids])
        at_corner = fluid[mesh.cells]
        return density[at_corner].mean(axis=1), viscosity[at_corner].mean(axis=1)

    def fluid_fraction(self, mesh: Mesh, fluid: Array, count: int) -> Array:
        """Volume fraction (M, count) of each fluid in each element, from the particles' ``fluid`` (N,).

        In 2-D the interface through the mid-edges cuts a quarter of the element off at a corner of a different
        fluid; in 3-D 1/8, or 1/2 if two corners are of each fluid. An element of three fluids is divided
        evenly among its corners.
        """
        cells, corners = mesh.cells, mesh.cells.shape[1]
        number = np.stack([(fluid[cells] == f).sum(axis=1) for f in range(count)], axis=1)
        if corners == 3:
            share = np.array([0.0, 0.25, 0.75, 1.0])
        else:
            share = np.array([0.0, 0.125, 0.5, 0.875, 1.0])
        several = (number > 0).sum(axis=1) > 2
        return np.asarray(np.where(several[:, None], number / corners, share[number]))


@dataclass(frozen=True)
class SharpInterface:
    """Every cell belongs to one fluid; the interface runs along edges.

    The kink of the linear pressure then coincides with the jump of the density: a flat interface is in
    balance on any mesh, and fluids at rest stay at rest. The mesh must have the fluids of its cells.
    """

    def element_properties(self, mesh: Mesh, fluid: Array, fluids: Sequence[Fluid]) -> tuple[Array, Array]:
        """Density (M,) [kg/m^3] and viscosity (M,) [Pa s] of a mesh's elements; ``fluid`` is not used."""
        density = np.array([f.density for f in fluids], dtype=float)
        viscosity = np.array([typical_viscosity(f) for f in fluids])
        density, viscosity = taken((density, viscosity), np.asarray(mesh.fluid))
        return density, viscosity

    def fluid_fraction(self, mesh: Mesh, fluid: Array, count: int) -> Array:
        """Volume fraction of each of ``count`` fluids in each element, (M, count): zero or one."""
        return np.asarray((np.asarray(mesh.fluid)[:, None] == np.arange(count)).astype(float))
