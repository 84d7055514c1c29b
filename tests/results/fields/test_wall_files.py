"""Walls and bodies as ParaView shows them: where they are when fields are written, and once where they never move."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
from tipfem.render import Results

import tipfem as tp
from tipfem.results.fields import walls

SQUARE = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]]
HOLE = [[0.5, 0.5], [0.5, 0.7], [0.7, 0.7]]


BOX = [[1.0, 0.2], [1.4, 0.2], [1.2, 0.4]]


def test_lines_follow_the_tank_and_the_body():
    poses = {"tank": (0.3, 0.1, np.pi / 2), "box": (1.0, 0.5, 0.0)}
    outlines = [walls.Outline("tank", np.array(loop), (0, 0), -1) for loop in (SQUARE, HOLE)]
    points, lines, body = walls.lines([*outlines, walls.Outline("box", np.array(BOX), (1.2, 0.25), 0)], poses)
    assert body.tolist() == [-1] * 7 + [0] * 3
    turned = np.array(SQUARE + HOLE) @ [[0, 1], [-1, 0]] + [0.3, 0.1]
    assert points[:7, :2] == pytest.approx(turned)
    assert points[7:, :2] == pytest.approx(np.array(BOX) + [-0.2, 0.25])
    length = np.linalg.norm(points[lines[:, 1]] - points[lines[:, 0]], axis=1)
    assert length[:4] == pytest.approx([2, 1, 2, 1])
    assert (np.bincount(lines.ravel()) == 2).all()  # closed
    known = walls.poses_between([{"time": 0.0, "box_x": 0.0, "box_y": 1.0, "box_angle": 0.0}] * 2, 0.0, ["box", "tank"])
    assert known == {"box": (0.0, 1.0, 0.0)}
    rows = [{"time": t, "box_x": t, "box_y": 0.0, "box_angle": 2 * t} for t in (1.0, 2.0)]
    assert walls.poses_between(rows, 1.25, ["box"])["box"] == pytest.approx((1.25, 0.0, 2.5))


def test_without_an_outline_the_hull_is_drawn():
    assert len(walls.hull(np.array([*SQUARE, [1.0, 0.0], [2.0, 0.5]]))) == 4


def test_faces_of_a_box_close_it():
    box = np.array([[x, y, z] for x in (0, 1, 2) for y in (0, 1) for z in (0.0, 3.0)], float)
    points, faces, _ = walls.faces(box)
    a, b, c = np.moveaxis(points[faces], 1, 0)
    assert 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() == pytest.approx(2 * (2 + 6 + 3))


def test_a_run_writes_them_beside_its_fields(tmp_path, water, air):
    tank = tp.tank((0.4, 0.4), 0.04).fill(air).fill(water, box=((0, 0), (0.4, 0.2)))
    tp.Simulation(tp.Case(tank, [water, air], (0, -9.81)), tmp_path / "still", output_interval=2e-3).run(
        4e-3, progress=False
    )
    assert [path.name for path in (tmp_path / "still" / "walls").iterdir()] == ["step_000000.vtu"]
    motion = tp.Motion(translation=lambda t: (5 * t**2, 0.0), angle=lambda t: t**2)
    tp.Simulation(
        tp.Case(tank, [water, air], (0, -9.81), tank_motion=motion), tmp_path / "moved", output_interval=2e-3
    ).run(6e-3, progress=False)
    results = Results(tmp_path / "moved")
    collection = (tmp_path / "moved" / "walls.pvd").read_text()
    assert collection.count("<DataSet") == len(results) == 4
    for number, file in enumerate(results.files):
        found = meshio.read(tmp_path / "moved" / "walls" / file.name)
        assert found.points[:, :2].min(axis=0) == pytest.approx(
            results.scene(number).tank.points.min(axis=0), abs=1e-12
        )
