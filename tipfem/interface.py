"""The interface rule: what an element that joins particles of several fluids is made of.

The rule of Carvalho & Sanches: particles carry the fluid's properties, the shape functions
interpolate them, and the interface runs through the mid-points of the edges between two fluids.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tipfem.fluid import Fluid
from tipfem.particles import Array


@dataclass(frozen=True)
class InterpolatedInterface:
    """Properties interpolated by the linear shape functions; one value an element, their mean.

    Using that one value in inertia, gravity and stabilisation alike keeps layers at rest within
    2 % of hydrostatic pressure; node-wise weights do not, or are unstable.
    """

    name: str = "interpolated"

    def element_properties(
        self, cells: Array, fluid: Array, fluids: Sequence[Fluid]
    ) -> tuple[Array, Array]:
        """Density (M,) [kg/m^3] and viscosity (M,) [Pa s] of the elements ``cells`` (M, d + 1)."""
        density = np.array([f.density for f in fluids])
        viscosity = np.array([f.viscosity for f in fluids])
        at_corner = fluid[cells]
        return density[at_corner].mean(axis=1), viscosity[at_corner].mean(axis=1)

    def fluid_fraction(self, cells: Array, fluid: Array, count: int) -> Array:
        """Part of each element that each fluid fills, (M, count).

        In 2-D the interface through the mid-edges cuts off a quarter of the element at a corner
        that is alone; in 3-D an eighth, and a half when two corners face two. An element of three
        fluids is shared evenly among its corners, an even cut through the centroid.
        """
        corners = cells.shape[1]
        number = np.stack([(fluid[cells] == f).sum(axis=1) for f in range(count)], axis=1)
        if corners == 3:
            share = np.array([0.0, 0.25, 0.75, 1.0])
        else:
            share = np.array([0.0, 0.125, 0.5, 0.875, 1.0])
        several = (number > 0).sum(axis=1) > 2
        return np.where(several[:, None], number / corners, share[number])
