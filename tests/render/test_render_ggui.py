"""GGUI offscreen, for real; and what happens without a Vulkan driver."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from render_results import SIDE, sharp_tank, tank, write_results
from tipfem.render import Renderer, Scene, render_frame
from tipfem.render.annotation import panel_width
from tipfem.render.colours import fluid_colours
from tipfem.render.layout import make_layout

SIZE = (640, 480)


@pytest.fixture(scope="module")
def driver():
    """Skip without a Vulkan driver, unless one is demanded: then the test fails."""
    try:
        Renderer(SIZE, "ggui").close()
    except RuntimeError as error:
        if os.environ.get("TIPFEM_REQUIRE_VULKAN") == "1":
            raise
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def scene():
    points, cells, fluid, wall = tank(0.0)
    return Scene(
        position=points,
        cells=cells,
        fluid=fluid,
        wall=wall,
        fluid_names=("water", "air"),
        fields={"pressure": 1000 * points[:, 1]},
        lower=(0, 0),
        upper=(SIDE, SIDE),
        title="GGUI",
    )


@pytest.mark.vulkan
@pytest.mark.usefixtures("driver")
def test_pixels_inside_a_fluid_have_its_colour(scene):
    image = render_frame(scene, SIZE, backend="ggui").astype(float)
    layout = make_layout(SIZE, scene.lower, scene.upper, True, panel_width(scene, None))
    fills = 255 * fluid_colours(scene.fluid_names)
    # Points further from the water surface than a cell is wide.
    for fluid, heights in ((0, np.linspace(0.02, 0.15, 9)), (1, np.linspace(0.35, 0.48, 9))):
        for x in np.linspace(0.02, SIDE - 0.02, 9):
            columns, rows = layout.pixels(np.column_stack([np.full(9, x), heights])).astype(int).T
            assert np.abs(image[rows, columns] - fills[fluid]).max() <= 3


@pytest.mark.vulkan
@pytest.mark.usefixtures("driver")
@pytest.mark.parametrize("sharp", [False, True], ids=["cut", "sharp"])
@pytest.mark.parametrize(
    "options", [{}, {"field": "pressure"}, {"mesh": True, "particles": True}], ids=["fluids", "field", "mesh"]
)
def test_both_back_ends_draw_the_same_picture(scene, options, sharp):
    if sharp:
        _, _, fluid, cell_fluid, _ = sharp_tank(0.0)
        scene = replace(scene, fluid=fluid, cell_fluid=cell_fluid)
    pictures = [render_frame(scene, SIZE, backend=name, **options).astype(int) for name in ("ggui", "raster")]
    different = np.abs(pictures[0] - pictures[1]).max(axis=2)
    assert (different > 10).mean() < 0.005


@pytest.mark.vulkan
@pytest.mark.usefixtures("driver")
def test_windows_of_two_sizes_in_turn_and_more_triangles(scene, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with Renderer(SIZE, "ggui") as one, Renderer((400, 300), "ggui") as two:
        first = one.frame(scene)
        assert two.frame(scene).shape == (300, 400, 3)
        assert (one.frame(scene) == first).all()
        one.frame(scene, mesh=True, particles=True)
        assert (one.frame(scene) == first).all()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_without_a_driver(tmp_path):
    out = write_results(tmp_path / "out")
    hidden = os.environ | {"VK_DRIVER_FILES": "/none.json", "VK_ICD_FILENAMES": "/none.json"}
    line = [sys.executable, "-m", "tipfem.render", str(out), "--size", "400x300", "--backend"]
    run = dict(capture_output=True, text=True, timeout=120, env=hidden)
    done = subprocess.run([*line, "auto"], **run)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert "drawn with raster" in done.stdout
    done = subprocess.run([*line, "ggui"], **run)
    assert done.returncode == 2
    assert done.stderr.startswith("error: backend 'ggui' needs a Vulkan driver")
    assert done.stderr.count("\n") == 1
