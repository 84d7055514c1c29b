"""Levels of fluids in polygons: particles where they meet straight walls."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.geometry.domain import domain_of
from tipfem.geometry.shape_points import triangles_inside

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
