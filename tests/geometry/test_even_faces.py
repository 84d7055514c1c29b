"""Even points on curved faces between fluids."""

import math

import numpy as np
import pytest
from scipy.spatial import Delaunay

import tipfem as tp

LIGHT, HEAVY, THIRD = (tp.Fluid(name, rho, 0.1) for name, rho in (("light", 1.0), ("heavy", 1000.0), ("third", 500.0)))
H = 0.05


def sampled(tank, *fluids, **options):
    return tank.sample(fluids or [LIGHT, HEAVY], fitted=True, **options)


def lengths(x):
    return np.linalg.norm(np.diff(x, axis=0), axis=1)


@pytest.mark.parametrize(
    ("inside", "outside", "jitter"), [(HEAVY, LIGHT, 0.0), (LIGHT, HEAVY, 0.2)], ids=["drop", "bubble"]
)
def test_a_disc_begins_as_a_regular_polygon_whose_edges_are_in_the_mesh(inside, outside, jitter):
    centre, radius = np.array([0.48, 0.51]), 0.23
    tank = tp.tank((1, 1), H, jitter=jitter).fill(outside).fill(inside, disc=(centre, radius))
    particles = sampled(tank)
    away = particles.position - centre
    distance = np.hypot(*away.T)
    ring = np.flatnonzero(np.abs(distance - radius) < 1e-12)
    ring = ring[np.argsort(np.arctan2(away[ring, 1], away[ring, 0]))]
    assert len(ring) == round(2 * math.pi * radius / H)
    sides = lengths(particles.position[np.append(ring, ring[0])])
    assert np.ptp(sides) < 1e-12
    assert (particles.fluid[ring] == 1).all()
    others = ~np.isin(np.arange(len(distance)), ring) & ~particles.wall
    assert np.abs(distance - radius * math.cos(math.pi / len(ring)))[others].min() > 0.6 * H
    assert (particles.fluid[others] == np.where((distance < radius)[others], inside is HEAVY, outside is HEAVY)).all()
    cells = Delaunay(particles.position).simplices
    edges = {frozenset(pair) for pair in cells[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()}
    assert all({a, b} in edges for a, b in zip(ring.tolist(), np.roll(ring, -1).tolist(), strict=True))


@pytest.mark.parametrize("periodic", [None, "x"])
def test_a_wave_has_even_points_from_one_end_to_the_other(periodic):
    height = lambda x: 0.5 + 0.15 * np.cos(2 * math.pi * x)  # noqa: E731
    tank = tp.tank((1, 1), H, periodic=periodic).fill(LIGHT).fill(HEAVY, where=lambda x: x[:, 1] < height(x[:, 0]))
    x = sampled(tank).position
    x = x[np.abs(x[:, 1] - height(x[:, 0])) < 1e-9]
    x = x[np.argsort(x[:, 0])]
    sides = lengths(x)
    assert len(x) > 20
    assert np.ptp(sides) < 0.02 * H


def test_pieces_between_fluids_that_meet_are_even_and_their_ends_stay():
    tank = tp.tank((1, 1), H).fill(LIGHT).fill(HEAVY, box=((0, 0), (1, 0.5))).fill(THIRD, disc=((0.5, 0.5), 0.25))
    position = sampled(tank, LIGHT, HEAVY, THIRD).position
    away = position - [0.5, 0.5]
    for side in (1, -1):
        x = position[(np.abs(np.hypot(*away.T) - 0.25) < 1e-9) & (side * away[:, 1] > -1e-9)]
        x = x[np.argsort(x[:, 0])]
        assert x[0].tolist() == pytest.approx([0.25, 0.5], abs=1e-9)
        assert np.ptp(lengths(x)) < 1e-9


def test_a_drop_in_empty_space_begins_as_a_regular_polygon():
    tank = tp.tank((1, 1), H).fill(HEAVY, disc=((0.5, 0.5), 0.23))
    particles = tank.sample([HEAVY], empty=True)
    distance = np.hypot(*(particles.position - [0.5, 0.5]).T)[particles.fluid == 0]
    assert (np.abs(distance - 0.23) < 1e-12).sum() == round(2 * math.pi * 0.23 / H)
    assert distance.max() < 0.23 + 1e-12


def test_a_disc_in_a_round_tank_is_even_and_so_is_one_in_a_graded_tank():
    round_tank = tp.tank(shape=tp.shapes.circle((0.5, 0.5), 0.5), spacing=H).fill(LIGHT)
    options = {"grading": tp.Grading({"light": 0.15, "heavy": 0.1})}
    for tank, given in ((round_tank, {}), (tp.tank((1, 1), H).fill(LIGHT), options)):
        away = sampled(tank.fill(HEAVY, disc=((0.5, 0.4), 0.2)), **given).position - [0.5, 0.4]
        angle = np.sort(np.arctan2(*away[np.abs(np.hypot(*away.T) - 0.2) < 1e-12].T))
        assert len(angle) == 25
        assert np.ptp(np.diff(angle)) < 1e-12


def test_straight_faces_keep_their_points():
    corners = [(0, 0), (1, 0), (1, 0.6), (0, 0.31)]
    for part in ({"shape": corners}, {"box": ((0, 0), (1, 0.5))}):
        tank = tp.tank((1, 1), H).fill(LIGHT).fill(HEAVY, **part)
        # Those of the lattice are still there: 21 on a line, as many as on the floor.
        assert len(sampled(tank).position) == 441
