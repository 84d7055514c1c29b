"""Outlines of fluids as loops, and smooth lines along them."""

from __future__ import annotations

import numpy as np
import pytest
from render_results import SIDE, write_results
from tipfem.render import Renderer, Results, View
from tipfem.render.animation import time_lapse
from tipfem.render.layout import make_layout
from tipfem.render.outlines import area_within, background_fluid, fluid_loops, smoothed
from tipfem.render.renderer import contents
from tipfem.render.vector import draw_vectors
from tipfem.render.view import Look

import tipfem as tp


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


@pytest.mark.parametrize(("free", "behind"), [(False, 1), (True, None)])
def test_a_full_tank_is_filled_first_so_that_nothing_gapes_beside_a_body(tmp_path, free, behind):
    """Outlines of two fluids that move on their way to the next state do not meet to the pixel."""
    water, oil = tp.Fluid("water", density=1000.0, viscosity=1.0), tp.Fluid("oil", density=850.0, viscosity=1.0)
    tank = tp.tank((1.0, 1.0), 0.1).fill(oil, box=((0, 0), (1, 0.8 if free else 1))).fill(water, box=((0, 0), (1, 0.4)))
    tank.add(tp.Body(tp.shapes.rectangle((0.35, 0.3), (0.65, 0.6)), "box", density=900.0))
    case = tp.Case(tank, fluids=[water, oil], gravity=(0, -9.81), free_surface=free)
    tp.Simulation(case, tmp_path / "run", output_interval=1.0).run(until=1e-3)
    assert background_fluid(Results(tmp_path / "run").scene(0)) == behind


def test_movies_of_fluids_have_smoothed_outlines_and_say_so(tmp_path):
    """The water's area in the picture is that of the smooth loops; the mesh's edges can be drawn."""
    out = write_results(tmp_path / "run", sharp=True)
    scene, smooth = Results(out).scene(0), View(look="flat").for_files(None, False, False)
    layout = make_layout((640, 480), *contents(scene, None, smooth))
    with Renderer((640, 480), "raster") as renderer:
        image, keys = renderer.tank(scene, layout, Look(view=smooth))
        plain, _ = renderer.tank(scene, layout, Look())
    assert [key.text for key in keys] == ["smoothed outlines"]
    blue = (abs(image.astype(int) - [0x00, 0x72, 0xB2]) < 4).all(axis=2)
    area = area_within([smoothed(loop) for loop in fluid_loops(scene, 0)]) * layout.scale**2
    length = 1.3 * SIDE * layout.scale  # of the interface, which covers half its width of the water
    assert blue.sum() == pytest.approx(area - length * layout.unit, rel=0.01)
    differ = (image != plain).any(axis=2)
    assert 0.001 < differ.mean() < 0.03
    assert View().for_files(None, False, False).look == "lit"
    assert not View(smooth=False).for_files(None, False, False).smooth
    assert not View().for_files("speed", False, False).smooth
    with pytest.raises(ValueError, match="smoothed outlines do not fit the mesh"):
        View(smooth=True).for_files(None, True, False)


def test_a_movie_says_how_fast_it_goes():
    """By its stored times and the pictures a second; nothing where the times are uneven."""
    times = np.linspace(0, 1, 251)
    assert time_lapse(times, 25.0) == "10 times slower"
    assert time_lapse(times, 250.0) == "real time"
    assert time_lapse(times, 625.0) == "2.5 times faster"
    assert time_lapse([0.0, 0.1, 0.5], 25.0) == time_lapse([0.0], 25.0) == ""


@pytest.mark.slow
def test_vectors_for_papers(tmp_path):
    """The same loops as SVG with its text, and as PDF; fields are pixels; what cannot be drawn is refused."""
    out = write_results(tmp_path / "run", sharp=True)
    svg, pdf = draw_vectors(out, [0.0, 0.2])
    text = svg.read_text()
    assert pdf.read_bytes()[:5] == b"%PDF-"
    assert (svg.name, pdf.name) == ("strip.svg", "strip.pdf")
    for words in ("t = 0.0 s", "t = 0.2 s", "water", "smoothed outlines", "x [m]"):
        assert words in text
    points = sum(len(smoothed(loop).points) for k in (0, 2) for loop in fluid_loops(Results(out).scene(k), 0))
    assert text.count("\nL ") > points
    assert "<image" not in text
    shifted = draw_vectors(out, [0.0, 0.05, 0.1, 0.2], [".svg"], columns=4, title="Waves", dark=True)[0]
    text = shifted.read_text()
    assert shifted.name == "strip_dark.svg"
    assert all(words in text for words in (">Waves<", "#151a21"))
    assert text.count(">0.2<") <= 4  # ticks with room for their numbers
    [field] = draw_vectors(out, None, [".svg"], field="speed")
    assert field.name == "picture_speed.svg"
    assert "<image" in field.read_text()
    with pytest.raises(ValueError, match="leave out arrows"):
        draw_vectors(out, view=View(arrows=True))
