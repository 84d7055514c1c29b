"""Kernels of the faces on walls with friction, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from tipfem.backend.launch import launch
from tipfem.geometry.period import Period, no_period
from tipfem.physics.walls import kernels
from tipfem.physics.walls.layers import DRY, FLOWS, REACH, RESOLVED

COUNT, FACES, POINTS, WALLS = 30, 20, 25, 3
RNG = np.random.default_rng(5)


def projected(vectors, normal):
    return vectors - (vectors * normal).sum(axis=1)[:, None] * normal


@pytest.mark.parametrize(("d", "width"), [(2, 0.0), (2, 1.0), (3, 0.0)])
def test_what_is_seen_of_faces_equals_numpy(d, width):
    """In a tank that turns, with walls that slide along themselves by velocities and by speeds."""
    period = Period(np.array([width, 0.0])) if width else no_period(d)
    cells = np.stack([RNG.permutation(COUNT)[: d + 1] for _ in range(FACES)]).astype(np.int32)
    nodes, cell = np.ascontiguousarray(cells[:, :d]), np.arange(FACES, dtype=np.int32)
    wall = RNG.integers(0, WALLS, FACES).astype(np.int32)
    inward = RNG.normal(size=(FACES, d))
    inward /= np.linalg.norm(inward, axis=1)[:, None]
    direction = RNG.normal(size=(FACES, d))
    position, velocity, acceleration, predicted, frame = RNG.random((5, COUNT, d))
    target, poses, own = RNG.random(COUNT), RNG.normal(size=(2, 2 * d + 2 * d * d)), RNG.normal(size=(2, WALLS, d + 1))
    dt, cf = 0.3, 0.7

    def along(m, x, n):
        v, centre, spin, turn = np.split(poses[m], [d, 2 * d, 2 * d + d * d])
        spin, turn = spin.reshape(d, d), turn.reshape(d, d)
        slides = own[m, wall, :d] + own[m, wall, d][:, None] * direction
        return v + (x - centre) @ spin.T + np.repeat(slides @ turn.T, n, axis=0).reshape(x.shape)

    turn = poses[0, 2 * d + d * d :].reshape(d, d)
    apex = cells[:, d]
    v = velocity[apex] + 0.5 * dt * acceleration[apex]
    v = v - 0.5 * (along(0, position[apex], 1) + along(1, position[apex], 1))
    now, then = along(0, position[nodes], d), along(1, predicted[nodes], d)
    sides = period.shortest(position[nodes[:, 1:]] - position[nodes[:, :1]])
    spanned = sides[:, 0] if d == 2 else 0.5 * np.cross(sides[:, 0], sides[:, 1])
    middle = frame[nodes[:, 0]] + period.shortest(frame[nodes] - frame[nodes[:, :1]]).mean(axis=1)
    expected = (
        projected(v @ turn, inward),
        projected((velocity[nodes] - now).mean(axis=1) @ turn, inward),
        period.wrapped(middle),
        target[nodes].mean(axis=1),
        ((1 - cf) * now + cf * then).reshape(FACES, d * d),
        np.linalg.norm(spanned, axis=1),
    )
    found = [np.full_like(values, np.nan) for values in expected]
    faces = kernels.FacesOnWalls(nodes, cell, wall, inward, direction)
    particles = kernels.SeenParticles(position, velocity, acceleration, predicted, frame, target)
    motion = period.array, poses, own.reshape(2, -1)
    launch(kernels.see_faces, faces, cells, particles, *motion, kernels.Seen(*found), dt, cf, d)
    for got, wanted in zip(found, expected, strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-12, atol=1e-12)


def test_layers_advance_as_in_numpy():
    """Also where fluids change, the flow stops, and the layer is thicker than the mesh resolves."""
    part = np.sort(RNG.integers(0, 3, FACES)).astype(np.int32)
    face, point = RNG.integers(0, FACES, POINTS).astype(np.int32), RNG.integers(0, POINTS, FACES).astype(np.int32)
    distance, spacing = 2 * RNG.random(POINTS), 0.5 + RNG.random(FACES)
    before, fluid = RNG.integers(DRY, 2, POINTS).astype(np.int32), RNG.integers(0, 2, FACES).astype(np.int32)
    history, velocity = RNG.normal(size=(POINTS, 2)), RNG.normal(size=(FACES, 2))
    velocity[::5], viscosity, dt = 0.0, 10.0 ** RNG.uniform(-4, 0, FACES), 0.1
    here = np.where(distance < REACH * spacing[face], fluid[face], DRY)
    old = np.where((here == before)[:, None], history, 0.0)
    u = velocity[face]
    speed, start = np.linalg.norm(u, axis=1), np.linalg.norm(old, axis=1)
    new = old + (4 / np.pi * dt * viscosity[face] * speed)[:, None] * u
    size, most = np.linalg.norm(new, axis=1), np.maximum((spacing[face] * speed) ** 2, start)
    new *= np.where(size > most, most / np.maximum(size, 1e-300), 1.0)[:, None]
    flux = 0.5 * (start**0.5 + np.linalg.norm(new, axis=1) ** 0.5)
    mean = np.where(here[point] == fluid, flux[point], 0.0)
    speed, half = np.linalg.norm(velocity, axis=1), 0.5 * spacing
    thickness = np.where(mean < half * speed, mean / np.maximum(speed, 1e-300), half)
    length = np.maximum(0.5 * np.pi * thickness * (1 - 2 * thickness / spacing), RESOLVED * spacing)
    usual = np.array([np.sqrt((speed[part == k] ** 2).mean()) for k in part])
    resolved = (mean > 0) & (mean >= half * np.maximum(speed, FLOWS * usual))
    assert 0 < resolved.sum() < FACES
    expected = here, np.where((here != DRY)[:, None], new, 0.0), flux, length, resolved.astype(np.int8)
    found = here.astype(np.int32), np.empty((POINTS, 2)), *np.empty((2, max(FACES, POINTS)))
    found = *found[:2], found[2][:POINTS], found[3][:FACES], np.empty(FACES, dtype=np.int8)
    points = kernels.LayerPoints(distance, face, before, history)
    faces = kernels.LayerFaceArrays(fluid, velocity, viscosity, spacing, part, point)
    numbers = dt, REACH, FLOWS, RESOLVED
    launch(kernels.advance_layers, points, faces, *numbers, kernels.AdvancedLayers(*found), 2)
    for got, wanted in zip(found, expected, strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-12)


def test_particles_stick_where_the_more_viscous_fluid_is_resolved():
    part = np.sort(RNG.integers(0, 3, FACES)).astype(np.int32)
    nodes, viscosity = RNG.integers(0, 12, (FACES, 2)).astype(np.int32), RNG.random(FACES)
    resolved, weight, found = RNG.random(FACES) < 0.5, np.zeros((12, 2)), np.zeros(12, dtype=np.int8)
    expected = np.zeros(12, dtype=bool)
    for k in range(3):
        at, w = nodes[part == k].ravel(), np.repeat(viscosity[part == k], 2)
        held = np.bincount(at, w * np.repeat(resolved[part == k], 2), 12)
        expected |= held > 0.5 * np.bincount(at, w, 12)
    launch(kernels.stick_to_layers, nodes, part, viscosity, resolved.view(np.int8), weight, found, 2)
    np.testing.assert_array_equal(found.astype(bool), expected)
    assert 0 < expected.sum() < 12
    assert not weight.any()
