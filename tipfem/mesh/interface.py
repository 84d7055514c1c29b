"""Interface rules: what an element that joins particles of several fluids is made of.

The rule of Carvalho & Sanches: particles carry the fluid's properties, the shape functions
interpolate them, and the interface runs through the mid-points of the edges between two fluids.
The sharp rule: every element belongs to one fluid, and the interface is a chain of edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tipfem.case.fluid import Fluid
from tipfem.mesh.mesh import Mesh
from tipfem.typing import Array


class InterfaceRule(Protocol):
    """What a simulation asks of a rule."""

    def element_properties(self, mesh: Mesh, fluid: Array, fluids: Sequence[Fluid]) -> tuple[Array, Array]:
        """Density (M,) [kg/m^3] and viscosity (M,) [Pa s] of a mesh's elements, from the particles' ``fluid`` (N,)."""

    def fluid_fraction(self, mesh: Mesh, fluid: Array, count: int) -> Array:
        """Part of each element that each of ``count`` fluids fills, (M, count)."""


@dataclass(frozen=True)
class InterpolatedInterface:
    """Properties interpolated by the linear shape functions; one value an element, their mean.

    Using that one value in inertia, gravity and stabilisation alike keeps layers at rest within
    2 % of hydrostatic pressure; node-wise weights do not, or are unstable.
    """

    name: str = "interpolated"

    def element_properties(self, mesh: Mesh, fluid: Array, fluids: Sequence[Fluid]) -> tuple[Array, Array]:
        """Density (M,) [kg/m^3] and viscosity (M,) [Pa s] of a mesh's elements, from the particles' ``fluid`` (N,)."""
        density = np.array([f.density for f in fluids])
        viscosity = np.array([f.viscosity for f in fluids])
        at_corner = fluid[mesh.cells]
        return density[at_corner].mean(axis=1), viscosity[at_corner].mean(axis=1)

    def fluid_fraction(self, mesh: Mesh, fluid: Array, count: int) -> Array:
        """Part of each element that each fluid fills, (M, count).

        In 2-D the interface through the mid-edges cuts off a quarter of the element at a corner
        that is alone; in 3-D an eighth, and a half when two corners face two. An element of three
        fluids is shared evenly among its corners, an even cut through the centroid.
        """
        cells, corners = mesh.cells, mesh.cells.shape[1]
        number = np.stack([(fluid[cells] == f).sum(axis=1) for f in range(count)], axis=1)
        if corners == 3:
            share = np.array([0.0, 0.25, 0.75, 1.0])
        else:
            share = np.array([0.0, 0.125, 0.5, 0.875, 1.0])
        several = (number > 0).sum(axis=1) > 2
        return np.where(several[:, None], number / corners, share[number])


@dataclass(frozen=True)
class SharpInterface:
    """Every element belongs to one fluid; the interface runs along edges.

    The kink of the linear pressure then stands exactly where density jumps: a flat interface is in
    balance on any mesh, and fluids at rest stay at rest. The mesh must know the fluid of its elements.
    """

    name: str = "sharp"

    def element_properties(self, mesh: Mesh, fluid: Array, fluids: Sequence[Fluid]) -> tuple[Array, Array]:
        """Density (M,) [kg/m^3] and viscosity (M,) [Pa s] of a mesh's elements; the particles' ``fluid`` has no say."""
        density = np.array([f.density for f in fluids])
        viscosity = np.array([f.viscosity for f in fluids])
        of = np.asarray(mesh.fluid)
        return density.take(of), viscosity.take(of)

    def fluid_fraction(self, mesh: Mesh, fluid: Array, count: int) -> Array:
        """Part of each element that each fluid fills, (M, count): all or nothing."""
        return (np.asarray(mesh.fluid)[:, None] == np.arange(count)).astype(float)


INTERFACES: dict[str, type[InterfaceRule]] = {"interpolated": InterpolatedInterface, "sharp": SharpInterface}
