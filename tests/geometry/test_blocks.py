"""Boxes with blocks in them: their planes, and which points are where."""

from __future__ import annotations

import numpy as np
import pytest

from tipfem.geometry.blocks import BlockedBox

SIZE = np.array([2.0, 1.0, 1.0])
STEP = {"step": np.array([[0.0, 0.0, 0.0], [0.5, 1.0, 0.25]])}
PIER = {"pier": np.array([[0.75, 0.25, 0.0], [1.0, 0.75, 0.5]])}


def brute(x, boxes):
    """Mask of points in the box and in no block."""
    inside = ((x > 0) & (x < SIZE)).all(axis=1)
    return inside & ~np.any([((x > low) & (x < high)).all(axis=1) for low, high in boxes.values()], axis=0)


def test_planes_and_volume():
    box = BlockedBox(SIZE, STEP | PIER)
    assert box.volume == pytest.approx(2.0 - 0.5 * 0.25 - 0.25 * 0.5 * 0.5, abs=1e-15)
    assert set(box.names[k] for k in np.flatnonzero(box.outer)) == {"left", "right", "bottom", "top", "back", "front"}
    assert {name for name in box.names if name.startswith("step ")} == {"step right", "step front"}
    assert {name for name in box.names if name.startswith("pier ")} == {
        f"pier {side}" for side in ("left", "right", "bottom", "top", "front")
    }
    k = box.names.index("pier right")
    assert box.normal[k].tolist() == [1, 0, 0]
    assert box.offset[k] == 1.0


def test_where_points_are():
    box, rng = BlockedBox(SIZE, STEP | PIER), np.random.default_rng(0)
    x = rng.uniform(-0.1, 1.1, (4000, 3)) * SIZE
    assert (box.solid(x) == ~brute(x, STEP | PIER)).all()
    wet, wall = box.around(x, 0.04)
    near = [x + 0.04 * (1 - 1e-9) * np.array([i, j, k]) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)]
    fluid = np.array([brute(y, STEP | PIER) for y in near])
    assert (wet == fluid.any(axis=0)).all()
    assert (wall == ~fluid.all(axis=0)).all()
    deep = box.inner(0.06)
    assert len(deep) > 0
    assert not box.around(deep, 1.2 * 0.06)[0].any()


def test_a_node_in_a_narrow_place_is_in_no_block():
    """Between a wall and a block, with others on all sides: no point there may count as deep in a block."""
    boxes = {"a": np.array([[0.2, 0.3, 0.0], [0.9, 1.0, 1.0]]), "b": np.array([[0.0, 0.0, 0.6], [1.5, 0.3, 1.0]])}
    assert box_is_right(BlockedBox(SIZE, boxes), boxes)


def box_is_right(box, boxes):
    deep = box.inner(0.1)
    return len(deep) > 0 and not brute(deep, boxes).any()


def test_points_on_planes_end_at_the_edges_of_blocks():
    box = BlockedBox(SIZE, PIER)
    x = np.array(
        [[1.0, 0.5, 0.2], [1.0, 0.1, 0.2], [1.0, 0.25, 0.2], [1.0, 0.5, 0.0], [0.9, 0.5, 0.5], [1.0, 0.75, 0.5]]
    )
    on = box.on_edges(x, 1e-9)
    found = [{box.names[k] for k in np.flatnonzero(row)} for row in on]
    assert found == [
        {"pier right"},
        set(),  # on the plane of that side, beside it
        {"pier right", "pier bottom"},
        {"pier right", "back"},
        {"pier front"},
        {"pier right", "pier top", "pier front"},
    ]


def test_what_has_passed_a_side():
    box = BlockedBox(SIZE, PIER)
    x = np.array([[0.99, 0.5, 0.2], [0.9, 0.5, 0.49], [0.9, 0.26, 0.2], [0.5, 0.5, 0.2], [-0.1, 0.5, 0.2]])
    names = [box.names[k] if k >= 0 else "" for k in box.passed(x)]
    assert names == ["pier right", "pier front", "pier bottom", "", ""]


@pytest.mark.parametrize(
    ("boxes", "text"),
    [
        ({"a": [[0, 0, 0], [2, 1, 1]]}, "one part"),
        ({"a": [[0.5, 0, 0], [1, 1, 1]]}, "one part"),
        ({"a": [[0.5, 0.5, 0], [1, 1, 0.5]], "b": [[1, 0, 0], [1.5, 0.5, 0.5]]}, "edge alone"),
        ({"a": [[0.5, 0.5, 0.25], [1, 0.8, 0.5]], "b": [[1, 0.2, 0.5], [1.5, 0.5, 0.8]]}, "corner alone"),
    ],
)
def test_blocks_that_leave_no_region_are_refused(boxes, text):
    with pytest.raises(ValueError, match=text):
        BlockedBox(SIZE, {name: np.array(box, dtype=float) for name, box in boxes.items()})


def test_overlapping_blocks_are_one():
    both = {"a": np.array([[0.5, 0, 0], [1, 1, 0.5]]), "b": np.array([[0.75, 0, 0], [1.25, 1, 0.25]])}
    box = BlockedBox(SIZE, both)
    assert box.volume == pytest.approx(2 - 0.25 - 0.25 * 0.25)
    assert "a right" in box.names  # above the other one
    assert "b left" not in box.names
    assert box.joined == set()


def test_sides_of_blocks_in_a_row_have_names_of_their_own():
    box = BlockedBox(
        SIZE, {"one": np.array([[0.2, 0.2, 0.0], [0.4, 0.5, 0.5]]), "two": np.array([[0.8, 0.2, 0.0], [1, 0.5, 0.5]])}
    )
    assert {"one top", "two top", "one front", "two front"} <= set(box.names)
    assert box.joined == set()
    on = box.on_edges(np.array([[0.9, 0.3, 0.5]]), 1e-9)[0]
    assert [box.names[k] for k in np.flatnonzero(on)] == ["two front"]


def test_planes_of_one_direction_have_one_number():
    """The faces of cells have bits for them; there are few bits, and many blocks."""
    boxes = {str(k): np.array([[0.1 + 0.4 * k, 0.2, 0.2], [0.3 + 0.4 * k, 0.8, 0.8]]) for k in range(4)}
    box = BlockedBox(SIZE, boxes)
    assert len(box) == 6 + 4 * 6
    assert sorted(set(box.kinds.tolist())) == list(range(6))
    for kind in range(6):
        assert np.ptp(box.normal[box.kinds == kind], axis=0).max() == 0
