"""Fields: declared in one place, from which files, pictures and pages take all of their facts."""

from __future__ import annotations

import numpy as np
from render_results import write_results
from tipfem.render import Results
from tipfem.render.scales import colour_map_of, round_limits
from tipfem.render.viewer.pane import Pane
from tipfem.render.viewer.source import ResultsSource

from tipfem.results.fields.catalogue import FIELDS, STORED, Field, field_of


def test_a_field_that_is_declared_is_drawn_everywhere(tmp_path, monkeypatch):
    """By its declaration alone: values, place in the menu, label, unit, colours and their range."""
    head = Field(
        "head", "static head", "m", of=lambda flow: -flow.data["pressure"] / 9810, needs="pressure", scale="signed"
    )
    monkeypatch.setitem(FIELDS, "head", head)
    out = write_results(tmp_path / "out")
    scene = Results(out).scene(1)
    np.testing.assert_array_equal(scene.fields["head"], -scene.fields["pressure"] / 9810)
    assert Pane(ResultsSource(out), "raster").fields()[-1] == "head"
    assert field_of("head").title == "static head [m]"
    assert colour_map_of("head") == "blue-red"
    assert round_limits("head", -1.0, 4.0) == (-4.0, 4.0)


def test_fields_of_other_programs_have_a_label_and_no_unit():
    assert field_of("wall_distance").title == "wall distance"
    assert colour_map_of("wall_distance") == "viridis"


def test_what_is_written_is_read_back():
    values = {"vector": np.arange(6.0).reshape(3, 2), "real": np.array([1.0, 2.0, 3.0]), "number": np.array([0, 2, 1])}
    for name, stored in STORED.items():
        data = values["vector" if stored.vector else "number" if stored.file else "real"].astype(stored.memory)
        for real in ("f8", "f4"):
            written = stored.written(data, real)
            assert written.dtype == (stored.file or real), name
            assert written.shape == ((3, 3) if stored.vector else (3,)), name
            np.testing.assert_array_equal(stored.read(written, 2), data)
