"""Target spacings of the particles in a case with a grading."""

from __future__ import annotations

import numpy as np

from tipfem.backend.launch import launch
from tipfem.case.grading import Grading
from tipfem.case.particles import Particles
from tipfem.mesh.components import ON_INTERFACE
from tipfem.mesh.mesh import Mesh
from tipfem.remesh.sizing import limit_gradation
from tipfem.remesh.volumes import with_components
from tipfem.timers import timer


def graded(particles: Particles, mesh: Mesh, names: list[str], grading: Grading | None) -> Particles:
    """The particles with their target spacings; those that they have without a grading.

    Args:
        particles: they moved with the mesh.
        mesh: of one step, with the cells' fluids.
        names: of the fluids.
        grading: of the case, None for none.
    """
    if grading is None:
        return particles
    with timer("grading"):
        largest = grading.of_fluids(names, particles.spacing)
        components = with_components(mesh, len(names)).components
        assert components is not None
        at_interface = components.mark & ON_INTERFACE > 0
        target = grading.sizing(particles.position, particles.fluid, at_interface, largest, particles.spacing)
        lowered = np.zeros(len(target), dtype=np.int32)
        launch(limit_gradation, particles.position, mesh.cells, mesh.period.array, target, lowered, grading.growth)
        return particles.shallow_copy(target=target)
