"""tipfem/free_surface.py: which simplices are fluid, what is on the surface, and what flies."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.mesh.free_surface import SurfaceMesher, spray_volumes
from tipfem.mesh.mesh import Mesh
from tipfem.physics.volume_source import VolumeControl
from tipfem.remesh.relocation import relocate

WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
OIL = tp.Fluid("oil", density=900.0, viscosity=1e-2)


def mesher(particles: tp.Particles, **rule) -> SurfaceMesher:
    """Of particles."""
    return SurfaceMesher(tp.SurfaceRule(**rule))


def pool(depth: float = 0.5, h: float = 0.1, drops=(), **fill) -> tp.Particles:
    """A unit tank, filled up to ``depth``, with further particles at ``drops`` (K, 2)."""
    p = tp.tank((1, 1), h).fill(WATER, **(fill or {"box": ((0, 0), (1, depth))})).sample([WATER], empty=True)
    drops = np.reshape(drops, (-1, 2))
    fluid, wall = np.zeros(len(drops), int), np.zeros(len(drops), bool)
    return tp.Particles(
        np.concatenate([p.position, drops]), np.concatenate([p.fluid, fluid]), np.concatenate([p.wall, wall]), spacing=h
    )


def at(particles: tp.Particles, *place: float) -> int:
    """The particle at a place."""
    return int(np.argmin(np.linalg.norm(particles.position - np.array(place), axis=1)))


def test_a_tank_may_be_empty_in_part():
    p = tp.tank((1, 1), 0.1).fill(WATER, box=((0, 0), (0.37, 0.52))).sample([WATER], empty=True)
    free = p.position[~p.wall]
    assert free.max(axis=0) == pytest.approx([0.37, 0.52], abs=1e-12)
    assert (p.fluid[~p.wall] == 0).all()
    wet = (p.position <= np.array([0.37, 0.52]) + 1e-9).all(axis=1)
    np.testing.assert_array_equal(p.fluid[p.wall], np.where(wet, 0, -1)[p.wall])
    assert (p.position[p.wall].max(axis=0) == 1).all()


def test_faces_of_empty_parts_are_on_lines_and_those_between_fluids_are_not():
    tank = tp.tank((1, 1), 0.1).fill(WATER, box=((0, 0), (1, 0.3))).fill(OIL, box=((0, 0.3), (1, 0.6)))
    p = tank.sample([WATER, OIL], empty=True)
    y = np.unique(p.position[~p.wall][:, 1].round(12))
    assert y.max() == pytest.approx(0.6)
    assert np.abs(y - 0.3).min() == pytest.approx(0.05, abs=0.01)
    assert (p.fluid[~p.wall] == (p.position[~p.wall][:, 1] > 0.3)).all()


def test_a_slanted_or_round_surface_has_particles_on_it():
    p = pool(where=lambda x: x[:, 1] < 0.45 + 0.2 * x[:, 0])
    height = p.position[:, 1] - 0.45 - 0.2 * p.position[:, 0]
    assert height[~p.wall].max() < 1e-9
    mesh = mesher(p).start(p)
    assert mesh.measure.sum() == pytest.approx(0.55, rel=1e-9)


def test_an_empty_tank_is_refused():
    with pytest.raises(ValueError, match="it is empty; fill at least one part"):
        tp.tank((1, 1), 0.1).sample([WATER], empty=True)


def test_the_first_mesh_is_what_was_filled():
    p = pool(0.5)
    mesh = mesher(p).start(p)
    assert mesh.measure.sum() == pytest.approx(0.5, rel=1e-12)
    assert (p.fluid == 0).all()
    surface = mesh.surface
    assert surface is not None
    on_top = np.abs(p.position[:, 1] - 0.5) < 1e-9
    np.testing.assert_array_equal(surface.front, on_top)
    dry = p.position[:, 1] > 0.5 + 1e-9
    np.testing.assert_array_equal(surface.dry(p.wall), dry & p.wall)
    np.testing.assert_array_equal(surface.pinned, dry)  # on the surface pressure is an unknown


def test_nothing_changes_when_nothing_moves():
    p = pool(0.5)
    m = mesher(p)
    first = m.start(p)
    again = m.remesh(p, first, np.zeros(len(p), dtype=bool))
    assert {tuple(sorted(c)) for c in first.cells.tolist()} == {tuple(sorted(c)) for c in again.cells.tolist()}


@pytest.mark.parametrize(("height", "joins"), [(0.09, False), (0.04, True)])
def test_a_row_of_particles_joins_a_pool_when_the_gap_is_small(height, joins):
    row = np.stack([np.arange(0.3, 0.75, 0.1), np.full(5, 0.9)], axis=1)
    p = pool(0.5, drops=np.concatenate([row, row + [0.05, 0.0866]]))
    m = mesher(p)
    first = m.start(p)
    moved = p.copy()
    moved.position[-10:, 1] += 0.5 + height - 0.9
    mesh = m.remesh(moved, first.moved(moved.position), np.zeros(len(p), dtype=bool))
    low, high = np.flatnonzero(np.abs(p.position[:, 1] - 0.5) < 1e-9), np.arange(len(p) - 10, len(p) - 5)
    i, j = mesh.edges.T
    assert (np.isin(i, low) & np.isin(j, high)).any() == joins
    # It is no further into the gap than the gap is wide: volume is hardly gained.
    gained = mesh.measure.sum() - first.measure.sum()
    assert gained < (0.51 * height if joins else 1e-12)


@pytest.mark.parametrize(("height", "speed", "touches"), [(0.09, -1.0, False), (0.04, -1.0, True), (0.04, 1.0, False)])
def test_a_drop_touches_a_dry_wall_when_it_is_low_and_comes(height, speed, touches):
    p = pool(where=lambda x: x[:, 0] < 0.3, drops=[(0.64, 0.5)])
    m = mesher(p)
    first = m.start(p)
    moved = p.copy()
    moved.position[-1, 1], moved.velocity[-1, 1] = height, speed
    mesh = m.remesh(moved, first.moved(moved.position), np.zeros(len(p), dtype=bool))
    surface = mesh.surface
    assert surface is not None
    assert surface.loose[-1] == (not touches)
    if touches:
        cell = mesh.cells[(mesh.cells == len(p) - 1).any(axis=1)]
        assert len(cell) == 1
        assert not surface.pinned[cell[0]].any()


def test_a_wall_is_wetted_when_the_fluid_has_passed_the_middle():
    p = pool(where=lambda x: x[:, 0] < 0.3)
    m = mesher(p)
    first = m.start(p)
    tip = at(p, 0.3, 0.1)
    assert p.position[tip] == pytest.approx([0.3, 0.1])
    reached = {}
    for x in (0.33, 0.36):
        moved = p.copy()
        moved.position[tip] = (x, 0.08)
        mesh = m.remesh(moved, first.moved(moved.position), np.zeros(len(p), dtype=bool))
        reached[x] = mesh.position[np.unique(mesh.cells), 0].max()
    assert reached[0.33] == pytest.approx(0.33)
    assert reached[0.36] == pytest.approx(0.4)


def test_a_drop_at_the_ceiling_lets_go_and_one_of_its_particles_set_elsewhere_is_fluid():
    """Suction does not hold it; what was relocated from it into the pool belongs to the pool."""
    p = pool(0.5, drops=[(0.44, 0.95), (0.54, 0.95)])
    p.velocity[-2:, 1] = 1.0
    m = mesher(p)
    first = m.start(p)
    nowhere = np.zeros(len(p), dtype=bool)
    hung = m.remesh(p, first, nowhere)
    assert hung.surface is not None
    assert not hung.surface.loose[-2:].any()
    for pressure, loose in ((10.0, False), (-10.0, True)):
        pressed = p.copy()
        pressed.pressure[p.wall & (p.position[:, 1] > 0.99)] = pressure
        after = m.remesh(pressed, hung, nowhere)
        assert after.surface is not None
        assert after.surface.loose[-2:].all() == loose
    moved, relocated = pressed.copy(), nowhere.copy()
    relocated[-1] = True
    moved.position[-1] = (0.55, 0.25)
    after = m.remesh(moved, hung, relocated)
    assert after.surface is not None
    assert after.surface.loose[-2:].tolist() == [True, False]
    assert not after.surface.front[at(p, 0.5, 0.2)]


def test_a_large_simplex_between_particles_relocated_below_the_surface_is_fluid():
    """They were inserted into edges with an end below the surface; taken for others, they would leave a hole."""
    p = pool(0.5)
    m = mesher(p)
    first = m.start(p)
    middle, angle = np.array([0.5, 0.23]), 2 * np.pi / 3 * np.arange(3) + 0.3
    corners = np.array([at(p, 0.45, 0.2), at(p, 0.55, 0.2), at(p, 0.5, 0.3)])
    moved, relocated = p.copy(), np.zeros(len(p), dtype=bool)
    within = np.flatnonzero(np.linalg.norm(p.position - middle, axis=1) < 0.15)
    moved.position[within] = np.column_stack([np.linspace(0.1, 0.9, len(within)), np.full(len(within), 0.8)])
    moved.position[corners] = middle + 0.13 * np.column_stack([np.cos(angle), np.sin(angle)])
    relocated[corners] = True
    below, top, other_top = at(p, 0.3, 0.25), at(p, 0.5, 0.5), at(p, 0.6, 0.5)
    for ends, fluid in (((below, top), True), ((top, other_top), False)):
        moves = np.array([[corner, *ends] for corner in corners])
        mesh = m.remesh(moved, first.moved(p.position), relocated, moves=moves)
        assert (np.sort(mesh.cells, axis=1) == np.sort(corners)).all(axis=1).any() == fluid


def test_large_simplices_at_the_surface_go_and_those_below_stay():
    p = pool(0.5)
    m = mesher(p)
    first = m.start(p)
    lifted, sunk = p.copy(), p.copy()
    lifted.position[at(p, 0.5, 0.5), 1] += 0.3
    mesh = m.remesh(lifted, first.moved(lifted.position), np.zeros(len(p), dtype=bool))
    assert mesh.surface is not None
    assert mesh.surface.loose[at(p, 0.5, 0.5)]
    deep = at(p, 0.5, 0.2)
    sunk.position[[deep, at(p, 0.6, 0.2)], 1] -= 0.09
    whole = m.remesh(sunk, first.moved(sunk.position), np.zeros(len(p), dtype=bool))
    assert whole.measure.sum() == pytest.approx(0.5, rel=1e-12)


def test_the_volume_of_what_flies_counts_for_its_fluid():
    p = pool(0.5, drops=[(0.3, 0.9), (0.7, 0.9)])
    mesh = mesher(p).start(p)
    assert mesh.surface is not None
    assert mesh.surface.loose[-2:].all()
    fluid = p.fluid.copy()
    fluid[-1] = 1
    np.testing.assert_allclose(spray_volumes(mesh, fluid, 2), [0.01, 0.01])
    assert not spray_volumes(Mesh(mesh.position, mesh.cells), fluid, 2).any()


def test_a_block_in_three_dimensions():
    """Its volume, its surface, and a drop above it: the filter knows no dimension."""
    tank = tp.tank((1, 1, 1), 0.125, jitter=0.05).fill(WATER, box=((0, 0, 0), (0.5, 1, 0.5)))
    p = tank.sample([WATER], empty=True)
    p = tp.Particles(
        np.concatenate([p.position, [[0.3, 0.5, 0.9]]]), np.append(p.fluid, 0), np.append(p.wall, False), spacing=0.125
    )
    m = mesher(p)
    mesh = m.start(p)
    assert mesh.measure.sum() == pytest.approx(0.25, rel=0.03)
    surface = mesh.surface
    assert surface is not None
    assert np.flatnonzero(surface.loose).tolist() == [len(p) - 1]
    inside = ((p.position > [0.0, 0.0, 0.0]) & (p.position < [0.4, 1, 0.4])).all(axis=1)
    assert not surface.front[inside].any()
    top = (np.abs(p.position[:, 2] - 0.5) < 0.02) & (p.position[:, 0] < 0.52) & ~p.wall
    assert surface.front[top].all()
    # Landing: over a face of the dry floor.
    moved = p.copy()
    moved.position[-1], moved.velocity[-1, 2] = (0.79, 0.52, 0.06), -1.0
    landed = m.remesh(moved, mesh.moved(moved.position), np.zeros(len(p), dtype=bool))
    assert landed.surface is not None
    assert not landed.surface.loose[-1]


def test_particles_at_a_surface_are_moved_later_than_those_below():
    p = pool(0.5, h=0.1)
    mesh = mesher(p).start(p)
    rule = tp.RelocationRule(long_edge=1.2)
    moved = p.copy()
    moved.position[at(p, 0.5, 0.3), 0] += 0.05
    moved.position[at(p, 0.5, 0.5), 0] += 0.05
    # Make room elsewhere.
    moved.position[at(p, 0.2, 0.3), 0] -= 0.035
    moved.position[at(p, 0.3, 0.3), 0] += 0.035
    result, moves = relocate(moved, mesh.moved(moved.position), rule)
    changed = np.flatnonzero((result.position != moved.position).any(axis=1))
    assert len(moves) == 1
    assert moved.position[changed[0], 1] == pytest.approx(0.3)


def test_each_fluid_gets_its_own_volume_back_where_there_is_a_surface():
    p = pool(0.5)
    mesh = mesher(p).start(p)
    fraction = np.stack([np.ones(len(mesh.cells)), np.zeros(len(mesh.cells))], axis=1)
    control = VolumeControl(np.array([0.6, 0.0]), 10.0, balanced=False)
    control.missing[:] = (0.1, 0.0)
    assert control.source(mesh, fraction, 1e-3) == pytest.approx(np.full(len(mesh.cells), 0.01 * 0.2))
    control.balanced = True
    assert control.source(mesh, fraction, 1e-3) == pytest.approx(np.zeros(len(mesh.cells)), abs=1e-15)
