"""Pictures of domains with periodic sides."""

import numpy as np
import pytest
from scipy.spatial import Delaunay
from tipfem.render import Scene, View, render_frame
from tipfem.render.flow import Tracers
from tipfem.render.layout import make_layout
from tipfem.render.periodic import with_images
from tipfem.render.renderer import contents

WIDTH, HEIGHT, ACROSS = 1.2, 0.6, 12
SPACING = WIDTH / ACROSS
PERIOD = np.array([WIDTH, 0.0])


def channel(offset):
    """Particles, cells and fluids of a channel whose lattice begins at x = offset: water below, air above."""
    x, y = np.meshgrid(np.arange(-2, ACROSS + 2) * SPACING + offset, np.linspace(0, HEIGHT, 7), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel()])
    triangles = Delaunay(points).simplices
    middle = points[triangles].mean(axis=1)
    triangles = triangles[(middle[:, 0] >= 0) & (middle[:, 0] < WIDTH)]
    inside = np.flatnonzero((points[:, 0] >= 0) & (points[:, 0] < WIDTH - 1e-9))
    home = points.copy()
    home[:, 0] %= WIDTH
    distance = home[:, None] - points[None, inside]
    distance[..., 0] -= WIDTH * np.round(distance[..., 0] / WIDTH)
    owner = np.linalg.norm(distance, axis=2).argmin(axis=1)
    return points[inside], owner[triangles], points, triangles


def area(points, cells):
    a, b, c = (points[cells[:, k]] for k in range(3))
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    return abs(ux * vy - uy * vx) / 2


@pytest.mark.parametrize("offset", [0.0, 0.03, 0.07])
@pytest.mark.parametrize("copies", [False, True])
def test_images_cover_the_whole_period(offset, copies):
    points, cells, unrolled, unrolled_cells = channel(offset)
    given = (unrolled, unrolled_cells) if copies else (points, cells)
    place, nodes, particle, cell = with_images(*given, PERIOD, SPACING)
    assert area(place, nodes).max() < SPACING**2  # none reaches across the domain
    assert len(np.unique(np.round(place / SPACING, 6), axis=0)) == len(place)
    # By Monte Carlo's method: every point of the domain is in a cell, and the first M cells tile it.
    rng = np.random.default_rng(1)
    points = rng.uniform([0, 0], [WIDTH, HEIGHT], (500, 2))
    corner = place[nodes]
    side = np.roll(corner, -1, axis=1) - corner
    away = points[:, None, None] - corner[None]
    turn = side[None, ..., 0] * away[..., 1] - side[None, ..., 1] * away[..., 0]
    inside = (turn >= -1e-12).all(axis=2) | (turn <= 1e-12).all(axis=2)
    assert inside.any(axis=1).all()
    assert area(place, nodes[: len(given[1])]).sum() == pytest.approx(WIDTH * HEIGHT)
    # Images stand whole periods from what they are an image of.
    shift = (place - given[0][particle]) / WIDTH
    np.testing.assert_allclose(shift, np.round(shift), atol=1e-9)
    assert (cell[: len(given[1])] == np.arange(len(given[1]))).all()


def test_interface_runs_on_through_the_ends():
    points, cells, _, _ = channel(0.03)
    middle = np.array([points[c][:, 1].mean() for c in cells])
    scene = Scene(
        position=points,
        cells=cells,
        fluid=(points[:, 1] > HEIGHT / 2).astype(int),
        cell_fluid=(middle > HEIGHT / 2).astype(int),
        fluid_names=("water", "air"),
        fluid_densities=(1000.0, 1.2),
        lower=(0.0, 0.0),
        upper=(WIDTH, HEIGHT),
        spacing=SPACING,
        fields={"pressure": points[:, 0]},
        cell_fields={},
        period=PERIOD,
    )
    segments = scene.geometry.regions.segments
    x = np.sort(segments[..., 0], axis=1)
    x = x[np.argsort(x[:, 0])]
    assert x[0, 0] <= 0
    assert x[-1, 1] >= WIDTH
    np.testing.assert_allclose(x[1:, 0], x[:-1, 1], atol=1e-12)  # without a gap
    image = render_frame(scene, size=(640, 360), backend="raster").astype(int)
    # Air to the very ends of the domain, and nothing beyond them.
    left, top, right, bottom = make_layout((640, 360), *contents(scene, None, View())).box
    row = round((top + 3 * bottom) / 4)
    water = image[row, round((left + right) / 2)]
    assert (abs(image[row, int(left) + 3] - water) < 3).all()
    assert (abs(image[row, int(right) - 3] - water) < 3).all()
    assert (image[row, int(left) - 4] == image[row, int(right) + 4]).all()
    assert (image[row, int(left) - 4] != water).any()


def test_tracers_go_on_through_the_ends():
    points, cells, _, _ = channel(0.03)

    def scene(time):
        return Scene(
            position=points,
            cells=cells,
            fluid=np.zeros(len(points), int),
            fields={"velocity_x": np.full(len(points), 0.5), "velocity_y": np.zeros(len(points))},
            lower=(0.0, 0.0),
            upper=(WIDTH, HEIGHT),
            spacing=SPACING,
            period=PERIOD,
            time=time,
        )

    tracers = Tracers(scene(0.0), 60)
    first = tracers.advance(scene(0.0))[:, -1]
    for k in range(1, 31):
        paths = tracers.advance(scene(0.1 * k))
    moved = paths[:, -1] - first
    np.testing.assert_allclose(moved - PERIOD * np.round(moved / WIDTH), [[1.5 - WIDTH, 0.0]] * len(first), atol=1e-9)
    assert ((paths[:, -1, 0] >= 0) & (paths[:, -1, 0] < WIDTH)).all()
    np.testing.assert_allclose(np.diff(paths[..., 0], axis=1), 0.05, atol=1e-9)  # tails do not cross the domain


def test_bad_period_is_named():
    points, cells, _, _ = channel(0.0)
    with pytest.raises(ValueError, match="period"):
        Scene(position=points, cells=cells, fluid=np.zeros(len(points), int), period=np.array([0.0, 0.0]))
