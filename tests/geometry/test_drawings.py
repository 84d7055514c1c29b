"""Shapes from drawings: DXF and SVG files."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

import tipfem as tp

ezdxf = pytest.importorskip("ezdxf")
pytest.importorskip("svgpathtools")


def dxf(path, draw, units=4, **options):
    document = ezdxf.new(units=units, **options)
    draw(document.modelspace(), document)
    document.saveas(path)
    return path


def svg(path, body, head='viewBox="0 0 100 100"'):
    text = (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape" {head}>'
    )
    path.write_text(f"{text}\n{body}\n</svg>\n")
    return path


def channel(space, document):
    """A channel of 200 x 100 mm with a half round end, a round hole, a note, and water drawn on a layer of its own."""
    space.add_line((200, 0), (0, 0), dxfattribs={"layer": "floor"})  # against the others' sense
    space.add_arc((200, 50), 50, -90, 90, dxfattribs={"layer": "end"})
    space.add_lwpolyline([(0, 0), (0, 100), (200, 100)], dxfattribs={"layer": "walls"})
    space.add_circle((100, 50), 15, dxfattribs={"layer": "cylinder"})
    space.add_text("channel", dxfattribs={"layer": "walls"})
    space.add_lwpolyline([(0, 0), (200, 0), (200, 40), (0, 40)], close=True, dxfattribs={"layer": "water"})


WALLS = ["floor", "end", "walls", "cylinder"]


def test_a_dxf_file_is_a_tank_and_what_fills_it(tmp_path):
    path = dxf(tmp_path / "channel.dxf", channel)
    shape = tp.read_drawing(path, WALLS)
    assert sorted(shape.sides) == sorted(WALLS)
    assert shape.area == pytest.approx(0.02 + math.pi * (0.05**2 / 2 - 0.015**2), rel=1e-12)
    np.testing.assert_allclose(shape.box, [[0, 0], [0.25, 0.1]], atol=1e-15)
    assert tp.read_drawing(path, WALLS, scale=1.0).area == pytest.approx(1e6 * shape.area)
    water, air = tp.Fluid("water", 998.2, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)
    tank = tp.tank(shape=shape, spacing=0.008).fill(air).fill(water, shape=tp.read_drawing(path, "water"))
    case = tp.Case(tank.wall("floor", slip=True).wall("cylinder", velocity=0.1), [water, air], (0, -9.81))
    sim = tp.Simulation(case)
    sim.step()
    assert sim.volume("water") == pytest.approx(0.2 * 0.04 - half_below(0.01, 0.015), rel=0.03)


def half_below(offset, radius):
    """Area of a disc beyond a chord [m^2]."""
    return radius**2 * math.acos(offset / radius) - offset * math.sqrt(radius**2 - offset**2)


def test_blocks_bulges_mirrored_arcs_and_units(tmp_path):
    def draw(space, document):
        block = document.blocks.new("half")
        block.add_lwpolyline([(0, 0, 0), (2, 0, 1), (2, 2, 0), (0, 2, 0)], format="xyb")  # with layer 0
        space.add_blockref("half", (1, 1), dxfattribs={"layer": "walls", "xscale": 0.5, "yscale": 0.5})
        space.add_arc((-1, 1.5), 0.5, -90, 90, dxfattribs={"layer": "left", "extrusion": (0, 0, -1)})

    shape = tp.read_drawing(dxf(tmp_path / "a.dxf", draw, units=5))
    assert sorted(shape.sides) == ["left", "walls"]
    assert shape.area == pytest.approx(1e-4 * (1 + math.pi / 4), rel=1e-12)
    np.testing.assert_allclose(shape.box, 0.01 * np.array([[0.5, 1], [2.5, 2]]), atol=1e-15)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4])
def test_ellipses_and_splines_keep_to_the_tolerance(tmp_path, tolerance):
    def draw(space, document):
        space.add_ellipse((0, 0), (2, 0), 0.5, dxfattribs={"layer": "wall"})
        space.add_spline([(-0.5, 0), (0, 0.3), (0.5, 0), (0, -0.3), (-0.5, 0)], dxfattribs={"layer": "hole"})

    shape = tp.read_drawing(dxf(tmp_path / "a.dxf", draw, units=6), tolerance=tolerance)
    x = np.array([0.5 * (p.start + p.end) for p in shape.loops[0]])
    assert np.abs(np.hypot(x[:, 0] / 2, x[:, 1]) - 1).max() < 1.1 * tolerance
    assert [{p.name for p in loop} for loop in shape.loops] == [{"wall"}, {"hole"}]


def test_a_svg_file_has_y_upwards_and_keeps_its_arcs(tmp_path):
    body = """<g id="layer1" inkscape:label="tank" transform="translate(10,10)">
      <path id="wall" d="M 0 0 L 40 0 A 10 10 0 0 1 40 20 L 0 20 Z"/>
      <circle id="hole" cx="20" cy="10" r="3"/></g>
      <path id="wave" d="M 100 0 C 120 40 140 -40 160 0 L 160 50 L 100 50 Z"/>"""
    path = svg(tmp_path / "a.svg", body)
    shape = tp.read_drawing(path, ["tank"], scale=1e-3)
    assert sorted(shape.sides) == ["hole", "wall"]
    assert shape.area == pytest.approx(1e-6 * (800 + math.pi * (50 - 9)), rel=1e-9)
    np.testing.assert_allclose(shape.box, 1e-3 * np.array([[10, -30], [60, -10]]), atol=1e-12)
    assert {piece.centre is None for piece in shape.pieces if piece.name == "hole"} == {False}
    wave = tp.read_drawing(path, ["wave"], scale=1e-3, tolerance=1e-5)
    assert wave.area == pytest.approx(60e-3 * 50e-3, rel=1e-3)  # as much above as below, by symmetry
    assert len(wave.pieces) > 10


def lines(*corners, layer="walls"):
    where = {"layer": layer}
    return lambda space, document: [space.add_line(*ends, dxfattribs=where) for ends in itertools.pairwise(corners)]


SQUARE = (0, 0), (1, 0), (1, 1), (0, 1), (0, 0)


@pytest.mark.parametrize(
    ("draw", "options", "message"),
    [
        (lines((0, 0), (1, 0), (1, 1), (0, 1), (0, 0.01)), {}, r"LINE \w+ on layer 'walls' ends at .* 0.01 m off"),
        (lines(*SQUARE, (0.5, -1)), {}, r"3 lines meet at \[0, 0\] m, of LINE \w+ on layer 'walls' and LINE"),
        (lines(*SQUARE), {"units": 0}, r"no unit \(\$INSUNITS is 0\); give scale"),
        (lines(*SQUARE, (0, 0), (1, 1)), {}, r"lines meet at \[0, 0\]"),
        (lambda s, d: s.add_text("a"), {}, "there are no lines in its model space"),
        (lambda s, d: s.add_3dface([(0, 0), (1, 0), (1, 1)]), {}, r"3DFACE \w+ on layer '0' is no line"),
        (lambda s, d: s.add_circle((0, 0), 1, dxfattribs={"extrusion": (1, 0, 0)}), {}, "not in the plane"),
        (lambda s, d: s.add_line((0, 0, 0), (1, 0, 1)), {}, "not in a plane of constant z"),
        (lambda s, d: [s.add_circle((3 * k, 0), 1 + k / 9) for k in range(2)], {}, "is not inside the outline"),
    ],
)  # fmt: skip
def test_what_is_no_outline_is_refused_with_its_place(tmp_path, draw, options, message):
    with pytest.raises(ValueError, match=message) as caught:
        tp.read_drawing(dxf(tmp_path / "a.dxf", draw, **{"units": 6, **options}))
    assert "a.dxf" in str(caught.value)


def test_a_drawing_in_utm_coordinates_is_no_tank(tmp_path):
    far = tp.read_drawing(dxf(tmp_path / "a.dxf", lines(*((x + 5e5, y + 4e6) for x, y in SQUARE)), units=6))
    with pytest.raises(
        ValueError, match=r"tank: it is 4e\+06 m from the origin and 1 m wide .* by \[-500000, -4e\+06\] m"
    ):
        tp.tank(shape=far, spacing=0.1)


def test_files_and_arguments_that_cannot_be_used_are_named(tmp_path):
    path = dxf(tmp_path / "a.dxf", channel)
    drawn = svg(tmp_path / "a.svg", '<path id="a" d="M0 0 L1 0 L1 1"/>')
    (tmp_path / "bad.dxf").write_text("no drawing")
    (tmp_path / "bad.svg").write_text("<svg")
    clone = svg(tmp_path / "clone.svg", '<path id="a" d="M0 0 L1 0 L1 1 Z"/><use href="#a"/>')
    for call, message in [
        (lambda: tp.read_drawing(path, ["wals"]), "no layer 'wals' with lines; it has 'floor', 'end', 'walls'"),
        (lambda: tp.read_drawing(path, scale=-1), "scale is -1; it must be a number > 0"),
        (lambda: tp.read_drawing(path, scale=1.0, tolerance="a"), "tolerance is 'a'"),
        (lambda: tp.read_drawing(tmp_path / "none.dxf"), "there is no such file"),
        (lambda: tp.read_drawing(tmp_path / "a.step"), "must be a file .dxf or .svg"),
        (lambda: tp.read_drawing(tmp_path / "bad.dxf"), "ezdxf cannot read it"),
        (lambda: tp.read_drawing(tmp_path / "bad.svg", scale=1), "svgpathtools cannot read it"),
        (lambda: tp.read_drawing(drawn), "give scale, the length of one unit"),
        (lambda: tp.read_drawing(drawn, scale=1), r"path 'a' ends at \[0, 0\] m, 1 m off"),
        (lambda: tp.read_drawing(drawn, ["b"], scale=1), "no element, group or layer 'b' with lines; it has 'a'"),
        (lambda: tp.read_drawing(clone, scale=1), "it has clones"),
    ]:
        with pytest.raises(ValueError, match=message):
            call()
