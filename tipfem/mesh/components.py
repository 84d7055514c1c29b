"""Connected components of the fluids of a mesh whose interfaces run along facets."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from tipfem.scratch import scratch
from tipfem.typing import Array

# Bits of `Components.mark`.
ON_INTERFACE, ON_HULL = 1, 2


@dataclass(frozen=True)
class Components:
    """The K connected components of F fluids in M cells on N particles; they depend on the connectivity only."""

    label: Array  # (M,) component of each cell, int32; numbered from 0, the largest when they were labelled, by volume
    fluid: Array  # (K,) fluid of each component, int32
    at_particle: Array  # (F, N) the largest component of each fluid at each particle, -1 for none, int32
    mark: Array  # (N,) of each particle, int32: `ON_INTERFACE`, `ON_HULL`, their sum for both, 0 for neither
    movable: Array  # (K,) mask of the components with a particle on an interface and off the hull
    interface_cells: Array  # numbers of the cells with such a particle, int32

    def __len__(self) -> int:
        return len(self.fluid)

    @property
    def movable_particles(self) -> Array:
        """Numbers of the particles on an interface and off the hull, int32."""
        there = np.equal(self.mark, ON_INTERFACE, out=scratch("components.movable", len(self.mark), bool))
        return np.flatnonzero(there).astype(np.int32)

    def renumbered(self, kept: Array) -> Components:
        """The same components when only the particles ``kept`` (N',), which have all cells, remain in this order."""
        return dataclasses.replace(
            self, at_particle=self.at_particle.take(kept, axis=1), mark=self.mark.take(kept, axis=0)
        )
