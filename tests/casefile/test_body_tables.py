"""Bodies in case files: read, written back, and refused with the place of what is wrong."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.casefile.loading import load_case
from tipfem.casefile.problems import CaseFileError

HEAD = """
gravity = [0, -9.81]
fluids.oil = { density = 900.0, viscosity = 0.1 }
tank = { size = [1.0, 1.0], spacing = 0.05 }
fill = [{ fluid = "oil" }]
time = { end = 1.0 }
"""
LOG = '[[bodies]]\nname = "log"\ndisc = { centre = [0.3, 0.5], radius = 0.1 }\ndensity = 500.0\nfree = ["y", "angle"]\n'
GATE = """
[[bodies]]
name = "gate"
box = [[0.68, 0.2], [0.76, 0.7]]
motion = { translation = { form = "ramp", end_value = [0.0, 0.1], end_time = 0.5 }, pivot = [0.7, 0.2] }
"""


def loaded(tmp_path, text):
    path = tmp_path / "case.toml"
    path.write_text(HEAD + text, encoding="utf-8")
    return load_case(path)


def test_bodies_are_read_and_written_back(tmp_path):
    case = loaded(tmp_path, LOG + GATE).case()
    log, gate = case.bodies
    assert (log.name, log.density, log.freedoms) == ("log", 500.0, ("y", "angle"))
    assert gate.motion is not None
    np.testing.assert_allclose(gate.prescribed(0.5, 1e-3)[0], [0.7, 0.3, 0.0])
    described = tp.describe(case, 1.0)
    assert not described.missing
    (tmp_path / "again.toml").write_text(described.text, encoding="utf-8")
    again = load_case(tmp_path / "again.toml").case()
    np.testing.assert_array_equal(again.particles.position, case.particles.position)
    assert again.bodies[0].free == ["y", "angle"]
    np.testing.assert_array_equal(again.bodies[1].corners, gate.corners)


def test_outlines_with_arcs_are_read_and_written_back(tmp_path):
    shape = "{ corners = [[0.3, 0.4], [0.5, 0.4], [0.5, 0.6], [0.3, 0.6]], arcs = [{ edge = 1, centre = [0.5, 0.5] }] }"
    case = loaded(tmp_path, f'[[bodies]]\nname = "D"\nshape = {shape}\n').case()
    assert case.bodies[0].outline.area == pytest.approx(0.04 + 0.5 * np.pi * 0.01)
    described = tp.describe(case, 1.0)
    assert not described.missing
    (tmp_path / "again.toml").write_text(described.text, encoding="utf-8")
    again = load_case(tmp_path / "again.toml").case()
    np.testing.assert_array_equal(again.bodies[0].corners, case.bodies[0].corners)
    np.testing.assert_array_equal(again.particles.position, case.particles.position)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[bodies]]\ndensity = 1.0\n", "bodies.*has no shape; give one of box, disc, polygon"),
        (LOG + LOG, "log.*the name of another body"),
        (LOG.replace("500.0", "-1.0"), "density"),
        (LOG + "mass = 1.0\n", "mass is given beside density"),
        (GATE.replace("[0.0, 0.1]", "0.1"), "it must be 2 numbers"),
        (LOG.replace("[0.3, 0.5]", "[0.0, 0.5]"), "must be inside the tank"),
    ],
)
def test_mistakes_are_named(tmp_path, text, message):
    with pytest.raises(CaseFileError, match=f"(?s){message}"):
        loaded(tmp_path, text).case()
