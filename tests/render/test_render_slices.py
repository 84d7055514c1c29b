"""Slices of flows in 3-D: what a plane cuts off tetrahedra, and pictures of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from render_results import write_results
from render_volumes import SIZE, SPACING, volume, write_volumes
from tipfem.render import Results, ResultsError, View, animate, cli, render_frame
from tipfem.render.interface import areas, cell_edges
from tipfem.render.outlines import area_within, wall_loops
from tipfem.render.slices import Plane, sliced

from tipfem.results.fields.catalogue import COMPUTED, Lazy

LINEAR = {"pressure": lambda x: 3 + x @ [1.0, -2.0, 5.0]}


def area(scene, fluid=None):
    kept = slice(None) if fluid is None else scene.cell_fluid == fluid
    return areas(scene.position, scene.cells[kept]).sum()


@pytest.mark.parametrize(
    "plane", ["x=0.431", "y=0.217", "z=0.1234", "y=0.3", "x=0.5"]
)  # the last two through particles
def test_a_slice_of_a_box_is_its_cross_section(plane):
    at = Plane.of(plane)
    scene = sliced(volume(fields=LINEAR), at)
    across = [k for k in range(3) if k != at.axis]
    assert area(scene) == pytest.approx(SIZE[across].prod(), rel=1e-12)
    assert area_within(wall_loops(scene)) == pytest.approx(SIZE[across].prod(), rel=1e-12)
    whole = np.insert(scene.position, at.axis, at.value, axis=1)
    assert scene.field_values("pressure") == pytest.approx(LINEAR["pressure"](whole), rel=1e-12)
    rim = cell_edges(scene.cells)
    ends = rim.pairs[rim.shared_by == 1]
    assert rim.shared_by.max() == 2
    assert scene.wall[ends].all()  # the walls, and nothing else
    inside = ((scene.position > 1e-9) & (scene.position < scene.upper - 1e-9)).all(axis=1)
    assert not scene.wall[inside].any()
    assert scene.axes == tuple("xyz"[k] for k in across)


def test_a_slice_of_water_ends_at_its_surface():
    scene = sliced(volume(level=0.5), Plane.of("y=0.3"))
    assert area(scene) == pytest.approx(0.5 * SIZE[0], rel=1e-12)
    assert area_within(wall_loops(scene)) == pytest.approx(SIZE[0] * SIZE[2], rel=1e-12)  # dry walls too


def test_two_fluids_meet_where_half_of_the_particles_are_of_each():
    """As the method has them: by the particles' share, linear in each cell."""

    def air(points):
        return points @ [0.3, 0.1, 1.0] > 0.55

    scene = sliced(volume(fluid=air, fields={"share": lambda x: air(x).astype(float)}), Plane.of("y=0.217"))
    share = scene.field_values("share")
    mean = share[scene.cells].mean(axis=1)
    assert set(np.unique(scene.cell_fluid)) == {0, 1}
    assert (mean[scene.cell_fluid == 1] > 0.5).all()
    assert (mean[scene.cell_fluid == 0] < 0.5).all()
    edges = cell_edges(scene.cells)
    assert edges.shared_by.max() == 2
    meeting = scene.geometry.regions.segments
    assert len(meeting) > 10
    keys = {tuple(np.round(p, 9)): s for p, s in zip(scene.position, share, strict=True)}
    assert np.array([keys[tuple(np.round(p, 9))] for p in meeting.reshape(-1, 2)]) == pytest.approx(0.5)
    assert area(scene) == pytest.approx(SIZE[0] * SIZE[2], rel=1e-12)


def test_slices_fill_the_volume_of_a_fluid():
    """Areas over all planes, by the midpoint rule, against the volume by the share's linear interpolant in cells."""
    tank = volume(fluid=lambda x: x[:, 2] > 0.45)
    planes = (np.arange(60) + 0.5) / 60 * SIZE[1]
    found = np.mean([area(sliced(tank, Plane(1, y)), fluid=0) for y in planes]) * SIZE[1]
    # Between two layers of particles, on average half way.
    assert found == pytest.approx(0.45 * SIZE[0] * SIZE[1], rel=0.02)


def test_a_slice_turns_with_the_tank():
    tank = volume(level=0.5, fields=LINEAR)
    turn = [1, 2, 0]
    turned = replace(
        tank, position=tank.position[:, turn], lower=tank.lower[turn], upper=tank.upper[turn], up=turn.index(2)
    )
    one, other = sliced(tank, Plane.of("y=0.217")), sliced(turned, Plane.of("x=0.217"))
    assert other.axes == ("z", "y")  # x and z before
    assert other.position == pytest.approx(one.position)
    assert (other.cells == one.cells).all()


def test_drops_are_shown_within_half_a_spacing():
    tank = volume(level=0.4)
    drops = np.array([[0.5, 0.31, 0.7], [0.5, 0.5, 0.7]])
    count = len(tank.position)
    tank = replace(
        tank,
        position=np.concatenate([tank.position, drops]),
        fluid=np.zeros(count + 2, int),
        wall=np.concatenate([tank.wall, [False, False]]),
        fields=Lazy({}),
    )
    spray = sliced(tank, Plane.of("y=0.28")).geometry.loose[0]
    assert spray.sum() == 1
    assert sliced(tank, Plane.of("y=0.28")).position[spray] == pytest.approx(drops[:1, [0, 2]])


@pytest.mark.parametrize("text", ["y", "w=1", "y=", "y=nan", "y=0.1 z=2", 3])
def test_a_plane_is_an_axis_and_a_number(text):
    with pytest.raises(ValueError, match=r"expected an axis and its coordinate in metres, for example y=0\.5"):
        View(slice=text)


def test_planes_that_do_not_fit_are_refused(tmp_path, capsys):
    out = write_volumes(tmp_path / "out")
    flat = write_results(tmp_path / "flat")
    for folder, plane, text in (
        (out, "y=0.6", "slice y=0.6: expected y between 0 and 0.6, inside the tank"),
        (flat, "y=0.1", "are in 2-D; leave out the slice"),
    ):
        with pytest.raises(ResultsError, match=text):
            Results(folder, slice=plane)
    with pytest.raises(ResultsError, match=r"in 3-D; choose a plane, for example slice y=0\.3"):
        Results(out)
    with pytest.raises(ResultsError, match="frame 'tank': it is for results in 2-D"):
        Results(out, frame="tank", slice="y=0.3")
    assert cli.main([str(out), "--slice", "q=1"]) == 2
    assert "slice 'q=1': expected an axis" in capsys.readouterr().err
    with pytest.raises(ValueError, match="particles do not lie in a plane"):
        render_frame(Results(out, slice="y=0.3").scene(0), particles=True, backend="raster")
    assert not list(out.glob("*.mp4"))


def test_slices_are_drawn_like_flows_in_the_plane(tmp_path):
    out = write_volumes(tmp_path / "out", air=True)
    words = ["--slice", "y=0.3", "--size", "480x320", "--backend", "raster", "--samples", "1"]
    options = ["--field", "velocity_z", "--arrows", "--mesh", "--strip", "0", "0.2"]
    assert cli.main([str(out), *words, *options]) == 0
    name = "velocity_z_mesh_arrows_y=0.3"
    assert {path.name for path in out.iterdir()} >= {f"frames_{name}_480x320", f"strip_{name}.png"}
    done = animate(out, frames=False, size=(480, 320), backend="raster", view=View(slice="x=0.25"), samples=1)
    assert [path.name for path in done.movies] == ["animation_x=0.25_480x320.mp4"]
    results = Results(out, slice="y=0.3")
    assert results.scene(0).title == "A box, y = 0.3 m"
    # Blue water up to its level, which the particles around half a spacing more.
    picture = render_frame(results.scene(0), backend="raster").astype(float)
    blue = (picture[..., 2] - picture[..., 0] > 60).sum()
    wide = render_frame(results.scene(2), backend="raster").astype(float)
    lower = (wide[..., 2] - wide[..., 0] > 60).sum()
    assert lower / blue == pytest.approx((0.3 + SPACING / 2) / (0.5 + SPACING / 2), rel=0.02)


def test_velocities_along_z_are_no_quantities_of_flows_in_2d(tmp_path):
    assert "velocity_z" in Results(write_volumes(tmp_path / "a"), slice="y=0.3").scene(0).fields
    assert "velocity_z" not in Results(write_results(tmp_path / "b")).scene(0).fields
    assert "velocity_z" not in COMPUTED
