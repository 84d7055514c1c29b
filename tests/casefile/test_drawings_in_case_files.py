"""Case files whose shapes are drawings."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.app.commands import main

ezdxf = pytest.importorskip("ezdxf")

CASE = """\
gravity = [0, -9.81]

[tank]
spacing = 0.01
shape = { drawing = "weir.dxf", layer = ["bed", "walls"] }

[fluids.water]
density = 998.2
viscosity = 1.002e-3

[fluids.air]
density = 1.204
viscosity = 1.825e-5

[[fill]]
fluid = "air"

[[fill]]
fluid = "water"
shape = { drawing = "weir.dxf", layer = ["water"], scale = 1e-3 }

[walls.bed]
slip = true

[time]
end = 0.002
"""


@pytest.fixture
def folder(tmp_path):
    document = ezdxf.new(units=4)
    space = document.modelspace()
    bed = [(0, 0, 0), (100, 0, 0), (120, 30, 0.2), (160, 30, 0), (180, 0, 0), (250, 0, 0)]
    space.add_lwpolyline([(x, y, -bulge) for x, y, bulge in bed], format="xyb", dxfattribs={"layer": "bed"})
    space.add_lwpolyline([(250, 0), (250, 120), (0, 120), (0, 0)], dxfattribs={"layer": "walls"})
    space.add_lwpolyline([(0, 0), (140, 0), (140, 80), (0, 80)], close=True, dxfattribs={"layer": "water"})
    document.saveas(tmp_path / "weir.dxf")
    return tmp_path


def test_a_case_file_has_drawings_as_tank_and_fill(folder):
    (folder / "case.toml").write_text(CASE)
    case = tp.load_case(folder / "case.toml").case()
    assert case.tank.sides == ("bed", "walls")
    shape = tp.read_drawing(folder / "weir.dxf", ["bed", "walls"])
    assert case.tank.shape.area == pytest.approx(shape.area, rel=1e-12)
    top = case.particles.position[case.particles.fluid == 0, 1].max()
    assert top == pytest.approx(0.08, abs=1e-9)
    assert main(["run", str(folder / "case.toml"), "--out", str(folder / "out"), "--no-progress"]) == 0
    (folder / "weir.dxf").unlink()
    kept = tp.load_case(folder / "out" / "case.toml").case()  # with corners and arcs
    assert kept.tank.sides == case.tank.sides
    np.testing.assert_allclose(kept.particles.position, case.particles.position, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            '"weir.dxf", layer = ["bed"',
            '"dam.dxf", layer = ["bed"',
            "case.toml:5: tank.shape: read_drawing .*no such file",
        ),
        ('"bed", "walls"', '"bed"', r"case.toml:5: tank.shape: .*LWPOLYLINE \w+ on layer 'bed' ends at"),
        (
            '["water"]',
            '["wasser"]',
            r"case.toml:20: fill\[1\].*: .*no layer 'wasser' with lines; it has 'bed', 'walls'",
        ),
        (
            '{ drawing = "weir.dxf", layer = ["bed", "walls"] }',
            '{ layer = ["bed"] }',
            "layer is given without a drawing",
        ),
        ('layer = ["water"]', "circle = { centre = [0, 0], radius = 1 }", "circle is given with a drawing"),
        (
            'shape = { drawing = "weir.dxf", layer = ["bed", "walls"] }',
            'drawing = "weir.dxf"',
            r"a drawing is a shape, of the tank",
        ),
        ("scale = 1e-3", "scale = -1", r"fill\[1\].shape.scale is -1; it must be a number > 0"),
    ],
)
def test_faults_of_drawings_have_their_place_in_the_case_file(folder, old, new, message):
    (folder / "case.toml").write_text(CASE.replace(old, new))
    with pytest.raises(tp.CaseFileError, match=message):
        tp.load_case(folder / "case.toml").case()
