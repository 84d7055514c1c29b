"""Remeshers: first meshes, meshes after relocation, moving walls; bad input is refused."""

from __future__ import annotations

import numpy as np
import pytest
from states import first_state, moved_to

import tipfem as tp
from tipfem.case.case import INTERFACES
from tipfem.case.fluid import ranks
from tipfem.case.numerics import RelocationRule
from tipfem.mesh.delaunay import triangulate, wall_fluid
from tipfem.mesh.mesh import Mesh
from tipfem.remesh.choice import REMESHERS
from tipfem.remesh.meshers import TankMesher
from tipfem.remesh.remeshers import DelaunayRemesher, FittedRemesher
from tipfem.remesh.triangles import fitted


def test_a_fitted_start_gives_triangles_of_each_part(water, air):
    fluids = [water, air]
    tank = tp.tank((1, 1), 0.07, jitter=0.2).fill(air).fill(water, where=lambda x: x[:, 1] < 0.3 + 0.4 * x[:, 0])
    remesher = FittedRemesher(fluids, fitted.FittedRule(), walls_have_fluids=False, keep=True)
    first = first_state(remesher, tank.sample(fluids, fitted=True), reference=5)
    particles, mesh = first.particles, first.mesh
    middle = particles.position[mesh.cells].mean(axis=1)
    below = middle[:, 1] < 0.3 + 0.4 * middle[:, 0]
    assert not first.relocated.any()
    assert ((mesh.fluid == 0) != below).sum() <= 2  # where the face meets a wall between two particles
    touches = np.zeros(len(particles), dtype=bool)
    touches[mesh.cells[mesh.fluid == 0]] = True
    np.testing.assert_array_equal(particles.fluid, np.where(touches, 0, 1))


def test_a_triangle_has_the_lightest_of_its_fluids_and_a_particle_the_heaviest_of_its_triangles(water, air, glycerin):
    position = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]], dtype=float)
    cells = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], dtype=np.int32)
    particles = tp.Particles(position, [0, 0, 1, 2, 2], np.array([1, 1, 1, 1, 0], dtype=bool), spacing=1.0)
    rank = ranks((water, air, glycerin))
    assert rank.tolist() == [1, 0, 2]
    mesh = fitted.with_fluids(Mesh(position, cells), particles, rank)
    assert mesh.fluid.tolist() == [0, 1, 1, 0]
    assert fitted.particle_fluid(mesh, 5, rank).tolist() == [0, 0, 1, 0, 0]


def test_the_interpolated_rule_meshes_anew_what_it_relocates(water, air):
    tank = tp.tank((1, 1), 0.1, jitter=0.2).fill(air).fill(water, box=((0, 0), (1, 0.5)))
    remesher = DelaunayRemesher([water, air], RelocationRule(), TankMesher(repairs=True))
    first = first_state(remesher, tank.sample([water, air]))
    particles = first.particles
    assert not first.relocated.any()
    free = np.flatnonzero(~particles.wall)
    moved = particles.copy()
    moved.position[free[0]] = moved.position[free[1]] + 1e-3
    remeshed = remesher.remesh(moved_to(first, moved))
    after, anew = remeshed.particles, remeshed.mesh
    assert remeshed.relocated.any()
    np.testing.assert_array_equal(remeshed.relocated, (after.position != moved.position).any(axis=1))
    expected = triangulate(after.position, after.wall, after.spacing)
    np.testing.assert_array_equal(anew.cells, expected.cells)
    np.testing.assert_array_equal(after.fluid, wall_fluid(expected, after.fluid, after.wall))
    assert anew.fluid is None


def test_an_interpolated_interface_with_a_free_surface_is_refused_in_3d(water, air):
    tank = tp.tank((1, 1, 1.25), 0.25, jitter=0.1).fill(air, box=((0, 0, 0.5), (1, 1, 0.75)))
    tank.fill(water, box=((0, 0, 0), (1, 1, 0.5)))
    with pytest.raises(ValueError, match="interface is 'interpolated' with a free surface in 3-D; it must be 'sharp'"):
        tp.Case(tank, [water, air], (0, 0, -9.81), free_surface=True, interface="interpolated")


def test_a_layer_without_room_for_two_lines_is_refused(water, air):
    for thickness, fits in ((0.115, False), (0.125, True)):
        tank = tp.tank((1, 1), 0.1).fill(air).fill(water, box=((0, 0.4), (1, 0.4 + thickness)))
        if fits:
            tp.Case(tank, [water, air], (0, -9.81), interface="sharp")
        else:
            with pytest.raises(ValueError, match="two lines"):
                tp.Case(tank, [water, air], (0, -9.81), interface="sharp")


@pytest.mark.parametrize("swapped", [False, True])
def test_a_fluid_that_gets_no_triangle_is_refused(swapped, water, air):
    """A disc around one lattice point, smaller than its triangles."""
    outer, inner = (water, air) if swapped else (air, water)
    tank = tp.tank((1, 1), 0.1).fill(outer).fill(inner, disc=((0.5, 0.5), 0.03))
    with pytest.raises(ValueError, match=inner.name):
        tp.Simulation(tp.Case(tank, [water, air], (0, -9.81), interface="sharp"))


L = 0.2  # of the tanks below [m]


def turn(time: float) -> float:
    return 0.3 * np.sin(8 * time) ** 2


def push(time: float) -> float:
    return 0.03 * np.sin(5 * time) ** 2


def walled(kind: str, water) -> tp.Simulation:
    """Water below oil in a small tank, between walls that slide, slip, turn, or push."""
    oil = tp.Fluid("oil", 500.0, 0.1)
    tank, motion, gravity = tp.tank((L, L), 0.02).fill(oil).fill(water, box=((0, 0), (L, L / 2))), None, (0, -9.81)
    if kind == "lid":
        tank.wall("top", velocity=(0.2, 0))
    elif kind == "slip":
        gravity = (6, -9.81)
        for name in ("left", "right", "bottom"):
            tank.wall(name, slip=True)
    elif kind == "roll":
        motion = tp.Motion(angle=turn, pivot=(L / 2, 0))
    else:
        tank.wall("left", motion=push).wall("right", motion=lambda t: -push(t))
    for name in set(tank.sides) - set(tank.wall_options):
        tank.wall(name, law="no-slip")
    case = tp.Case(tank, [water, oil], gravity, interface="sharp", tank_motion=motion)
    return tp.Simulation(case, time_step=4e-3)


def in_tank(kind: str, position, time: float) -> np.ndarray:
    """Positions in a unit square: that of the tank's walls at a time."""
    y = position.copy()
    if kind == "roll":
        c, s = np.cos(turn(time)), np.sin(turn(time))
        y = (y - [L / 2, 0]) @ np.array([[c, -s], [s, c]]) + [L / 2, 0]
    elif kind == "pistons":
        y[:, 0] -= push(time)
    return y / L


@pytest.mark.slow(but=("roll",))
@pytest.mark.parametrize("kind", ["lid", "slip", "roll", "pistons"])
def test_walls_that_move_keep_their_particles_and_the_fluids_their_volumes(kind, water):
    simulation = walled(kind, water)
    volume = [simulation.volume(f.name) for f in simulation.case.fluids]
    mask, swaps = simulation.particles.wall.copy(), 0
    for _ in range(80):
        simulation.step()
        particles, mesh, boundary = simulation.particles, simulation.mesh, simulation.boundary
        swaps += int((particles.wall != mask).sum())
        mask = particles.wall.copy()
        np.testing.assert_array_equal(boundary.index, np.flatnonzero(particles.wall))
        cell, i = np.nonzero(mesh.neighbours < 0)
        np.testing.assert_array_equal(np.unique(mesh.cells[cell, (i + 1) % 3]), boundary.index)
        y = in_tank(kind, particles.position, simulation.time)
        off = np.minimum(np.abs(y), np.abs(y - 1)).min(axis=1)
        assert off[particles.wall].max() < 1e-12
        assert off[~particles.wall].min() > 1e-3
        corner = np.abs(np.abs(y - 0.5) - 0.5).max(axis=1) < 1e-12
        assert corner.sum() == 4
        np.testing.assert_allclose([simulation.volume(f.name) for f in simulation.case.fluids], volume, rtol=1e-12)
        check_rates(kind, simulation)
    assert len(particles) == 121
    assert sum(row["relocated"] for row in simulation.history) > 0
    if kind != "lid":
        assert swaps > 0  # wall particles that were set elsewhere, and others that took their place
    if kind == "lid":
        home = np.linspace(0, 1, 11)
        top = particles.wall & (y[:, 1] > 0.5 * (1 + home[-2]))
        np.testing.assert_allclose(np.sort(y[top, 0]), home, atol=1e-12)


def check_rates(kind: str, simulation: tp.Simulation) -> None:
    """Every wall particle is as fast as its wall."""
    particles, time, dt = simulation.particles, simulation.time, 1e-5
    x, v = particles.position[particles.wall], particles.velocity[particles.wall]
    y = in_tank(kind, particles.position, time)[particles.wall]
    if kind == "lid":
        inner_top = (y[:, 1] > 1 - 1e-9) & (np.abs(y[:, 0] - 0.5) < 0.49)
        np.testing.assert_allclose(v, np.where(inner_top[:, None], [0.2, 0.0], 0.0), atol=1e-12)
    elif kind == "slip":
        corner = np.abs(np.abs(y - 0.5) - 0.5).max(axis=1) < 1e-9
        top = y[:, 1] > 1 - 1e-9
        assert not v[corner | top].any()
        for axis in (0, 1):
            assert np.abs(v[np.abs(np.abs(y[:, axis] - 0.5) - 0.5) < 1e-9, axis]).max() < 1e-12
    elif kind == "roll":
        rate = (turn(time + dt) - turn(time - dt)) / (2 * dt)
        arm = x - [L / 2, 0]
        np.testing.assert_allclose(v, rate * np.stack([-arm[:, 1], arm[:, 0]], axis=1), atol=2e-4)
    else:
        rate = (push(time + dt) - push(time - dt)) / (2 * dt)
        end = np.abs(np.abs(y[:, 0] - 0.5) - 0.5) < 1e-9
        np.testing.assert_allclose(v[end, 0], rate, atol=2e-4)
        assert np.abs(v[:, 1]).max() < 1e-12


def test_every_name_of_an_interface_rule_has_a_remesher():
    assert set(REMESHERS) == set(INTERFACES)


def test_the_initial_volumes_do_not_depend_on_the_order_of_the_fluids():
    """Fluids of equal density, listed both ways: the same triangles belong to each, on the lattice and off it."""
    thin, thick = tp.Fluid("thin", density=1000.0, viscosity=1e-3), tp.Fluid("thick", density=1000.0, viscosity=1.0)
    twin = tp.Fluid("twin", density=1000.0, viscosity=1e-3)
    for one, other in ((thin, thick), (thin, twin)):
        for options in ({"box": ((0, 0), (0.5, 1))}, {"disc": ((0.5, 0.5), 0.31)}):
            found = []
            for fluids in ((one, other), (other, one)):
                tank = tp.tank((1, 1), 0.1, jitter=0.1).fill(one).fill(other, **options)
                simulation = tp.Simulation(tp.Case(tank, fluids, (0, -9.81)), time_step=1e-3)
                names = np.array([f.name for f in fluids])
                found.append((names[simulation.mesh.fluid], names[simulation.particles.fluid]))
            for first, second in zip(*found, strict=True):
                np.testing.assert_array_equal(first, second)
