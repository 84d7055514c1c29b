"""Pressures on the sides of interfaces for particles that came to a fluid or left one."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.physics.side_pressures.carried import SWEEPS, pressures_on_sides

DENSITY = np.array([1000.0, 1.2])
PUSH = np.array([3.0, -9.81])  # b - a [m/s^2]


@pytest.fixture
def layers(water, air):
    """A mesh of water below air, and the pressure (2, N) of each fluid: linear, with a jump of 40 Pa between them."""
    tank = tp.tank((1.0, 1.0), 0.1).fill(air).fill(water, box=((0, 0), (1, 0.5)))
    state = tp.Simulation(tp.Case(tank, [water, air], (0, -9.81))).state
    along = state.mesh.position @ PUSH
    side = 500.0 + DENSITY[:, None] * along + np.array([[0.0], [40.0]])
    return state.mesh, state.particles.fluid, side


def carried(layers, known, pressure, jump):
    mesh, fluid, _ = layers
    acceleration = np.tile(PUSH, (len(mesh.position), 1))
    return pressures_on_sides(pressure, jump, known, mesh, fluid, DENSITY, acceleration)


def by_numpy(pressure, jump, known, mesh, fluid, acceleration):
    """`pressures_on_sides`, cell by cell."""
    there, side = mesh.components.at_particle >= 0, pressure + jump
    known = known & there
    for _ in range(SWEEPS):
        lists = {}
        for f, cell in zip(mesh.fluid.tolist(), mesh.cells.tolist(), strict=True):
            for a in cell:
                if there[f, a] and not known[f, a]:
                    near = [b for b in cell if known[f, b]]
                    away = [mesh.position[a] - mesh.position[b] for b in near]
                    values = [side[f, b] + DENSITY[f] * d @ acceleration[b] for b, d in zip(near, away, strict=True)]
                    lists.setdefault((f, a), []).extend(values)
        for at, values in lists.items():
            if values:
                side[at], known[at] = np.mean(values), True
    carried = np.where(known.any(axis=0), side[fluid, np.arange(len(fluid))], pressure)
    return carried, np.where(there, side - carried, 0.0)


def test_pressures_equal_those_by_numpy(layers):
    """With a third of all pressures unknown, and none known in a large part, more than the sweeps fill."""
    mesh, fluid, side = layers
    rng = np.random.default_rng(8)
    known = (rng.random(side.shape) < 0.67) & (mesh.position[:, 0] < 0.35)
    pressure, jump = rng.normal(size=len(fluid)), rng.normal(size=side.shape)
    acceleration = rng.normal(size=(len(fluid), 2))
    found = pressures_on_sides(pressure, jump, known, mesh, fluid, DENSITY, acceleration)
    for got, wanted in zip(found, by_numpy(pressure, jump, known, mesh, fluid, acceleration), strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-12, atol=1e-12)


def test_what_is_known_stays(layers):
    mesh, fluid, side = layers
    there = mesh.components.at_particle >= 0
    pressure = side[fluid, np.arange(len(fluid))]
    jump = np.where(there, side - pressure, 0.0)
    same = carried(layers, there, pressure, jump)
    np.testing.assert_array_equal(same[0], pressure)
    np.testing.assert_allclose(same[1], jump, atol=1e-9)


def test_new_sides_go_on_with_the_pressure_of_their_fluid(layers):
    """Of the interface, neither fluid is known at every second particle, and the air at the others."""
    mesh, fluid, side = layers
    there = mesh.components.at_particle >= 0
    on = np.flatnonzero(there.all(axis=0))
    known = there.copy()
    known[1, on] = False
    known[:, on[::2]] = False
    pressure = np.where(known.any(axis=0), side[fluid, np.arange(len(fluid))], -1e4)
    got, jump = carried(layers, known, pressure, np.zeros_like(side))
    np.testing.assert_allclose(got, side[fluid, np.arange(len(fluid))], rtol=1e-12)
    np.testing.assert_allclose(jump[1, on], (side[1] - side[0])[on], rtol=1e-10)
    assert not jump[~there].any()


def test_a_particle_that_the_heavier_fluid_left_has_the_pressure_of_the_lighter(layers):
    """Its pressure was the water's, and the jump told the air's."""
    mesh, fluid, side = layers
    there = mesh.components.at_particle >= 0
    left = int(np.flatnonzero(there[1] & ~there[0])[0])
    known = there.copy()
    known[0, left] = True
    pressure = side[fluid, np.arange(len(fluid))]
    jump = np.where(known, side - pressure, 0.0)
    pressure[left], jump[0, left], jump[1, left] = side[0, left], 0.0, side[1, left] - side[0, left]
    got, jump = carried(layers, known, pressure, jump)
    assert got[left] == pytest.approx(side[1, left], rel=1e-12)
    assert not jump[:, left].any()


def test_without_any_neighbour_that_is_known_the_pressure_is_what_was_carried(layers):
    mesh, _, side = layers
    pressure = np.arange(len(mesh.position), dtype=float)
    got, jump = carried(layers, np.zeros(side.shape, dtype=bool), pressure, np.zeros_like(side))
    np.testing.assert_array_equal(got, pressure)
    assert not jump.any()
