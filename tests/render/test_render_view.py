"""Windows, layers and colour maps: where they are, against formulas."""

import os
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image
from render_results import SIDE, sharp_tank, write_results
from tipfem.render import Renderer, Results, Scene, View, animate, colours, flow, render_frame, renderer, vulkan
from tipfem.render.animation import picture_name
from tipfem.render.annotation import panel_width
from tipfem.render.colours import COLOUR_MAPS, colour_table, luminance, map_values
from tipfem.render.drawing import Drawing
from tipfem.render.geometry import Bounds
from tipfem.render.joints import joints
from tipfem.render.layers import ARROWS_APART
from tipfem.render.layout import fitted_size, make_layout
from tipfem.render.picture import draw_scene
from tipfem.render.streamlines import streamlines
from tipfem.render.view import Look

SIZE = (640, 480)


def made_scene(velocity=lambda x, y: (y, -x), **changes):
    points, cells, fluid, cell_fluid, wall = sharp_tank(0.0, 20)
    x, y = points.T
    vx, vy = velocity(x, y)
    given = dict(
        position=points,
        cells=cells,
        fluid=fluid,
        cell_fluid=cell_fluid,
        wall=wall,
        fluid_names=("water", "air"),
        fluid_densities=(998.2, 1.204),
        lower=(0, 0),
        upper=(SIDE, SIDE),
        spacing=SIDE / 20,
        fields={"pressure": 1000 * x + 500 * y, "velocity_x": vx + 0 * x, "velocity_y": vy + 0 * x},
    )
    return Scene(**(given | changes))


def test_a_window_shows_its_part_and_nothing_outside_of_it():
    scene, view = made_scene(), View(window=(0.1, 0.05, 0.4, 0.3))
    image = render_frame(scene, SIZE, "pressure", (0, 800), mesh=False, backend="raster", view=view)
    layout = make_layout(SIZE, (0.1, 0.05), (0.4, 0.3), False, panel_width(scene, "pressure"))
    left, top, right, bottom = layout.box
    for x, y in ((0.12, 0.07), (0.38, 0.09), (0.25, 0.08)):
        column, row = layout.pixels([x, y]).astype(int)
        expected = 255 * map_values(1000 * x + 500 * y, 0, 800, colour_table("viridis"))
        assert np.abs(image[row, column] - expected).max() <= 4
    # A band between the box with its frame and the ticks is white on all four sides.
    middle, centre = int(left + right) // 2, int(top + bottom) // 2
    assert (image[centre - 40 : centre + 40, int(left) - 5 : int(left) - 2] == 255).all()
    assert (image[centre - 40 : centre + 40, int(right) + 3 : int(right) + 6] == 255).all()
    assert (image[int(top) - 5 : int(top) - 2, middle - 40 : middle + 40] == 255).all()
    assert (image[int(bottom) + 2 : int(bottom) + 4, middle - 40 : middle + 40] == 255).all()


def test_a_window_of_the_whole_domain_keeps_its_walls():
    scene = made_scene()
    whole = render_frame(scene, SIZE, backend="raster")
    same = render_frame(scene, SIZE, backend="raster", view=View(window=(0, 0, SIDE, SIDE)))
    assert (whole != same).any(axis=2).mean() < 0.001


def test_a_window_follows_a_front_and_a_centre():
    scene = made_scene()
    lower, upper = View(follow="front").bounds(scene)
    assert upper - lower == pytest.approx([SIDE / 3, SIDE / 3])
    water = scene.position[np.unique(scene.cells[scene.cell_fluid == 0])]
    front = water[water[:, 0].argmax()]
    assert (lower <= front).all()
    assert (front <= upper).all()
    assert upper[0] == pytest.approx(SIDE)  # inside of the domain
    lower, upper = View(follow="water", window=(0, 0, 0.1, 0.05)).bounds(scene)
    assert (lower + upper) / 2 == pytest.approx(water.mean(axis=0))
    assert upper - lower == pytest.approx([0.1, 0.05])
    with pytest.raises(ValueError, match=r"oil.*water, air"):
        View(follow="front:oil").bounds(scene)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"window": (0, 0, 0, 1)}, "x0 below x1"),
        ({"window": (0, 1)}, "four numbers"),
        ({"window": (0, 0, float("nan"), 1)}, "x0 below x1"),
        ({"colour_map": "jet"}, "jet.*viridis"),
        ({"tracers": -1}, "tracers -1"),
    ],
)
def test_bad_views_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        View(**given)


def test_values_on_a_grid_are_linear_and_empty_outside():
    scene = made_scene()
    values = np.stack([scene.fields["pressure"], scene.position[:, 0]], axis=1)
    found = flow.grid_values(scene, values, np.array([-0.1, 0.0]), 0.05, (10, 12))
    x, y = np.meshgrid(-0.1 + 0.05 * (np.arange(12) + 0.5), 0.05 * (np.arange(10) + 0.5))
    inside = x > 0
    assert (np.isfinite(found[..., 0]) == inside).all()
    assert found[inside][:, 0] == pytest.approx((1000 * x + 500 * y)[inside], rel=1e-3)
    assert found[inside][:, 1] == pytest.approx(x[inside], rel=1e-3)


def test_arrows_point_along_the_flow_with_lengths_to_scale():
    scene = made_scene()
    shafts = flow.arrows(scene, scene.lower, scene.upper, 0.05, 0.5)
    middle, along = shafts.mean(axis=1), shafts[:, 1] - shafts[:, 0]
    assert len(shafts) >= 90
    assert np.abs((along * middle).sum(axis=1)).max() < 1e-5
    assert (along[:, 0] > 0).all()
    speed = np.linalg.norm(middle, axis=1)  # of the vortex (y, -x)
    assert np.linalg.norm(along, axis=1) == pytest.approx(0.9 * 0.05 * speed / 0.5, rel=0.01)
    # Twice the length of the legend's at most, and nothing where hardly anything moves.
    fast = flow.arrows(scene, scene.lower, scene.upper, 0.05, 0.01)
    assert np.linalg.norm(fast[:, 1] - fast[:, 0], axis=1).max() == pytest.approx(2 * 0.9 * 0.05)
    assert len(flow.arrows(scene, scene.lower, scene.upper, 0.05, 100.0)) == 0
    still = made_scene(lambda x, y: (0 * x, 0 * y))
    assert flow.arrows(still, still.lower, still.upper, 0.05, flow.arrow_speed([still], View())).shape == (0, 2, 2)
    assert streamlines(still, still.lower, still.upper, 0.05) == []


def test_the_arrow_in_the_legend_has_the_same_length_and_speed_in_all_pictures(tmp_path):
    """Of a flow that slows down, the speed is that of nearly all particles that are seen, at all times."""
    scenes = [made_scene(lambda x, y, a=a: (a + 0 * x, 0 * y)) for a in (1.0, 0.5, 0.1)]
    scenes[1].fields["velocity_x"][0] = 50.0  # spray
    assert flow.arrow_speed(scenes, View()) == pytest.approx(1.0)
    assert flow.arrow_speed(scenes[1:], View()) == pytest.approx(0.5)
    right = made_scene(lambda x, y: (np.where(x > SIDE / 2, 2.0, 0.2), 0 * y))
    assert flow.arrow_speed([right], View(window=(0, 0, 0.4 * SIDE, 0.4 * SIDE))) == pytest.approx(0.2)
    view, _ = renderer.settled(View(arrows=True), scenes, None, None)
    assert view.arrow_speed == pytest.approx(1.0)
    layout = make_layout(SIZE, (0, 0), (SIDE, SIDE), False, 200)
    for scene, speed in zip(scenes, (1.0, 0.5, 0.1), strict=True):
        _, keys = draw_scene(scene, layout, colours.fluid_colours(scene.fluid_names), Look(view=view))
        assert [(key.text, key.head) for key in keys] == [("1 m/s", True)]
        drawn = flow.arrows(
            scene, scene.lower, scene.upper, ARROWS_APART * layout.unit / layout.scale, view.arrow_speed
        )
        lengths = np.linalg.norm(drawn[:, 1] - drawn[:, 0], axis=1) * layout.scale / layout.unit
        assert np.median(lengths) == pytest.approx(keys[0].length * speed, rel=1e-3)
    with pytest.raises(ValueError, match="arrow speed -1"):
        View(arrows=True, arrow_speed=-1)


def test_streamlines_of_a_vortex_are_circles_in_its_sense():
    middle, apart = SIDE / 2, 0.03
    scene = made_scene(lambda x, y: (y - middle, middle - x))
    lines = streamlines(scene, scene.lower, scene.upper, apart)
    assert len(lines) > 4
    closed = 0
    for line in lines:
        radius = np.linalg.norm(line - middle, axis=1)
        assert np.ptp(radius) < 0.01
        (ax, ay), (bx, by) = line[0] - middle, line[1] - middle
        assert ax * by - ay * bx < 0  # clockwise
        angle = np.unwrap(np.arctan2(*(line - middle).T))
        assert np.ptp(angle) < 2 * np.pi + 0.3  # once around at most
        if np.array_equal(line[0], line[-1]):
            closed += 1
            assert np.ptp(angle) == pytest.approx(2 * np.pi, abs=1e-6)
        assert radius.max() > 0.35 * apart  # no ring like a bubble
    assert closed >= 2


def test_streamlines_keep_their_distance_and_leave_no_large_gap():
    """A cellular flow: lines at least half their distance apart, and each point within two distances of one."""
    k, apart = 2 * np.pi / SIDE, 0.025
    scene = made_scene(lambda x, y: (np.sin(k * x) * np.cos(k * y), -np.cos(k * x) * np.sin(k * y)))
    lines = streamlines(scene, scene.lower, scene.upper, apart)
    for n, line in enumerate(lines):
        other = np.concatenate(lines[:n] + lines[n + 1 :])
        assert np.linalg.norm(line[:, None] - other[None], axis=2).min() > 0.4 * apart
    points = np.concatenate(lines)
    x = np.linspace(0.1 * SIDE, 0.9 * SIDE, 30)
    grid = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    gap = np.linalg.norm(grid[:, None] - points[None], axis=2).min(axis=1)
    assert np.mean(gap < apart) > 0.95
    assert gap.max() < 2 * apart


def test_a_spiral_ends_before_it_winds_onto_itself():
    middle, apart = SIDE / 2, 0.03
    scene = made_scene(lambda x, y: (y - middle - 0.05 * (x - middle), middle - x - 0.05 * (y - middle)))
    for line in streamlines(scene, scene.lower, scene.upper, apart):
        number = np.arange(len(line))
        gap = np.linalg.norm(line[:, None] - line[None], axis=2)[abs(number[:, None] - number) > 6]
        assert gap.size == 0 or gap.min() > 0.49 * apart or np.array_equal(line[0], line[-1])


def test_legend_tells_each_layer_with_the_interval_of_the_contours():
    scene = made_scene()
    view = View(contours="pressure", interval=50.0, streamlines=True, arrows=True)
    layout = make_layout(SIZE, scene.lower, scene.upper, False, 200)
    fills = colours.fluid_colours(scene.fluid_names)
    _, keys = draw_scene(scene, layout, fills, Look("velocity_x", (-1, 1), view=view))
    texts = [key.text for key in keys]
    assert texts[:3] == ["interface", "pressure, every 50 Pa", "streamlines"]
    assert texts[3] == f"{flow.arrow_speed([scene], view):g} m/s"
    assert len({(key.line, key.head) for key in keys}) >= 3  # no two layers of lines look alike
    assert len({key.line for key in keys[:3]}) == 3
    with pytest.raises(ValueError, match="interval -1"):
        View(contours="pressure", interval=-1)


def test_walls_are_mitred_and_ends_are_round():
    """Strokes of a square with half width 1: with its mitres it has the area of the square with straight corners."""
    pixels = np.array([[0, 0], [10, 0], [10, 10], [0, 10], [20, 0], [30, 0], [20.0, 1.0]])
    square = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    triangles, rounds = joints(pixels, square, 1.0)
    assert len(rounds) == 0
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2
    assert area == pytest.approx(4 * 1.0)  # a unit square at each corner
    assert triangles.min() == pytest.approx(-1)
    assert triangles.max() == pytest.approx(11)
    triangles, rounds = joints(pixels, np.array([[4, 5]]), 1.0)
    assert len(triangles) == 0
    assert sorted(rounds.tolist()) == [[20, 0], [30, 0]]
    _, rounds = joints(pixels, np.array([[4, 5], [5, 6]]), 1.0)  # of 6 degrees
    assert [30, 0] in rounds.tolist()


@pytest.mark.parametrize(
    ("field", "shades", "colour"),
    [(None, None, "#e8432e"), ("velocity_x", "viridis", "#e8432e"), ("velocity_x", None, "#00703c")],
)
def test_contours_are_not_red_on_red(field, shades, colour):
    """Velocities along an axis are blue and red unless another map is chosen."""
    scene = made_scene()
    layout = make_layout(SIZE, scene.lower, scene.upper, False, 200)
    fills = colours.fluid_colours(scene.fluid_names)
    view = View(contours="pressure", interval=50.0, colour_map=shades)
    _, keys = draw_scene(scene, layout, fills, Look(field, field and (-1, 1), view=view))
    assert [key.line for key in keys if key.text.startswith("pressure")] == [colour]


def test_contours_are_on_their_level():
    scene = made_scene()
    segments = flow.contour_segments(scene.position, scene.cells, scene.fields["pressure"], [100.0, 333.0])
    values = segments @ [1000, 500]
    assert np.minimum(np.abs(values - 100), np.abs(values - 333)).max() < 1e-9
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum()
    # Straight lines across the tank.
    assert length == pytest.approx(np.hypot(0.1, 0.2) + np.hypot(0.25, 0.5), rel=1e-6)


def test_tracers_move_with_a_uniform_flow_and_stop_at_the_end_of_the_cells():
    tracers = flow.Tracers(made_scene(lambda x, y: (0.3 + 0 * x, 0 * y)), 100)
    first = tracers.advance(made_scene(lambda x, y: (0.3 + 0 * x, 0 * y), time=0.0))
    assert first.shape == (100, 1, 2)
    for k in range(1, 15):
        paths = tracers.advance(made_scene(lambda x, y: (0.3 + 0 * x, 0 * y), time=0.02 * k))
    assert paths.shape == (100, 12, 2)
    free = first[:, 0, 0] + 0.3 * 0.28 < SIDE - 0.03
    assert paths[free, -1] == pytest.approx(first[free, 0] + [0.3 * 0.28, 0.0], abs=1e-6)
    assert (paths[..., 0] <= SIDE + 0.01).all()


@pytest.mark.parametrize(
    "view",
    [
        View(arrows=True),
        View(streamlines=True),
        View(contours="pressure"),
        View(fill=False),
        View(fill=False, contours="pressure", window=(0, 0, 0.2, 0.2)),
    ],
    ids=str,
)
@pytest.mark.parametrize("field", [None, "pressure"])
def test_layers_are_drawn(view, field):
    scene = made_scene()
    with Renderer(SIZE, "raster") as drawn:
        plain = drawn.frame(scene, field, view=View(window=view.window))
        image = drawn.frame(scene, field, view=view)
        assert 0.002 < (image != plain).any(axis=2).mean() < 0.7


def test_without_fill_the_interface_stands_on_white():
    scene = made_scene()
    image = render_frame(scene, SIZE, backend="raster", view=View(fill=False))
    layout = make_layout(SIZE, scene.lower, scene.upper, False, panel_width(scene, None))
    column, row = layout.pixels([0.3, 0.04]).astype(int)
    assert (image[row, column] == 255).all()


def test_colour_maps_grow_lighter_steadily_or_have_their_lightest_in_the_middle():
    for name in COLOUR_MAPS:
        steps = np.diff(luminance(colour_table(name)))
        if name == "blue-red":
            assert (steps[:120] > 0).all()
            assert (steps[-120:] < 0).all()
        else:
            assert (steps > 0).all()
    scene = made_scene()
    images = [
        render_frame(scene, SIZE, "pressure", backend="raster", view=View(colour_map=name)) for name in COLOUR_MAPS
    ]
    assert (images[0] != images[1]).any(axis=2).mean() > 0.2


def test_tracers_and_windows_in_a_movie(tmp_path):
    out = write_results(tmp_path / "out", sharp=True)
    view = View(tracers=50, window=(0, 0, 0.3, 0.3))
    done = animate(out, movie="paths.gif", size=(480, 320), view=view, backend="raster", samples=1)
    assert len(done.frames) == 3
    assert done.movies[0].is_file()


@pytest.mark.slow
def test_command_line_takes_all_layers(tmp_path):
    out = write_results(tmp_path / "out", times=(0.0, 0.1))
    words = "--no-movie --window 0 0 0.3 0.2 --follow front --no-fill --arrows --streamlines --contours pressure"
    more = "--tracers --colour-map cividis --samples 1 --size 480x320 --backend raster"
    line = [sys.executable, "-m", "tipfem.render", str(out), *words.split(), *more.split()]
    done = subprocess.run(line, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    folder = "frames_cividis_nofill_arrows_streamlines_contours_pressure_tracers_200_window_0_0_0.3_0.2_follow_front"
    assert len(list((out / f"{folder}_480x320").glob("*.png"))) == 2
    assert f"{folder}_480x320: 2 frames" in done.stdout
    line[line.index("front")] = "oil"
    done = subprocess.run(line, capture_output=True, text=True, timeout=120, env=os.environ)
    assert done.returncode == 2
    assert "follow 'oil'" in done.stderr


def test_latest_scenes_are_kept(tmp_path):
    results = Results(write_results(tmp_path / "out"), keep=2)
    first = results.scene(0)
    assert results.scene(0) is first
    results.scene(1)
    assert results.scene(0) is first
    results.scene(2)
    results.scene(1)
    assert results.scene(0) is not first
    path = results.files[0]
    again = results.scene(0)
    os.utime(path, (1, 1))  # written anew
    assert results.scene(0) is not again
    with pytest.raises(ValueError, match="keep 0"):
        Results(tmp_path / "out", keep=0)


@pytest.mark.parametrize(
    ("devices", "expected"),
    [
        ((), None),
        ((("llvmpipe", True),), "llvmpipe"),
        ((("llvmpipe", True), ("GPU", False)), None),
    ],
)
def test_a_software_driver_is_one_without_a_gpu_beside_it(monkeypatch, devices, expected):
    monkeypatch.setattr(vulkan, "devices", lambda: devices)
    assert vulkan.software_driver() == expected


def test_software_drivers_get_the_rasteriser_without_a_word(monkeypatch, capsys):
    monkeypatch.setattr(renderer, "software_driver", lambda: "llvmpipe")
    with Renderer(SIZE, "auto") as drawn:
        assert drawn.backend == "raster"
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("sharp", [False, True])
def test_what_lies_outside_a_window_is_left_out_and_the_picture_is_the_same(sharp, tmp_path, monkeypatch):
    scene = Results(write_results(tmp_path, times=(0.0,), sharp=sharp)).scene(0)
    view = View(window=(0.1, 0.15, 0.3, 0.3), contours="pressure")
    options = dict(size=(640, 360), backend="raster", mesh=True, particles=True, view=view)
    part = [render_frame(scene, field=field, **options) for field in (None, "pressure")]
    counts = []
    triangles = Drawing.triangles
    monkeypatch.setattr(Drawing, "triangles", lambda *a: (counts.append(len(a[1])), triangles(*a))[1])
    render_frame(scene, **options)
    few = sum(counts)
    monkeypatch.setattr(Bounds, "touching", lambda self, lower, upper: np.arange(len(self.lower)))
    counts.clear()
    for field, image in zip((None, "pressure"), part, strict=True):
        assert np.array_equal(render_frame(scene, field=field, **options), image)
    assert few < 0.2 * sum(counts)


def test_the_picture_is_cropped_to_its_tank():
    """At the size that fits, everything is as large as in 1280x720, and no margin is empty."""
    for upper in ((0.584, 0.584), (3.0, 1.0), (1.0, 0.8)):
        for bar in (False, True):
            contents = ((0, 0), upper, False, 200, [110.0], bar)
            size = fitted_size(*contents)
            whole, cropped = make_layout((1280, 720), *contents), make_layout(size, *contents)
            assert size[0] * size[1] < 0.95 * 1280 * 720
            assert size[0] % 2 == size[1] % 2 == 0
            assert cropped.scale == pytest.approx(whole.scale, rel=0.02)
            assert cropped.unit == pytest.approx(1, rel=0.02)
    scene = made_scene()
    image = render_frame(scene, backend="raster")
    assert image.shape[1] < 1000
    assert (image[:, -40:] == 255).all()
    assert not (image[:, -300:] == 255).all()


def test_a_name_and_a_title_of_ones_own(tmp_path):
    out = write_results(tmp_path / "out", times=(0.0, 0.1))
    plain = animate(out, size=SIZE, backend="raster", movie=None, name="mine")
    assert plain.frames[0].parent.name == "frames_mine"
    titled = animate(out, size=SIZE, backend="raster", movie="a.gif", title="A title", name="titled")
    assert titled.movies[0].name == "a_titled.gif"
    first, other = (np.asarray(Image.open(done.frames[0])) for done in (plain, titled))
    assert (first != other).any()
    with pytest.raises(ValueError, match="name 'a/b'"):
        animate(out, name="a/b")


def test_unlike_pictures_have_unlike_names():
    plain = dict(field=None, field_range=None, mesh=False, particles=False, view=View(), size=None, fluid_colours={})
    changes = [
        {},
        {"field": "speed"},
        {"field": "speed", "field_range": (0, 1)},
        {"field": "speed", "field_range": (0, 2)},
        {"mesh": True},
        {"particles": True},
        {"size": (640, 480)},
        {"fluid_colours": {"salt water": "#001122"}},
        *(
            {"view": View(**given)}
            for given in (
                {"arrows": True},
                {"arrows": True, "arrow_speed": 2.0},
                {"streamlines": True},
                {"streamlines": True, "window": (0, 0, 0.3, 0.2)},
                {"streamlines": True, "window": (0, 0, 0.3, 0.25)},
                {"contours": "pressure"},
                {"contours": "pressure", "interval": 100},
                {"tracers": 10},
                {"fill": False},
                {"follow": "front"},
                {"colour_map": "cividis"},
            )
        ),
    ]
    names = [picture_name(**(plain | change)) for change in changes]
    assert len(set(names)) == len(names)
    assert names[0] == ""
    assert names[1] == "speed"
    assert not any(set(name) & set(" /#") for name in names)
