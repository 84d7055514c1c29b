"""Momentum transfer at remeshing."""

from __future__ import annotations

import numpy as np
import pytest
from mesh_twins import nodal_mass

import tipfem as tp
from tipfem.mesh.delaunay import triangulate
from tipfem.remesh.momentum_transfer import nodal_density, transfer_momentum


@pytest.fixture
def cloud(water):
    """A jittered cloud with random velocities, and its mesh."""
    particles = tp.tank((1, 1), 0.1, jitter=0.2).fill(water).sample([water])
    rng = np.random.default_rng(0)
    off_wall = ~particles.wall[:, None]
    particles.velocity = off_wall * rng.normal(size=particles.position.shape)
    particles.acceleration = off_wall * rng.normal(size=particles.position.shape)
    return particles, triangulate(particles.position, particles.wall, 0.1)


def neighbours(mesh, i):
    """Particles joined to particle i by an edge."""
    edges = mesh.edges[(mesh.edges == i).any(axis=1)]
    return edges[edges != i]


def test_nodal_density_is_the_mean_by_measure(cloud):
    """Against a loop; of a constant it is the constant."""
    particles, mesh = cloud
    density = np.random.default_rng(1).uniform(1, 1000, len(mesh.cells))
    volume = nodal_mass(mesh, np.ones(len(mesh.cells)))
    result = nodal_density(nodal_mass(mesh, density), volume)
    for i in (0, 17, 60):
        at = (mesh.cells == i).any(axis=1)
        assert result[i] == pytest.approx((density[at] @ mesh.measure[at]) / mesh.measure[at].sum())
    np.testing.assert_allclose(nodal_density(7.0 * volume, volume), 7.0)
    assert np.isnan(nodal_density(np.zeros(2), np.array([1.0, 0.0]))).tolist() == [False, True]
    assert len(result) == len(particles)


def test_nothing_changes_where_nothing_became_heavier(cloud):
    """Constant, falling and unknown (relocated) densities leave the state as it is."""
    particles, mesh = cloud
    before = np.full(len(particles), 500.0)
    for after in (before, before - 400.0, before * 1.005):
        assert transfer_momentum(particles, mesh, before, after) is particles
    assert transfer_momentum(particles, mesh, np.full(len(particles), np.nan), before) is particles


def test_what_became_heavier_takes_the_motion_of_where_its_mass_came_from(cloud):
    """One light particle among heavy ones: v = (rho v + (rho' - rho) vbar) / rho', walls give nothing."""
    particles, mesh = cloud
    touching = [i for i in np.flatnonzero(~particles.wall) if particles.wall[neighbours(mesh, i)].any()]
    for i in (touching[0], np.flatnonzero(~particles.wall)[40]):
        before, after = np.full(len(particles), 900.0), np.full(len(particles), 900.0)
        before[i], after[i] = 1.2, 300.0
        changed = transfer_momentum(particles, mesh, before, after)
        donors = [j for j in neighbours(mesh, i) if not particles.wall[j]]
        for name in ("velocity", "acceleration"):
            old, new = getattr(particles, name), getattr(changed, name)
            expected = (1.2 * old[i] + (300.0 - 1.2) * old[donors].mean(axis=0)) / 300.0
            np.testing.assert_allclose(new[i], expected, rtol=1e-12)
            others = np.arange(len(particles)) != i
            np.testing.assert_array_equal(new[others], old[others])
    np.testing.assert_array_equal(changed.position, particles.position)


def test_energy_does_not_grow_when_light_particles_turn_heavy(cloud):
    """Kinetic energy with the new masses is far below what it would be with the old velocities."""
    particles, mesh = cloud
    light = ~particles.wall & (particles.position[:, 0] < 0.5)
    particles.velocity[light] *= 10
    particles.velocity[~light] *= 0.1
    before, after = np.where(light, 1.2, 900.0), np.full(len(particles), 900.0)
    changed = transfer_momentum(particles, mesh, before, after)
    beside_heavy = np.array([light[i] and (before[neighbours(mesh, i)] > 2).any() for i in range(len(particles))])
    beside_heavy &= np.array([(~light & ~particles.wall)[neighbours(mesh, i)].any() for i in range(len(particles))])
    assert beside_heavy.sum() > 5
    speed_before = np.linalg.norm(particles.velocity[beside_heavy], axis=1)
    speed_after = np.linalg.norm(changed.velocity[beside_heavy], axis=1)
    assert (speed_after**2).sum() < 1e-3 * (speed_before**2).sum()
    np.testing.assert_array_equal(changed.velocity[particles.wall], 0.0)
