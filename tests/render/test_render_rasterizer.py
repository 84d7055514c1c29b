"""The rasteriser against known triangles, and lines and dots made of triangles."""

import numpy as np
import plain_rasterizer
import pytest
from render_results import SIDE, sharp_tank, tank
from tipfem.render import Scene
from tipfem.render.colours import BACKGROUND, fluid_colours
from tipfem.render.drawing import Drawing
from tipfem.render.layout import make_layout
from tipfem.render.picture import draw_scene
from tipfem.render.rasterizer import Rasterizer
from tipfem.render.view import Look

SIZE = (64, 48)
WHITE, RED, BLUE = (1.0, 1.0, 1.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def paint(drawing):
    return Rasterizer(SIZE).paint(drawing, WHITE)


def covered(image):
    """Covered area [px] of a red drawing on white."""
    return (255 - image[..., 1].astype(float)).sum() / 255


def test_nothing_gives_the_background():
    image = paint(Drawing())
    assert image.shape == (48, 64, 3)
    assert (image == 255).all()


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 1, 0]])
def test_area_and_colour_of_a_triangle(order):
    corners = np.array([[5.0, 4.0], [60.0, 10.0], [20.0, 44.0]])
    drawing = Drawing()
    drawing.triangles(corners[order][None], RED)
    image = paint(drawing)
    a, b = corners[1] - corners[0], corners[2] - corners[0]
    assert covered(image) == pytest.approx(abs(a[0] * b[1] - a[1] * b[0]) / 2, rel=0.01)
    assert image[20, 28].tolist() == [255, 0, 0]
    assert image[40, 50].tolist() == [255, 255, 255]


def test_neighbours_leave_no_gap():
    random = np.random.default_rng(3)
    centre = random.uniform(20, 40, 2)
    angles = np.sort(random.uniform(0, 2 * np.pi, 40))
    ring = centre + 400 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    fan = np.stack([np.broadcast_to(centre, ring.shape), ring, np.roll(ring, -1, axis=0)], axis=1)
    drawing = Drawing()
    drawing.triangles(fan, RED)
    assert (paint(drawing) == [255, 0, 0]).all()


def test_later_triangles_cover_earlier_ones():
    square = np.array([[[10.0, 10], [30, 10], [30, 30]], [[10, 10], [30, 30], [10, 30]]])
    drawing = Drawing()
    drawing.triangles(square, RED)
    drawing.triangles(square + 10, BLUE)
    image = paint(drawing)
    assert image[15, 15].tolist() == [255, 0, 0]
    assert image[25, 25].tolist() == [0, 0, 255]
    drawing.triangles(square, RED)
    assert paint(drawing)[25, 25].tolist() == [255, 0, 0]


def test_colours_are_linear_between_vertices():
    drawing = Drawing()
    shades = np.array([[0.0] * 3, [1.0] * 3, [0.0] * 3])
    drawing.triangles([[[0.0, 0.0], [64.0, 0.0], [0.0, 48.0]]], shades[None])
    row = paint(drawing)[1, :55, 0].astype(float)
    assert row == pytest.approx((np.arange(55) + 0.5) / 64 * 255, abs=1.5)


def test_edges_are_antialiased():
    drawing = Drawing()
    drawing.lines([[[-5.0, 20.5], [70.0, 20.5]]], 20.0, RED)
    column = paint(drawing)[:, 30, 1].tolist()
    # From y = 10.5 to 30.5: half of the rows 10 and 30.
    assert column == [255] * 10 + [128] + [0] * 19 + [128] + [255] * 17


def test_dots_and_coloured_lines():
    drawing = Drawing()
    drawing.dots(np.array([[16.0, 16.0], [48.0, 16.0]]), 6.0, np.array([RED, BLUE]))
    drawing.lines([[[0.0, 36.0], [20.0, 36.0]], [[40.0, 36.0], [60.0, 36.0]]], 4.0, np.array([RED, BLUE]))
    image = paint(drawing)
    assert image[16, 16].tolist() == image[36, 10].tolist() == [255, 0, 0]
    assert image[16, 48].tolist() == image[36, 50].tolist() == [0, 0, 255]


def test_far_vertices_do_not_overflow():
    drawing = Drawing()
    drawing.triangles([[[-1e9, -1e9], [1e9, -1e9], [0.0, 1e9]]], RED)
    assert (paint(drawing) == [255, 0, 0]).all()


def random_drawing(random):
    """Triangles of one colour and of three, slivers, lines and dots, in the picture and beyond its edges."""
    drawing = Drawing()
    for size in (60.0, 4.0, 0.7, 400.0):
        centres = random.uniform(-10, 70, (25, 1, 2))
        drawing.triangles(centres + random.normal(0, size, (25, 3, 2)), random.uniform(0, 1, (25, 3, 3)))
        drawing.triangles(centres + random.normal(0, size, (25, 3, 2)), random.uniform(0, 1, (25, 3)))
    sliver = random.uniform(0, 60, (10, 1, 2)) + np.array([[0, 0], [30, 10], [15, 5.01]])
    drawing.triangles(sliver, random.uniform(0, 1, (10, 3, 3)))
    drawing.triangles(np.round(random.uniform(0, 60, (20, 3, 2))), random.uniform(0, 1, (20, 3)))  # upright edges
    drawing.lines(random.uniform(-20, 90, (30, 2, 2)), 1.3, random.uniform(0, 1, (30, 3)), cap=0.5)
    drawing.dots(random.uniform(0, 60, (20, 2)), 2.2, random.uniform(0, 1, (20, 3)))
    return drawing


@pytest.mark.parametrize("samples", [1, 2])
@pytest.mark.parametrize("seed", range(4))
def test_pictures_are_those_of_the_plain_rasteriser(samples, seed):
    drawing = random_drawing(np.random.default_rng(seed))
    found = Rasterizer(SIZE, samples).paint(drawing, (0.9, 1.0, 0.3)).astype(int)
    expected = plain_rasterizer.paint(*drawing.arrays(), (0.9, 1.0, 0.3), SIZE, samples).astype(int)
    assert np.abs(found - expected).max() <= 1
    assert (found != expected).mean() < 0.002


@pytest.mark.slow(but=("velocity_x-cut",))
@pytest.mark.parametrize("sharp", [False, True], ids=["cut", "sharp"])
@pytest.mark.parametrize("field", [None, "velocity_x"])
def test_scenes_are_those_of_the_plain_rasteriser(field, sharp):
    points, cells, fluid, wall = tank(0.0, 12)
    owner = sharp_tank(0.0, 12)[3] if sharp else None
    scene = Scene(
        position=points,
        cells=cells,
        fluid=fluid,
        wall=wall,
        cell_fluid=owner,
        fluid_names=("water", "air"),
        fields={"velocity_x": points[:, 0] - 0.1},
        lower=(0, 0),
        upper=(SIDE, SIDE),
    )
    size = (320, 240)
    layout = make_layout(size, scene.lower, scene.upper, False, 100)
    drawing, _ = draw_scene(
        scene, layout, fluid_colours(scene.fluid_names), Look(field, (-0.4, 0.4), mesh=True, particles=True)
    )
    found = Rasterizer(size).paint(drawing, BACKGROUND).astype(int)
    expected = plain_rasterizer.paint(*drawing.arrays(), BACKGROUND, size).astype(int)
    assert np.abs(found - expected).max() <= 1
    assert (found != expected).mean() < 0.03  # means just between two levels, by another round-off


@pytest.mark.parametrize(("radius", "count"), [(2.0, 6), (4.0, 16)])
def test_lines_and_dots_are_the_triangles_that_numpy_gives(radius, count):
    random = np.random.default_rng(5)
    segments, centres = random.uniform(-50, 900, (40, 2, 2)), random.uniform(0, 900, (30, 2))
    segments[3, 1] = segments[3, 0]  # of no length
    drawing = Drawing()
    drawing.lines(segments, 3.0, RED, cap=1.5)
    drawing.dots(centres, radius, BLUE)
    start, end = segments[:, 0], segments[:, 1]
    along = (end - start) / np.maximum(np.linalg.norm(end - start, axis=1, keepdims=True), 1e-12)
    aside = 1.5 * np.stack([-along[:, 1], along[:, 0]], axis=1)
    start, end = start - 1.5 * along, end + 1.5 * along
    corners = np.stack([start - aside, end - aside, end + aside, start + aside], axis=1)
    lines = corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3, 2)
    angles = 2 * np.pi / count * np.arange(count)
    ring = centres[:, None] + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    dots = ring[:, [[0, k, k + 1] for k in range(1, count - 1)]].reshape(-1, 3, 2)
    vertices, colours = drawing.arrays()
    np.testing.assert_allclose(vertices, np.concatenate([lines, dots]), rtol=1e-6, atol=1e-4)
    assert (colours[:80] == RED).all()
    assert (colours[80:] == BLUE).all()


def test_one_sample_or_two():
    with pytest.raises(ValueError, match="samples 3"):
        Rasterizer(SIZE, 3)
