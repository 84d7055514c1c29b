"""Blocks of tanks in 3-D in pictures, slices, pages, and ParaView's walls."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from render_volumes import SIZE, volume, write_volumes
from scipy.spatial.transform import Rotation
from tipfem.render import Results
from tipfem.render.blocks import CORNERS, EDGES, Blocks, section
from tipfem.render.camera import USUAL, Camera
from tipfem.render.slices import Plane, sliced
from tipfem.render.solid import SolidRenderer
from tipfem.render.viewer.solid_share import solid_state, surface_page

from tipfem.results.fields import walls

BOX = [[0.2, 0.1, 0.0], [0.4, 0.5, 0.7]]
FACTS = {"size": SIZE.tolist(), "boxes": {"pier": BOX}, "reference": [0.0, 0.0, 0.0]}
PICTURE = (480, 320)


def with_blocks(level, **others):
    return volume(level, blocks=Blocks.of(FACTS), **others)


def frame(shown):
    with SolidRenderer(PICTURE) as renderer:
        return renderer.frame(shown).astype(int), renderer._layout().box


def test_a_block_hides_what_is_behind_it_and_is_seen_in_the_water():
    """Of the picture only where the block is changes; above the water it is grey, below it takes the water's colour."""
    (bare, box), (solid, _) = frame(volume(level=0.4)), frame(with_blocks(0.4))
    differs = np.abs(solid - bare).max(axis=2) > 8
    shown = with_blocks(0.4)
    camera = Camera.around(shown.room.corners, 2, USUAL, box)
    seen = camera.seen(shown.blocks_now[0])[:, :2]
    rows, columns = np.nonzero(differs)
    # Refracted by the surface the part below is seen elsewhere, but not far.
    assert (columns > seen[:, 0].min() - 30).all()
    assert (columns < seen[:, 0].max() + 30).all()
    assert (rows > seen[:, 1].min() - 5).all()
    high = camera.seen([0.3, 0.1, 0.6])[:2].round().astype(int)
    assert np.ptp(solid[high[1], high[0]]) < 12
    assert solid[high[1], high[0]].max() < bare[high[1], high[0]].min() - 20


def test_a_block_moves_with_its_tank():
    pose = np.array([0.1, -0.2, 0.3, 0.0, 0.0, np.pi / 2])
    blocks = Blocks.of({**FACTS, "reference": [0.5, 0.3, 0.0]})
    turned = blocks.placed(pose)[0]
    expected = (np.where(CORNERS == 1, *np.array(BOX)[::-1]) - [0.5, 0.3, 0.0]) @ np.array(
        [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    )
    assert turned == pytest.approx(expected + pose[:3])
    assert np.ptp(blocks.walls(pose), axis=0) == pytest.approx(SIZE[[1, 0, 2]])


@pytest.mark.parametrize(
    ("text", "low", "high"), [("y=0.3", (0.2, 0.0), (0.4, 0.7)), ("z=0.3", (0.2, 0.1), (0.4, 0.5))]
)
def test_a_slice_shows_where_it_cuts_blocks(text, low, high):
    scene = sliced(with_blocks(0.4), Plane.of(text))
    (body,) = scene.bodies
    assert body.corners.min(axis=0) == pytest.approx(low)
    assert body.corners.max(axis=0) == pytest.approx(high)
    assert body.mark is None
    assert sliced(with_blocks(0.4), Plane.of("x=0.8")).bodies == ()


@pytest.mark.parametrize(("text", "size"), [("z=0.05", SIZE[:2]), ("y=0.3", SIZE[[0, 2]]), ("x=0.9", SIZE[1:])])
def test_a_slice_has_the_walls_of_the_tank_where_a_block_fills_a_corner(text, size):
    """No particles are on its walls there, and the hull of those there are is no box."""
    step = {**FACTS, "boxes": {"step": [[0.6, 0.0, 0.0], [1.0, 0.6, 0.3]]}}
    made = volume(level=0.4, blocks=Blocks.of(step))
    x = made.position
    made = replace(made, wall=made.wall & ~((x[:, 0] > 0.6 + 1e-9) & (x[:, 2] < 0.3 - 1e-9)))
    scene = sliced(made, Plane.of(text))
    points = scene.tank.points
    assert points.min(axis=0) == pytest.approx(0.0, abs=1e-12)
    assert points.max(axis=0) == pytest.approx(size)
    assert np.minimum(np.abs(points), np.abs(points - size)).min(axis=1).max() < 1e-12


def test_a_slice_beside_a_tank_that_has_moved_off_has_no_walls():
    moved = with_blocks(0.4, pose=np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0]))
    assert sliced(moved, Plane.of("z=0.3")).tank is None


def test_a_turned_box_is_cut_in_a_hexagon():
    """A cube across its diagonal, through the middle."""
    cube = CORNERS - 0.5
    turn = Rotation.align_vectors([[0.0, 0.0, 1.0]], [np.ones(3) / np.sqrt(3)])[0]
    (polygon,) = section((cube @ turn.as_matrix().T)[None], 2, 0.0)
    assert len(polygon) == 6
    assert np.linalg.norm(polygon[:, :2], axis=1) == pytest.approx(np.sqrt(0.5))


def test_pages_have_the_edges_of_blocks(tmp_path):
    bare, made = solid_state(volume(0.4), np.zeros(3), SIZE), solid_state(with_blocks(0.4), np.zeros(3), SIZE)
    assert len(made.edges) == len(bare.edges) + 6 * len(EDGES)
    ends = np.array(made.edges[-6 * len(EDGES) :]).reshape(-1, 3)
    assert ends.min(axis=0) == pytest.approx(BOX[0])
    assert ends.max(axis=0) == pytest.approx(BOX[1])
    out = write_volumes(tmp_path)
    case = json.loads((out / "case.json").read_text())
    (out / "case.json").write_text(json.dumps(case | {"blocks": FACTS}))
    results = Results(out, solid=True)
    assert results.volume(0).blocks_now.shape == (1, 8, 3)
    assert surface_page(results, 10.0)[0]["blocks"] == 1


def test_walls_for_paraview_are_boxes_where_the_tank_is():
    points, cells, number = walls.boxes(FACTS, {})
    assert points.reshape(2, 8, 3).max(axis=1) == pytest.approx(np.array([SIZE, BOX[1]]))
    assert len(cells) == len(number) == 24
    a, b, c = np.moveaxis(points[cells[12:]], 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(2 * (0.08 + 0.28 + 0.14))
    row = {"tank_x": 0.1, "tank_y": 0.0, "tank_z": 0.0, "tank_turn_x": 0.0, "tank_turn_y": 0.0, "tank_turn_z": np.pi}
    assert walls.boxes(FACTS, row)[0].reshape(2, 8, 3)[0].min(axis=0) == pytest.approx([0.1 - 1.0, -0.6, 0.0])
