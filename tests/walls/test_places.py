"""Particles that slide along walls in 3-D, and go back to their places."""

from __future__ import annotations

import numpy as np

import tipfem as tp
from tipfem.physics.walls.places import FAR, back_to_places

WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)


def test_what_slid_too_far_has_there_what_the_fluid_has():
    """Exactly so for fields that are linear; a particle that slid less stays."""
    tank = tp.tank((1, 1, 1), 0.2, jitter=0.1).fill(WATER).wall("left", slip=True)
    simulation = tp.Simulation(tp.Case(tank, [WATER], (0, 0, -9.81), interface="interpolated"), time_step=1e-3)
    particles, mesh = simulation.particles.copy(), simulation.mesh
    near = np.abs(particles.position - [0.0, 0.4, 0.4]).max(axis=1) < 0.11
    i = int(np.flatnonzero(near & (particles.position[:, 0] == 0))[0])
    k = int(np.flatnonzero(np.abs(particles.position - [0.0, 0.6, 0.2]).max(axis=1) < 0.05)[0])
    home = particles.position[[i, k]].copy()
    particles.position[i] += [0.0, 0.6 * FAR * 0.2, 0.9 * FAR * 0.2]
    particles.position[k] += [0.0, 0.5 * FAR * 0.2, 0.5 * FAR * 0.2]
    slope = np.array([[1.0, 2.0, -1.0], [0.5, 0.0, 3.0], [-2.0, 1.0, 1.0]])
    particles.velocity[:] = particles.position @ slope
    particles.pressure[:] = 5 - 9810 * particles.position[:, 2]
    before = particles.position[k].copy()
    assert back_to_places(particles, mesh, np.array([i, k]), home) == 1
    np.testing.assert_array_equal(particles.position[[i, k]], [home[0], before])
    np.testing.assert_allclose(particles.velocity, particles.position @ slope, atol=1e-12)
    np.testing.assert_allclose(particles.pressure, 5 - 9810 * particles.position[:, 2], rtol=1e-12)
