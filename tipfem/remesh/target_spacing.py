"""Target spacings of the particles: those of a case's grading, and those that physics ask for."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from tipfem.backend.launch import launch
from tipfem.case.grading import Grading
from tipfem.case.particles import Particles
from tipfem.geometry.period import Period
from tipfem.mesh.components import ON_INTERFACE
from tipfem.mesh.mesh import Mesh
from tipfem.physics.carried import Carried
from tipfem.remesh.cavity.arrays import Simplices
from tipfem.remesh.gradation import limit_gradation, lower_in_films
from tipfem.remesh.volumes import with_components
from tipfem.timers import timer
from tipfem.typing import Array

GROWTH = 0.3  # largest gradient of the targets without a grading


def graded(
    particles: Particles, mesh: Mesh, names: list[str], grading: Grading | None, parts: Iterable[Carried] = ()
) -> Particles:
    """The particles with their target spacings: the case's one, unless there is a grading or a part asks for less.

    Args:
        particles: they moved with the mesh.
        mesh: of one step, with the cells' fluids.
        names: of the fluids.
        grading: of the case, None for none.
        parts: of the state, see `Carried.targets`.
    """
    asked = [targets for part in parts if (targets := part.targets(particles.position, particles.spacing)) is not None]
    if grading is None and not asked and particles.target.min() == particles.spacing == particles.target.max():
        return particles
    with timer("grading"):
        target = np.full(len(particles), particles.spacing)
        if grading is not None:
            largest = grading.of_fluids(names, particles.spacing)
            components = with_components(mesh, len(names)).components
            assert components is not None
            fine = (components.mark & ON_INTERFACE > 0) | mesh.at_empty_space
            fluid = np.where(mesh.used, particles.fluid, -1)
            target = grading.sizing(particles.position, fluid, fine, largest, particles.spacing)
            if grading.film_resolution is not None:
                given = particles.position, mesh.cells, mesh.neighbours, np.asarray(mesh.fluid)
                target = film_targets(*given, np.ones(len(names)), fine, target, grading.film_resolution)
        for targets in asked:
            target = np.minimum(target, targets)
        growth = GROWTH if grading is None else grading.growth
        return particles.shallow_copy(target=limited(particles.position, mesh.all_cells, mesh.period, target, growth))


def limited(position: Array, cells: Array, period: Period, target: Array, growth: float) -> Array:
    """The ``target`` spacings (N,) [m], lowered until they grow by at most ``growth`` along every edge of the cells."""
    lowered = np.zeros(len(target), dtype=np.int32)
    launch(limit_gradation, position, cells, period.array, target, lowered, growth, position.shape[1])
    return target


def film_targets(
    x: Array, cells: Array, across: Array, label: Array, fills: Array, free: Array, target: Array, finest: float
) -> Array:
    """The ``target`` spacings (N,) [m], lowered where a fluid is thinner; see `tipfem.Grading.film_resolution`.

    Args:
        x: (N, d) positions [m].
        cells: (M, d + 1) with the cells ``across`` their faces, below 0 for none, and their ``label`` (M,).
        fills: (L,) mask of the labels that are fluids.
        free: (N,) mask of the particles on interfaces and free surfaces.
        finest: the smallest target [m].
    """
    dim, lowered = x.shape[1], np.array(target, dtype=float)
    mesh = Simplices(x, cells, across, label, free.astype(np.int32), lowered, dim)
    launch(lower_in_films, mesh, fills.astype(np.int32), np.zeros((len(x), len(fills) * dim)), finest)
    return lowered
