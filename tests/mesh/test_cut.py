"""The mesh cut along its interfaces: a node for each particle and connected component."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.case.fluid import ranks
from tipfem.geometry.place import places
from tipfem.mesh.cut import cut_along_interfaces
from tipfem.mesh.delaunay import triangulate
from tipfem.mesh.mesh import Mesh
from tipfem.remesh.triangles.fitted import with_fluids

FLUIDS = [tp.Fluid(name, density=rho, viscosity=1e-3) for name, rho in (("water", 1000), ("oil", 800), ("air", 1.2))]
DENSITY = np.array([f.density for f in FLUIDS])


def three_fluids():
    """Water, oil with a drop of water in it, and air beside both."""
    tank = tp.tank((1.0, 1.0), 0.05, jitter=0.2, seed=4).fill(FLUIDS[0]).fill(FLUIDS[1], box=((0, 0.5), (1, 1)))
    tank = tank.fill(FLUIDS[2], box=((0.6, 0.2), (1, 0.8))).fill(FLUIDS[0], disc=((0.3, 0.75), 0.12))
    particles = tank.sample(FLUIDS)
    return with_fluids(triangulate(particles.position, particles.wall, 0.05), particles, ranks(FLUIDS))


def test_there_is_one_node_for_each_particle_and_component():
    mesh = three_fluids()
    cut = cut_along_interfaces(mesh, DENSITY[mesh.fluid])
    label, n = mesh.components.label, len(mesh.position)
    assert len(mesh.components) == 4
    wanted = {(i, k) for cell, k in zip(mesh.cells.tolist(), label.tolist(), strict=True) for i in cell}
    found = list(zip(cut.owner.tolist(), cut.component.tolist(), strict=True))
    assert sorted(found) == sorted(wanted)
    assert cut.copies == len(wanted) - n > 40
    assert np.bincount(cut.owner).max() == 3  # where three fluids meet
    np.testing.assert_array_equal(cut.owner[:n], np.arange(n))
    assert (np.diff(places(mesh.position)[cut.owner[n:]]) >= 0).all()
    assert len(np.unique(cut.owner[n:])) == 1 + np.count_nonzero(np.diff(cut.owner[n:]))
    np.testing.assert_array_equal(cut.owner[cut.mesh.cells], mesh.cells)
    np.testing.assert_array_equal(cut.component[cut.mesh.cells], np.repeat(label[:, None], 3, axis=1))
    np.testing.assert_array_equal(cut.mesh.position, mesh.position[cut.owner])
    np.testing.assert_array_equal(cut.fluids, mesh.components.fluid)
    corners = np.bincount(mesh.cells.ravel())[np.unique(cut.owner[n:])]
    assert (cut.corners, cut.pairs) == (corners.sum(), (corners**2).sum())


def test_particles_keep_their_numbers_in_the_heaviest_fluid():
    mesh = three_fluids()
    cut = cut_along_interfaces(mesh, DENSITY[mesh.fluid])
    heaviest = np.zeros(len(mesh.position))
    np.maximum.at(heaviest, mesh.cells, DENSITY[mesh.fluid][:, None])
    np.testing.assert_array_equal(DENSITY[cut.fluids[cut.component[: cut.particles]]], heaviest)


def test_the_cut_equals_that_by_numpy():
    """Node by node: copies are sorted by places and components."""
    mesh = three_fluids()
    rank, label, n = DENSITY[mesh.fluid], mesh.components.label, len(mesh.position)
    cut = cut_along_interfaces(mesh, rank)
    pairs = sorted({(i, k) for cell, k in zip(mesh.cells.tolist(), label.tolist(), strict=True) for i in cell})
    at, density = places(mesh.position), DENSITY[mesh.components.fluid]
    heaviest = {i: k for i, k in sorted(pairs, key=lambda pair: (density[pair[1]], -pair[1]))}
    copies = sorted((at[i], k, i) for i, k in pairs if heaviest[i] != k)
    node = {(i, k): n + number for number, (_, k, i) in enumerate(copies)}
    cells = [[node.get((i, k), i) for i in cell] for cell, k in zip(mesh.cells.tolist(), label.tolist(), strict=True)]
    np.testing.assert_array_equal(cut.mesh.cells, cells)
    np.testing.assert_array_equal(cut.owner[n:], [i for *_, i in copies])
    np.testing.assert_array_equal(cut.component[n:], [k for _, k, _ in copies])


def test_particles_that_are_kept_whole_have_one_node():
    mesh = three_fluids()
    whole = mesh.position[:, 0] < 0.4
    cut, everywhere = (cut_along_interfaces(mesh, DENSITY[mesh.fluid], which) for which in (whole, None))
    copied = cut.owner[cut.copied]
    np.testing.assert_array_equal(copied, [i for i in everywhere.owner[everywhere.copied] if not whole[i]])
    assert 0 < len(copied) < everywhere.copies
    np.testing.assert_array_equal(cut.owner[cut.mesh.cells], mesh.cells)
    np.testing.assert_array_equal(cut.fluids, mesh.components.fluid)


def test_one_fluid_is_not_cut():
    mesh = three_fluids()
    water = with_fluids(Mesh(mesh.position, mesh.cells), particles_of_one(mesh), ranks(FLUIDS))
    cut = cut_along_interfaces(water, DENSITY[water.fluid])
    assert cut.copies == 0
    np.testing.assert_array_equal(cut.mesh.cells, mesh.cells)


def particles_of_one(mesh):
    """All particles of a mesh in one fluid."""
    nothing = np.zeros(len(mesh.position))
    return tp.Particles(mesh.position, nothing, nothing, spacing=0.05)


def test_a_mesh_without_components_is_refused():
    mesh = three_fluids()
    with pytest.raises(ValueError, match="components of this mesh are not labelled"):
        cut_along_interfaces(Mesh(mesh.position, mesh.cells, mesh.fluid), DENSITY[mesh.fluid])
