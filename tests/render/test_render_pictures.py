"""Scenes, colours, layout and whole pictures with the rasteriser."""

import numpy as np
import pytest
from render_results import SIDE, tank
from tipfem.render import Renderer, Scene, View, colours, render_frame
from tipfem.render.annotation import panel_width
from tipfem.render.bodies import BodyOutline
from tipfem.render.colours import colour_table, fluid_colours, luminance, map_values, rgb
from tipfem.render.layout import make_layout
from tipfem.render.renderer import contents
from tipfem.render.scales import FieldSample, round_ticks, tick_labels


def made_scene(**changes):
    points, cells, fluid, wall = tank(0.0)
    given = dict(
        position=points,
        cells=cells,
        fluid=fluid,
        wall=wall,
        fluid_names=("water", "air"),
        fields={"pressure": 1000 * points[:, 1], "velocity_x": points[:, 0] - 0.1},
        lower=(0, 0),
        upper=(SIDE, SIDE),
    )
    return Scene(**(given | changes))


def pixel_at(scene, size, x, y, field=None):
    layout = make_layout(size, scene.lower, scene.upper, bool(scene.title), panel_width(scene, field))
    column, row = layout.pixels([x, y]).astype(int)
    return row, column


@pytest.mark.parametrize("size", [(1280, 720), (640, 480), (400, 640)])
def test_fluids_have_their_colours(size):
    scene = made_scene()
    image = render_frame(scene, size, backend="raster")
    assert image.shape == (size[1], size[0], 3)
    assert image.dtype == np.uint8
    assert image[pixel_at(scene, size, 0.3, 0.1)] == pytest.approx(255 * rgb("#0072b2"), abs=1)
    assert image[pixel_at(scene, size, 0.1, 0.4)] == pytest.approx(255 * rgb("#e8f3fa"), abs=1)
    assert (image[:2] == 255).all()
    assert (image[-2:] == 255).all()


def test_paths_of_tracers_end_at_bodies():
    """A body hides the path that goes across it, and what lies beside it shows."""
    size, box = (640, 480), [[0.2, 0.2], [0.3, 0.2], [0.3, 0.3], [0.2, 0.3]]
    body = BodyOutline({"corners": box, "reference": [0.25, 0.25]}).placed(0.25, 0.25, 0.0)
    path = np.stack([np.linspace(0.1, 0.4, 12), np.full(12, 0.22)], axis=1)[None]
    scene, bare = made_scene(bodies=(body,), trails=path), made_scene(bodies=(body,))
    image, without = (render_frame(one, size, backend="raster") for one in (scene, bare))
    layout = make_layout(size, scene.lower, scene.upper, bool(scene.title), panel_width(scene, None))
    (left, row), (right, _), (beside, _) = layout.pixels([[0.21, 0.22], [0.29, 0.22], [0.36, 0.22]]).astype(int)
    assert (image[row, left:right] == without[row, left:right]).all()
    assert (image[row, beside] != without[row, beside]).any()


def test_chosen_colour_wins():
    scene = made_scene()
    image = render_frame(scene, (640, 480), backend="raster", fluid_colours={"water": "#804020"})
    assert image[pixel_at(scene, (640, 480), 0.3, 0.1)].tolist() == [0x80, 0x40, 0x20]


def test_field_has_the_colours_of_its_table():
    scene = made_scene()
    size = (640, 480)
    image = render_frame(scene, size, field="pressure", field_range=(0, 500), backend="raster")
    expected = map_values([100.0], 0, 500, colour_table("viridis"))[0] * 255
    assert image[pixel_at(scene, size, 0.25, 0.1, "pressure")] == pytest.approx(expected, abs=6)


def test_options_change_the_tank_and_not_the_frame():
    scene = made_scene()
    with Renderer((640, 480), backend="raster") as renderer:
        plain = renderer.frame(scene)
        for options in ({"mesh": True}, {"particles": True}, {"mesh": True, "particles": True}):
            image = renderer.frame(scene, **options)
            assert 0.02 < (image != plain).any(axis=2).mean() < 0.6
            assert (renderer.frame(scene) == plain).all()


def colours_in(image):
    """All colours of an image, as a set of triples."""
    return set(map(tuple, image.reshape(-1, 3).tolist()))


@pytest.mark.slow
def test_three_fluids_have_three_colours():
    points, cells, fluid, _ = tank(0.0)
    fluid[:40] = 2
    chosen = {"water": "#804020", "air": "#208040", "glycerin": "#402080"}
    scene = Scene(position=points, cells=cells, fluid=fluid, fluid_names=tuple(chosen))
    found = colours_in(render_frame(scene, (400, 300), backend="raster", fluid_colours=chosen))
    assert {(0x80, 0x40, 0x20), (0x20, 0x80, 0x40), (0x40, 0x20, 0x80)} <= found


def test_particles_are_drawn_where_there_are_no_cells():
    bare = Scene(position=tank(0.0)[0], cells=[], fluid=np.zeros(len(tank(0.0)[0])))
    empty = render_frame(bare, (400, 300), mesh=True, backend="raster")
    drawn = render_frame(bare, (400, 300), particles=True, mesh=True, backend="raster")
    assert 0.001 < (drawn != empty).any(axis=2).mean() < 0.5


def test_colours_of_fluids():
    fills = fluid_colours(("glycerin", "air", "water"), (1261, 1.2, 998))
    assert fills[2] == pytest.approx(rgb("#0072b2"))
    assert fills[0] == pytest.approx(rgb("#e69f00"))
    assert luminance(fills[1]) > 0.9
    assert fluid_colours(("oil",), (900,))[0] == pytest.approx(rgb("#0072b2"))


def test_lightness_of_the_field_colours_grows_steadily():
    steps = np.diff(luminance(colour_table("viridis")))
    assert (steps > 0).all()


def test_tank_fits_and_keeps_its_shape():
    for size in [(1280, 720), (320, 240), (720, 1280), (3840, 2160)]:
        for upper in [(1.0, 1.0), (3.2, 1.0), (0.2, 2.0), (100.0, 1.0)]:
            layout = make_layout(size, (0, 0), upper, True, 200)
            left, top, right, bottom = layout.box
            assert 0 < left < right < size[0]
            assert 0 < top < bottom < size[1]
            assert (right - left) / (bottom - top) == pytest.approx(upper[0] / upper[1])
            assert layout.panel[3] <= size[1] + 1
            assert layout.panel[2] <= size[0]


def test_ticks_are_round():
    assert round_ticks(0, 0.584, 7) == pytest.approx([0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert tick_labels([0, 0.1, 0.2]) == ["0.0", "0.1", "0.2"]
    assert tick_labels([-500.0, 0.0, 500.0]) == ["-500", "0", "500"]
    assert tick_labels([0.0, 2.5e-5, 5e-5]) == ["0", "2.5e-05", "5e-05"]


def test_peaks_do_not_set_the_range_and_little_below_zero_is_left_to_the_end_of_the_bar():
    scene = made_scene()
    values = np.linspace(-40, 1000, len(scene.position))
    values[[3, 5]] = 1e5, -1e5  # single peaks
    calm = made_scene(fields={"pressure": values})
    assert FieldSample([calm], "pressure").limits() == (0, 1000)
    impact = made_scene(fields={"pressure": values + np.where(np.arange(len(values)) % 50 == 0, 9000, 0)})
    for scenes in ([impact], [calm] * 9 + [impact]):
        assert FieldSample(scenes, "pressure").limits() == (0, 10_000)
    assert FieldSample([made_scene(fields={"pressure": -values})], "pressure").limits() == (-1000, 0)


def test_of_no_time_more_than_a_hundredth_is_beyond_the_ends_of_the_colours():
    """A flow that is fast at one of many times, and slow at another: the fast one is not one blot."""
    any_ = np.random.default_rng(5)
    scenes = [made_scene(fields={"speed": speed * any_.rayleigh(1.0, 625)}) for speed in (0.01, 0.1, 10.0, 1.0, 0.2)]
    low, high = FieldSample(scenes, "speed").limits()
    beyond = [((scene.fields["speed"] > high) | (scene.fields["speed"] < low)).mean() for scene in scenes]
    assert max(beyond) <= 0.01
    assert high < 60


def test_ends_of_colours_are_found_by_area():
    """In graded cells a few particles are much of the picture, and many of them hardly any."""
    points, *_ = tank(0.0)
    graded = SIDE * (points / SIDE) ** 3
    far = np.argsort(graded.sum(axis=1))
    for there, value in ((far[-3:], 10), (far[:60], 1)):  # 0.5 % of the particles in 1 % of the area; 10 % in 0.05 %
        speed = np.ones(len(points))
        speed[there] = 10.0
        assert FieldSample([made_scene(position=graded, fields={"speed": speed})], "speed").limits() == (0, value)


def test_automatic_range():
    scene = made_scene()
    assert FieldSample([scene], "pressure").limits() == (0, 500)
    low, high = FieldSample([scene], "velocity_x").limits()
    assert low == -high
    flat = made_scene(fields={"pressure": np.full(len(scene.position), 7.0)})
    low, high = FieldSample([flat], "pressure").limits()
    assert low < 7 < high


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"position": np.zeros((3, 3))}, "position"),
        ({"cells": [[0, 1, 10**6]]}, "cells"),
        ({"fluid": [0, 1]}, "fluid"),
        ({"fluid_names": ("water",)}, "fluid"),
        ({"fields": {"pressure": np.zeros(3)}}, "pressure"),
        ({"upper": (-1, 1)}, "upper"),
        ({"fluid_densities": (1.0,)}, "fluid_densities"),
        ({"spacing": 0}, "spacing"),
    ],
)
def test_bad_scenes_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        made_scene(**changes)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": (641, 480)}, "641x480"),
        ({"size": (64, 48)}, "64x48"),
        ({"size": "large"}, "large"),
        ({"backend": "opengl"}, "opengl"),
        ({"field": "helicity"}, "helicity.*pressure"),
        ({"field": "pressure", "field_range": (5, 5)}, "5 to 5"),
        ({"fluid_colours": {"oil": "#123456"}}, "oil"),
        ({"fluid_colours": {"air": "blue"}}, "blue"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        render_frame(made_scene(), **({"backend": "raster", "size": (640, 480)} | options))


def test_value_that_is_not_finite_is_named():
    scene = made_scene()
    scene.fields["pressure"][5] = np.nan
    with pytest.raises(ValueError, match="particle 5"):
        render_frame(scene, field="pressure", backend="raster")


@pytest.mark.parametrize("field", [None, "pressure"])
def test_a_free_surface_has_walls_around_emptiness_and_drops_in_it(field):
    """Cells of the lower half only: white above with walls around it, and a particle in no cell is a drop."""
    scene = made_scene()
    low = scene.position[scene.cells][..., 1].max(axis=1) < 0.25
    partly = made_scene(cells=scene.cells[low])
    size = (640, 480)
    options = dict(field=field, field_range=(0, 500), backend="raster") if field else dict(backend="raster")
    image, whole = render_frame(partly, size, **options), render_frame(scene, size, **options)
    layout = make_layout(size, scene.lower, scene.upper, False, panel_width(scene, field))
    drops = np.flatnonzero(~scene.wall & (scene.position[:, 1] > 0.35))
    column, row = layout.pixels(scene.position[drops[0]]).astype(int)
    assert (image[row, column] < 255).any()
    gaps = np.array([[x, y] for x in np.linspace(0.1, 0.4, 60) for y in np.linspace(0.35, 0.45, 20)])
    far = np.linalg.norm(gaps[:, None] - scene.position[None], axis=2).min(axis=1) > 0.6 * scene.spacing
    assert far.any()
    for x, y in gaps[far]:
        column, row = layout.pixels([x, y]).astype(int)
        assert (image[row, column] == 255).all()
    # The walls are where they are with all cells.
    left, top, right, bottom = (round(v) for v in layout.box)
    for column, row in ((left - 2, (top + bottom) // 2), (right + 2, top + 20), ((left + right) // 2, top - 2)):
        np.testing.assert_array_equal(image[row, column], whole[row, column])
        assert (image[row, column] < 120).all()


def test_a_block_on_the_floor_is_filled_thin_or_wide():
    """A tank 12 wide with a notch from below, 0.2 or 6 wide and 1 high, as a mesh of three rectangles around it."""
    colours = []
    for width in (0.2, 6.0):
        left, right = 6 - width / 2, 6 + width / 2
        x, y = np.meshgrid([0.0, left, right, 12.0], [0.0, 0.25, 0.5, 0.75, 1.0, 8.0], indexing="ij")
        position = np.stack([x.ravel(), y.ravel()], axis=1)
        squares = [(i, j) for i in range(3) for j in range(5) if i != 1 or j == 4]
        corner = {(i, j): 6 * i + j for i in range(4) for j in range(6)}
        cells = [
            triangle
            for i, j in squares
            for triangle in (
                (corner[i, j], corner[i + 1, j], corner[i + 1, j + 1]),
                (corner[i, j], corner[i + 1, j + 1], corner[i, j + 1]),
            )
        ]
        scene = Scene(
            position=position,
            cells=np.array(cells),
            fluid=np.zeros(24, int),
            wall=np.ones(24, int),
            fluid_names=("water",),
            lower=(0, 0),
            upper=(12, 8),
        )
        size = (600, 450)
        image = render_frame(scene, size, backend="raster")
        row, column = pixel_at(scene, size, 6.0, 0.6)
        floor = pixel_at(scene, size, 6.0, 0.0)[0] + 2
        colours.append([image[row, column], image[floor, column]])
    assert np.max(colours) < 120  # the colour of walls, in the blocks and under them


@pytest.mark.parametrize("scheme", [colours.LIGHT, colours.DARK], ids=["light", "dark"])
def test_lit_fluids_stand_out_from_their_outlines_and_dark_pictures_have_no_bright_tank(scheme):
    """A contrast of three from each fluid, at any depth, to the line around it; as told apart as flat ones are."""
    names = ["water", "oil", "glycerin", "resin", "ink", "honey", "air"]
    own = fluid_colours(names, [1000, 950, 940, 930, 920, 910, 1.2])
    ends = colours.shades(own, scheme)
    heights = colours.at_depth(ends[:, None], np.linspace(0, 1, 9)[None], 0, 1)
    assert colours.contrast(heights, rgb(scheme.line)).min() > 3
    assert (colours.luminance(heights).max() < 0.6) == scheme.dark
    assert colours.luminance(colours.shades(own, colours.DARK)[-1]).max() < 0.2
    flat = colours.shades(own, scheme, "flat")
    assert (flat[:, 0] == flat[:, 1]).all()
    assert scheme.dark or (flat[:, 0] == own).all()


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("look", ["lit", "flat"])
def test_a_lit_picture_is_brighter_above_and_a_flat_one_is_not(dark, smooth, look):
    scene, size, view = made_scene(), (640, 480), View(smooth=smooth, look=look)
    with Renderer(size, "raster", dark=dark) as renderer:
        image = renderer.frame(scene, view=view).astype(float)
    layout = make_layout(size, *contents(scene, None, view))
    (x, high), (_, low) = layout.pixels([[0.3, 0.15], [0.3, 0.02]]).astype(int)
    gain = image[high, x].mean() - image[low, x].mean()
    assert gain > 5 if look == "lit" else abs(gain) < 1
    with pytest.raises(ValueError, match="look 'wet'"):
        View(look="wet")
