"""Openings in pictures: gaps in walls, arrows, legend, and case.json."""

from __future__ import annotations

import json

import numpy as np
from tipfem.render import Results, View, render_frame
from tipfem.render.layers import layer_texts
from tipfem.render.layout import make_layout
from tipfem.render.openings import COLOURS, Gap, on_both_sides
from tipfem.render.renderer import contents
from tipfem.render.vector import draw_vectors
from tipfem.render.viewer.share import share

import tipfem as tp
from tipfem.run.liveview.control import describe, snapshot_of
from tipfem.run.liveview.memory import StateMemory
from tipfem.run.liveview.source import LiveSource

SIZE = (640, 480)


def test_openings_are_gaps_in_walls_with_arrows_and_a_legend(tmp_path):
    water, air = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)
    tank = tp.tank((0.4, 0.3), 0.02).fill(air).fill(water, box=((0, 0), (0.4, 0.1)))
    openings = [
        tp.Inlet(wall="left", between=((0, 0), (0, 0.08)), fluid=water, discharge=0.01),
        tp.Vent(wall="top", between=((0.1, 0.3), (0.3, 0.3))),
    ]
    case = tp.Case(tank, [water, air], (0, -9.81), openings=openings)
    tp.Simulation(case, tmp_path, time_step=2e-3, output_interval=2e-3).run(2e-3, progress=False)
    facts = json.loads((tmp_path / "case.json").read_text())["openings"]
    assert [(one["name"], one["kind"]) for one in facts] == [("inlet_left", "inlet"), ("vent_top", "vent")]
    np.testing.assert_allclose(sorted(facts[1]["ends"]), [[0.1, 0.3], [0.3, 0.3]], atol=1e-12)
    np.testing.assert_allclose([one["inwards"] for one in facts], [[1, 0], [0, -1]], atol=1e-12)

    scene = Results(tmp_path).scene(-1)
    assert layer_texts(scene, View(), None)[-2:] == ["inlet", "vent"]
    image = render_frame(scene, SIZE, backend="raster").astype(int)
    layout = make_layout(SIZE, *contents(scene, None, View()))

    def beyond(x, y, out):
        """The picture 4 design pixels outside of a place on a wall."""
        column, row = (layout.pixels([x, y]) + 4 * layout.unit * np.array([out[0], -out[1]])).astype(int)
        return image[row, column]

    assert (beyond(0.05, 0.3, (0, 1)) < 100).all()
    assert (beyond(0.0, 0.2, (-1, 0)) < 100).all()
    gap = [beyond(x, 0.3, (0, 1)) for x in np.linspace(0.11, 0.29, 60)]
    assert sum((colour > 240).all() for colour in gap) > 30
    dark = np.array([int(COLOURS["vent"][k : k + 2], 16) for k in (1, 3, 5)])
    assert any(np.abs(colour - dark).max() < 20 for colour in gap)

    page = share(tmp_path).read_text()
    assert '"marks":{"inlet":"#007a5e","vent":"#5a6675"}' in page
    [vectors] = draw_vectors(tmp_path, None, [".svg"])
    text = vectors.read_text()
    assert text.count("#007a5e") >= 2
    assert text.count("#5a6675") >= 3
    assert all(f"<!-- {word} -->" in text or f">{word}<" in text for word in ("inlet", "vent"))


def test_arrows_follow_what_passes_and_closed_valves_are_walls(tmp_path):
    """By times of the case, and by commands, in results, in shared pages, and on the page of a run."""
    water, air = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)
    tank = tp.tank((0.3, 0.3), 0.02).fill(air).fill(water, box=((0, 0), (0.3, 0.1)))
    openings = [
        tp.Outlet(wall="bottom", between=((0.1, 0), (0.2, 0)), name="drain"),
        tp.Vent(wall="top", between=((0.1, 0.3), (0.2, 0.3)), name="vent"),
        tp.Vent(wall="left", between=((0, 0.2), (0, 0.28)), name="late", open=((0.01, 1.0),)),
    ]
    case = tp.Case(tank, [water, air], (0, -9.81), openings=openings)
    simulation = tp.Simulation(case, tmp_path, time_step=4e-3, output_interval=4e-3)
    source = LiveSource(describe(case, None), Latest(simulation), lambda *_: None)
    seen = []
    for step in range(5):
        if step == 3:
            simulation.steer(tp.Valve("vent", False))
        simulation.run((step + 1) * 4e-3, progress=False)
        source.refresh()
        seen.append({gap.name: gap.enters for gap in source.scene(-1).openings})
    assert seen[1] == {"drain": False, "vent": True}  # air comes in by the vent while water leaves by the drain
    assert seen[4] == {"drain": False, "late": True}
    results = Results(tmp_path)
    assert [{gap.name: gap.enters for gap in results.scene(k).openings} for k in (-4, -1)] == [seen[1], seen[4]]
    [facts] = json.loads(share(tmp_path).read_text().split("const told = ", 1)[1].split(", data = ", 1)[0])
    last = facts["openings"][facts["gaps"][-1]]
    assert [(row[0], row[7]) for row in last] == [("outlet", False), ("vent", True)]
    assert last != facts["openings"][facts["gaps"][2]]


class Latest:
    """What the process that draws has of a run: its latest state."""

    published, ended, paused = 0, False, False

    def __init__(self, simulation):
        self.simulation = simulation

    def latest(self):
        self.published += 1
        memory = StateMemory()
        try:
            memory.publish(snapshot_of(self.simulation, 1.0))
            return memory.latest()
        finally:
            memory.close()


def test_openings_of_a_round_tank_have_images_and_a_disc_is_one():
    up, left = np.array([0.0, 1.0]), np.array([-1.0, 0.0])
    disc = Gap("inlet", np.array([[0.0, 0.0], [0.2, 0.0]]), up)
    ring = Gap("outlet", np.array([[0.5, 0.1], [0.5, 0.3]]), left)
    one, right, image = on_both_sides([disc, ring])
    assert one.ends.tolist() == [[-0.2, 0.0], [0.2, 0.0]]
    assert right is ring
    assert image.ends.tolist() == [[-0.5, 0.3], [-0.5, 0.1]]
    assert image.inwards.tolist() == [1.0, 0.0]
