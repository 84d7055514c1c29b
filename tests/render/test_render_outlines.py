"""Outlines of fluids as loops, and smooth lines along them."""

from __future__ import annotations

import numpy as np
import pytest
from render_results import write_results
from tipfem.render import Results
from tipfem.render.outlines import area_within, fluid_loops, smoothed


def area_of(scene, fluid):
    """Area of a fluid's triangles [m^2]."""
    regions = scene.geometry.regions
    corners = regions.triangles[regions.fluid == fluid]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum()


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Sloshing water and air, cut where they meet."""
    return Results(write_results(tmp_path_factory.mktemp("loops") / "run", times=(0.0, 0.1))).scene(1)


@pytest.mark.parametrize("fluid", [0, 1])
def test_loops_enclose_the_fluid(scene, fluid):
    """The area within the loops is that of the triangles, with the fluid on the left of every loop."""
    loops = fluid_loops(scene, fluid)
    assert len(loops) == 1
    assert area_within(loops) == pytest.approx(area_of(scene, fluid), rel=1e-9)


@pytest.mark.parametrize("fluid", [0, 1])
def test_smoothing_keeps_the_area_and_the_walls(scene, fluid):
    """The area changes by at most 0.2 %, points on walls stay, and the line stays within a spacing of the outline."""
    for loop in fluid_loops(scene, fluid):
        line = smoothed(loop)
        assert area_within([line]) == pytest.approx(area_within([loop]), rel=2e-3)
        apart = np.linalg.norm(line.points[:, None] - loop.points, axis=2)
        assert apart.min(axis=1).max() < scene.spacing
        assert loop.fixed.any()
        assert apart.min(axis=0)[loop.fixed].max() == 0.0


def test_nothing_has_no_outline(scene):
    """A fluid that is not there has no loops."""
    assert fluid_loops(scene, 2) == []
