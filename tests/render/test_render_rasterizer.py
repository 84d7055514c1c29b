"""The rasteriser against known triangles, and lines and dots made of triangles."""

import numpy as np
import pytest
from tipfem.render.drawing import Drawing
from tipfem.render.rasterizer import Rasterizer

SIZE = (64, 48)
WHITE, RED, BLUE = (1.0, 1.0, 1.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def paint(drawing):
    return Rasterizer(SIZE).paint(*drawing.arrays(), WHITE)


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
