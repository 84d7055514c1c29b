"""Levels of fluids in polygons: particles where they meet straight walls."""

from __future__ import annotations

import re

import numpy as np
import pytest

import tipfem as tp
from tipfem.geometry.plane.domain import domain_of
from tipfem.geometry.plane.shape_points import triangles_inside

WATER, AIR = tp.Fluid("water", density=1000.0, viscosity=1e-3), tp.Fluid("air", density=1.2, viscosity=1.8e-5)


def polygon(corners, turn=0.0):
    angle = turn + 2 * np.pi * np.arange(corners) / corners
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize("corners", [63, 33, 21, 13, 9, 7])
@pytest.mark.parametrize("turn", [0.0, 0.1])
def test_polygons_are_filled_to_any_level_with_one_particle_a_place(corners, turn):
    for level in (-0.45, -0.3, 0.1, 0.25):
        tank = tp.tank(shape=polygon(corners, turn), spacing=0.08).fill(AIR)
        tank.fill(WATER, shape=[(-2, -2), (2, -2), (2, level), (-2, level)])
        particles = tp.Case(tank, [WATER, AIR], (0, -9.81)).particles
        x, walls = particles.position, particles.position[particles.wall]
        apart = np.linalg.norm(x[:, None] - x[None], axis=2) + np.eye(len(x))
        assert apart.min() > 1e-3 * 0.08
        # The level ends in a particle on a wall, on either side, or in a corner beside it.
        for side in (-1, 1):
            ends = walls[side * walls[:, 0] > 0]
            assert np.abs(ends[:, 1] - level).min() < 0.25 * 0.08


REFUSED = re.compile(r"beside the corner of the tank|degrees inside|the gap between two walls|too large for a tank")


def some_tank(rng, *, arcs=False):
    """A polygon of up to 24 corners, with arcs or without, a spacing, and a level at any place."""
    count, h, around = int(rng.integers(3, 25)), float(rng.choice([0.06, 0.08, 0.1])), rng.random() < 0.5
    angle = np.sort(rng.uniform(0, 2 * np.pi, count))
    if not around:
        angle = 2 * np.pi * (np.arange(count) + rng.uniform(-0.3, 0.3, count)) / count
    radius = np.ones(count) if around else rng.uniform(0.6, 1.0, count)
    corners, outline = (radius * [np.cos(angle), np.sin(angle)]).T, []
    for k, corner in enumerate(corners):
        outline.append(corner)
        if arcs and around and (angle[(k + 1) % count] - angle[k]) % (2 * np.pi) < np.pi and rng.random() < 0.3:
            outline.append(tp.shapes.arc((0, 0)))
    low, high = corners[:, 1].min(), corners[:, 1].max()
    level = rng.uniform(low, high)
    if rng.random() < 0.4:  # near a corner
        level = rng.choice(corners[:, 1]) + rng.choice([-1, 1]) * h * 10 ** rng.uniform(-5, 0)
    level = float(np.clip(level, low + 0.2 * (high - low), low + 0.8 * (high - low)))
    return tp.shapes.polygon(outline), h, level


def speed_at_rest(seed, *, arcs=False):
    """The largest speed in four steps [m/s]; zero where the case is refused for a reason that is one."""
    rng = np.random.default_rng(seed)
    shape, h, level = some_tank(rng, arcs=arcs)
    free, law = rng.random() < 0.5, rng.choice(["default", "slip", "no-slip"])
    try:
        tank = tp.tank(shape=shape, spacing=h)
        if not free:
            tank.fill(AIR)
        tank.fill(WATER, shape=[(-2, -2), (2, -2), (2, level), (-2, level)])
        for side in tank.sides if law != "default" else ():
            tank.wall(side, **({"slip": True} if law == "slip" else {"law": "no-slip"}))
        case = tp.Case(tank, [WATER] if free else [WATER, AIR], (0, -9.81), free_surface=free)
    except ValueError as error:
        if REFUSED.search(str(error)):
            return 0.0
        raise
    sim, fastest = tp.Simulation(case), 0.0
    for _ in range(4):
        sim.step()
        fastest = max(fastest, float(np.abs(sim.particles.velocity).max()))
    return fastest


# Among these are contacts beside corners, thin wedges below and above a level, and walls at a few degrees to it.
@pytest.mark.parametrize("seed", [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11])
def test_levels_are_at_rest_in_polygons_or_refused(seed):
    assert speed_at_rest(seed) < 1e-9


# Their walls slip; particles crowd each other on arcs, or beside their ends, and in the bottom of a free surface.
@pytest.mark.parametrize("seed", [103, 117, 130, 146, 151, 152, 178, 190])
def test_levels_are_at_rest_beside_arcs(seed):
    assert speed_at_rest(seed, arcs=True) < 1e-9


@pytest.mark.slow
def test_levels_are_at_rest_beside_any_arcs_or_refused():
    assert [(seed, speed) for seed in range(100, 200) if (speed := speed_at_rest(seed, arcs=True)) > 3e-8] == []


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [range(first, first + 50) for first in range(100, 500, 50)], ids=str)
def test_levels_are_at_rest_in_any_polygon_or_refused(seeds):
    assert [(seed, speed) for seed in seeds if (speed := speed_at_rest(seed)) > 1e-9] == []


def test_a_level_that_ends_hardly_beside_a_corner_is_refused():
    def made(level):
        tank = tp.tank(shape=[(0, 0), (1, 0), (1.2, 0.5), (1, 1), (0, 1)], spacing=0.1).fill(AIR)
        return tp.Case(tank.fill(WATER, shape=[(-1, -1), (2, -1), (2, level), (-1, level)]), [WATER, AIR], (0, -9.81))

    with pytest.raises(ValueError, match=r"ends 4.31e-07 m beside the corner of the tank at \[1.2, 0.5\] m; .*1e-05 m"):
        made(0.5 + 4e-7)
    for level in (0.5, 0.5 + 1e-4):
        x = made(level).particles.position
        assert (np.abs(x - [1.2 - 0.4 * (level - 0.5), level]).max(axis=1) < 1e-10).sum() == 1


@pytest.mark.parametrize("size", [1.2, 7.0])
def test_a_level_in_the_corner_of_a_body_in_a_box_ends_there(size):
    """Fills of boxes reach a little beyond their faces, which is no level beside a corner."""
    level = 0.4 * size
    tank = tp.tank((size, 0.75 * size), size / 30).fill(WATER, box=((0, 0), (size, level)))
    tank.add(tp.Body([(0.4 * size, 0.3 * size), (0.7 * size, level), (0.4 * size, 0.5 * size)], density=500.0))
    x = tp.Case(tank, [WATER], (0, -9.81), free_surface=True).particles.position
    assert (np.abs(x - [0.7 * size, level]).max(axis=1) < 1e-10 * size).sum() == 1


def test_triangles_along_straight_walls_have_an_area():
    corners = polygon(63)
    domain = domain_of(tp.shapes.polygon(corners), 0.08)
    between = 0.3 * corners + 0.7 * np.roll(corners, -1, axis=0)
    inside = np.stack(np.meshgrid(np.linspace(-0.6, 0.6, 16), np.linspace(-0.6, 0.6, 16)), axis=-1).reshape(-1, 2)
    x = np.concatenate([corners, between, inside])
    a, b, c = np.moveaxis(x[triangles_inside(x, domain)], 1, 0)
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert np.abs(area).min() > 1e-8
    assert np.abs(area).sum() == pytest.approx(domain.area, rel=1e-12)
