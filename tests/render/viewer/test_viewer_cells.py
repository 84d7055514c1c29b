"""The cells that pages draw by themselves: what they are sent is the scene's, and what they draw the viewer's."""

from __future__ import annotations

import re
import zlib

import numpy as np
import pytest
from render_results import SIDE, write_results
from shown_page import ShownPage
from tipfem.render import Results, Scene
from tipfem.render.viewer.choices import Choices
from tipfem.render.viewer.packing import from_lowest, packed_cells
from tipfem.render.viewer.pane import Pane
from tipfem.render.viewer.probe import values_at
from tipfem.render.viewer.source import ResultsSource

HIDE = "WebGL2RenderingContext.prototype.getExtension = () => null"


def unpacked(head, data):
    """Positions, values, particles in no cell, cells and their groups, read as the page does."""
    counts, nodes, start = [count for count, _ in head["parts"]], head["nodes"], 4 * head["loose"]
    loose = np.frombuffer(data[:start], "<u4")

    def moves(length, size):
        nonlocal start
        raw = np.frombuffer(data, np.uint8, size * length, start).reshape(size, length).T.copy()
        start += size * length
        folded = raw.view(f"<u{size}")[:, 0].astype(np.int64)
        return (folded >> 1) ^ -(folded & 1)

    if head["step"] is None:
        places = np.frombuffer(data, "<f4", 2 * nodes, start).reshape(-1, 2)
        start += 8 * nodes
    else:
        places = np.stack([np.cumsum(moves(nodes, 2)) % 2**16 for _ in range(2)], axis=1) * np.array(head["step"])
    size = 4 if head["wide"] else 2
    first, *others = (moves(sum(counts), size) for _ in range(3))
    first = np.cumsum(first)
    cells = np.stack([first, *(first + other for other in others)], axis=1) % 2 ** (8 * size)
    levels = np.cumsum(moves((len(data) - start) // 2, 2)) % 2**16
    groups = np.repeat([fluid for _, fluid in head["parts"]], counts)
    return places + np.array(head["origin"]), head["low"] + head["span"] / 65_535 * levels, loose, cells, groups


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Results whose cells have fluids."""
    return write_results(tmp_path_factory.mktemp("cells") / "wave", sharp=True)


@pytest.mark.parametrize("field", ["speed", "density", None])
def test_the_bytes_are_those_of_the_scene(folder, field):
    scene = Results(folder).scene(1)
    plain = scene.position[scene.cells].mean(axis=1)[:, 0] < SIDE / 3
    at, values, loose, cells, groups = unpacked(*packed_cells(scene, field, plain))
    assert at == pytest.approx(scene.position, abs=0.01 * scene.spacing)
    assert loose.tolist() == np.flatnonzero(scene.geometry.surroundings.spray).tolist()
    order, own = np.lexsort(cells.T), from_lowest(scene.cells)
    theirs = np.lexsort(own.T)
    assert (cells[order] == own[theirs]).all()
    assert (groups[order] == np.where(plain, scene.cell_fluid, -1)[theirs]).all()
    if field == "density":
        assert values[order] == pytest.approx(scene.cell_fields["density"][theirs], abs=0.02)
    else:
        speed = scene.fields["speed"]
        assert values == pytest.approx(speed if field else np.empty(0), abs=1e-5 * speed.max())


def test_places_are_exact_in_a_tank_of_many_spacings():
    """Of 10 km: as floats, for 16 bits would be coarser than the particles."""
    position = np.array([[0.0, 0.0], [1e4, 0.0], [0.0, 1e4], [0.37, 0.21]])
    cells = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]])
    scene = Scene(position=position, cells=cells, fluid=np.zeros(4, int), spacing=0.5)
    at, *_ = unpacked(*packed_cells(scene, None, np.ones(3, bool)))
    assert at == pytest.approx(position, rel=1e-6)


@pytest.mark.slow(but=("50",))
@pytest.mark.parametrize("nodes", [50, 300])
def test_a_state_with_a_field_takes_a_third_on_its_way(nodes):
    """Of a jittered lattice, also of more nodes than two bytes count; 18 and 33 bytes a node as they are in memory."""
    x, y = np.meshgrid(np.arange(nodes), np.arange(nodes))
    position = np.stack([x.ravel(), y.ravel()], axis=1) + np.random.default_rng(2).uniform(-0.3, 0.3, (nodes**2, 2))
    corner = (np.arange(nodes - 1)[:, None] * nodes + np.arange(nodes - 1)).ravel()
    below = np.stack([corner, corner + 1, corner + nodes], axis=1)
    above = np.stack([corner + 1, corner + nodes + 1, corner + nodes], axis=1)
    cells = np.random.default_rng(3).permutation(np.concatenate([below, above]))
    scene = Scene(
        position=position, cells=cells, fluid=np.zeros(nodes**2, int), spacing=1.0, fields={"speed": position[:, 0]}
    )
    head, data = packed_cells(scene, "speed", np.zeros(len(cells), bool))
    at, values, _, read, _ = unpacked(head, data)
    assert {tuple(cell) for cell in read} == {tuple(cell) for cell in from_lowest(cells)}
    assert at == pytest.approx(position, abs=0.01)
    assert values == pytest.approx(position[:, 0], abs=0.01)
    assert head["wide"] == (nodes == 300)
    assert len(zlib.compress(data, 1)) < (6.5 if nodes == 50 else 9) * nodes**2


def test_pages_draw_what_they_can_and_are_told_which_fluid_keeps_its_colour(folder):
    pane, choices = Pane(ResultsSource(folder), "raster"), Choices((0.0, 0.0), (SIDE, SIDE))
    assert "cells" not in pane.vectors(0, choices)[0]
    choices.layers["mesh"] = True
    entry, data = pane.vectors(0, choices)
    assert [fluid for _, fluid in entry["cells"]["parts"]] == [0, 1]
    assert entry["bytes"] == len(data) > entry["cells"]["bytes"]
    choices.field = "pressure"
    entry, _ = pane.vectors(0, choices)
    assert [fluid for _, fluid in entry["cells"]["parts"]] == [-1, *map(pane.source.fluid_names.index, entry["muted"])]
    choices.layers["fill"] = False
    entry, _ = pane.vectors(0, choices)
    assert [fluid for _, fluid in entry["cells"]["parts"]] == [0, 1]
    assert entry["fade"] == 1


def test_layers_are_sent_as_lines(folder):
    """Contours lie where the field has their values; particles are all there, those of the interface in its colour."""
    pane, choices = Pane(ResultsSource(folder), "raster"), Choices((0.0, 0.0), (SIDE, SIDE))
    choices.layers |= {"contours": "pressure", "particles": True, "streamlines": True, "tracers": 20}
    while pane.tracing(0, choices) is not None:
        pass
    entry, data = pane.vectors(0, choices)
    head, at, found = entry["lines"], 0, {}
    for sort in head["sorts"]:
        count = sum(sort["points"]) if "points" in sort else sort["count"] * sort["each"]
        points = np.frombuffer(data, "<f4", 2 * count, at).reshape(-1, 2) + np.array(head["origin"])
        found.setdefault(sort["kind"], []).append((sort["line"], points))
        at += 8 * count
    assert at == head["bytes"]
    assert list(found) == ["particles", "contours", "streamlines", "tracers"]
    scene = Results(folder).scene(0)
    assert sum(len(points) for _, points in found["particles"]) == len(scene.position)
    assert [colour for colour, _ in found["particles"]][-1] == "#061528"
    interface = {tuple(point) for point in scene.geometry.regions.segments.reshape(-1, 2).round(5)}
    assert {tuple(point) for point in found["particles"][-1][1].round(5)} == interface
    interval = float(re.search(r"pressure, every (\S+) Pa", entry["notes"][0])[1])
    values = [values_at(scene, tuple(point))[0]["pressure"] for point in found["contours"][0][1]]
    assert len(values) > 100
    assert np.array(values) / interval == pytest.approx(np.round(np.array(values) / interval), abs=1e-3)


@pytest.mark.slow
def test_a_field_looks_alike_with_and_without_webgl_and_zooms_without_the_viewer(browser, server):
    places = [(x, y) for x in (0.06, 0.17, 0.31, 0.43) for y in (0.03, 0.05, 0.38, 0.47)]
    shown = ShownPage(browser, server.address, (SIDE, SIDE))
    shown.wait(shown.button("play").is_enabled, "the page to steer")
    shown.part("field").select_option("velocity_x")
    shown.read("legend", "velocity x")
    shown.wait(lambda: shown.page.locator(".pane .cells").is_visible(), "the cells")
    shown.page.wait_for_timeout(500)
    frame, own = shown.frame, np.array([shown.colour(*place) for place in places])
    assert np.ptp(own, axis=0).max() > 100  # blue and red
    shown.page.mouse.move(*shown.point(*places[-1]))
    shown.page.mouse.wheel(0, -2000)
    shown.page.wait_for_timeout(300)
    assert abs(shown.colour(*places[0]) - own[0]).max() > 40
    assert abs(shown.colour(*places[-1]) - own[-1]).max() < 8  # where the pointer is
    assert shown.frame == frame
    shown.key("0")
    # The page is not told that the browser's card is emulated, so that it uses it.
    other = ShownPage(browser, server.address, (SIDE, SIDE), before=HIDE)
    other.wait(lambda: other.page.locator(".pane .cells").is_visible(), "the cells")
    other.wait(
        lambda: all(abs(other.colour(*place) - one).max() < 8 for place, one in zip(places, own, strict=True)),
        "the same colours",
    )
    other.close()
    shown.part("field").select_option("")
    shown.close()
