"""Several stored times of a run in one picture."""

from __future__ import annotations

import json
import re

import imageio.v3 as iio
import meshio
import numpy as np
import pytest
from render_results import SIDE, write_results
from tipfem.render import cli, strips
from tipfem.render.colours import DARK, LIQUIDS, colour_table, rgb
from tipfem.render.scales import FieldSample, fitting
from tipfem.render.vector import draw_vectors

from tipfem import render

WATER = np.rint(255 * rgb(LIQUIDS[0])).astype(int)


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """A results folder of five times."""
    return write_results(tmp_path_factory.mktemp("strip") / "run", times=(0.0, 0.05, 0.1, 0.15, 0.2))


def blue(image):
    """Mask (H, W) of the water's colour."""
    return (np.abs(image.astype(int) - WATER) <= 4).all(axis=-1)


def test_every_time_has_its_tank_and_its_label(out, tmp_path):
    """Three tanks in a row: as much water in each, a label above each, the water's swatch below them."""
    path = render.strip(
        out, [0.0, 0.1, 0.2], tmp_path / "new" / "row.png", width=1200, backend="raster", view=render.View(look="flat")
    )
    assert path == tmp_path / "new" / "row.png"
    image = iio.imread(path)
    assert image.shape[1] == 1200
    amount = [int(blue(image[:400, k * 400 : (k + 1) * 400]).sum()) for k in range(3)]
    assert min(amount) > 0.3 * 400 * 350
    assert max(amount) - min(amount) < 0.1 * max(amount)
    for k in range(3):
        label = image[:26, k * 400 + 130 : k * 400 + 270]
        assert (label.min(axis=-1) < 120).sum() > 100
    assert blue(image[-50:]).sum() > 200  # the swatch


def test_rows_are_even(out, tmp_path):
    """Five tanks stand in rows of three and two, four in one row; a number of columns may be said."""
    shape = {}
    for name, times, columns in (("five", (0, 0.05, 0.1, 0.15, 0.2), None), ("one", (0.0, 0.2), 1)):
        path = render.strip(out, times, tmp_path / f"{name}.png", columns=columns, backend="raster")
        shape[name] = iio.imread(path).shape
    assert shape["five"][1] == 1600 // 3 // 2 * 2 * 3
    assert shape["five"][0] == pytest.approx(2 * shape["five"][1] / 3, rel=0.25)
    assert shape["one"][0] > 3000


def test_the_closest_stored_times_are_shown_once():
    """Asked for twice, or a little beyond the end, a time still stands once."""
    assert strips.closest([0.0, 0.1, 0.2], [0.02, 0.0, 0.12, 0.25]) == [0, 1, 2]
    assert strips.closest([0.0, 0.1, 0.2], 0.0) == [0]
    with pytest.raises(ValueError, match=r"5 s is not among the stored times, from 0 to 0\.2 s"):
        strips.closest([0.0, 0.1, 0.2], [0.1, 5.0])
    with pytest.raises(ValueError, match="times of a strip"):
        strips.closest([0.0], [float("nan")])
    assert strips.closest(np.arange(10), []) == [0, 3, 6, 9]
    assert strips.closest([0.0], []) == [0]


def test_a_time_that_is_not_stored_is_told():
    assert strips.moved([0.0, 0.1, 0.2], [0.1, 0.13, 0.2 + 1e-9]) == ["0.13 s is not stored; 0.1 s is drawn"]


@pytest.mark.parametrize(
    ("time", "stored", "text"),
    [
        (0.2, (0.0, 0.1, 0.2), "t = 0.2 s"),
        (0.24, (0.0, 0.004, 0.24), "t = 0.240 s"),
        (40.75, (0.0, 0.25, 40.75), "t = 40.75 s"),
        (10.0, (0.0, 5.0, 10.0), "t = 10.0 s"),
        (1.0, (1.0,), "t = 1.000 s"),
        (0.0012, (0.0, 1.5e-4, 0.0012), "t = 1.20 ms"),
        (0.5, (0.0, 1.0 / 3.0, 0.5), "t = 0.500 s"),
    ],
)
def test_labels_tell_times_apart(time, stored, text):
    """One digit or more, as many as the shortest distance needs."""
    assert strips.label(time, stored) == text


def test_bad_sizes_are_refused(out):
    """What would leave tanks too small or too large names the way out."""
    with pytest.raises(ValueError, match="larger width or fewer columns"):
        render.strip(out, [0.0, 0.1, 0.2], width=600, columns=3)
    with pytest.raises(ValueError, match="columns is 0"):
        render.strip(out, [0.0], columns=0)


def test_the_command_draws_it_alone(out, capsys):
    """--strip with neither frames nor movie leaves strip.png and nothing else."""
    assert cli.main([str(out), "--strip", "0", "0.2", "--no-frames", "--no-movie", "--backend", "raster"]) == 0
    assert capsys.readouterr().out.strip() == str(out / "strip.png")
    assert iio.imread(out / "strip.png").std() > 5
    assert not (out / "frames").exists()


def test_it_shows_what_pictures_show_and_is_named_after_it(out, capsys):
    """A field with its bar, layers and a window, in a file of their own; what a strip cannot show is refused."""
    words = (
        "--strip 0 0.2 --field pressure --mesh --arrows --window 0 0 0.3 0.2 --no-frames --no-movie --backend raster"
    )
    assert cli.main([str(out), *words.split()]) == 0
    path = out / "strip_pressure_mesh_arrows_window_0_0_0.3_0.2.png"
    assert capsys.readouterr().out.strip() == str(path)
    image, fluids = iio.imread(path), iio.imread(render.strip(out, [0.0, 0.2], backend="raster"))
    assert image.shape[0] != fluids.shape[0]  # lower tanks, and the colour bar below them
    table = np.rint(255 * colour_table("viridis")).astype(int)
    shades = image[-130:].reshape(-1, 3)  # the bar has the whole table
    assert all((np.abs(shades - shade).max(axis=1) <= 2).any() for shade in table[::16])
    assert render.strip(out, [0.0], name="mine", backend="raster").name == "strip_mine.png"
    for options, message in (
        ({"field_range": (0, 1)}, "no field to colour by"),
        ({"field": "salt"}, "field 'salt' is not in the results"),
    ):
        with pytest.raises(ValueError, match=message):
            render.strip(out, [0.0], backend="raster", **options)


def test_tracers_are_followed_through_all_stored_times(out, tmp_path):
    """Whichever times are drawn."""

    def drawn(first, tracers):
        options = {"width": 800, "view": render.View(tracers=tracers), "backend": "raster"}
        return iio.imread(render.strip(out, [first, 0.2], tmp_path / "strip.png", **options))[:-60]

    one, other, plain = drawn(0.0, 40), drawn(0.1, 40), drawn(0.0, 0)
    height = min(len(one), len(plain))
    assert np.array_equal(one[:height, 400:], other[:height, 400:])
    assert not np.array_equal(one[:, :400], other[:, :400])
    assert (one[:height, 400:] != plain[:height, 400:]).any(axis=2).mean() > 0.005


def test_all_times_have_one_scale(out, tmp_path):
    """Each time looks as it does alone at the range of both."""
    both = iio.imread(render.strip(out, [0.0, 0.2], tmp_path / "both.png", width=800, field="speed", backend="raster"))
    options = dict(width=400, field="speed", field_range=range_of(out), backend="raster")
    alone = [iio.imread(render.strip(out, [time], tmp_path / "one.png", **options)) for time in (0.0, 0.2)]
    tank = alone[0].shape[0] - 120
    assert not np.array_equal(alone[0][:tank], alone[1][:tank])
    for k, image in enumerate(alone):
        assert np.array_equal(both[:tank, k * 400 : (k + 1) * 400], image[:tank])


def range_of(out):
    """The range of the speeds at all times, as movies have it."""
    results = render.Results(out)
    return FieldSample([results.scene(k) for k in range(len(results))], "speed").limits()


def test_the_command_chooses_times_columns_and_the_ground(out, capsys):
    """Without times four are drawn; light text on dark; what is around the tanks is left out."""
    words = "--no-frames --backend raster --width 900 --columns 2 --strip"
    assert cli.main([str(out), *words.split(), "0.13", "0.2", "--dark", "--no-movie"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said == ["0.13 s is not stored; 0.15 s is drawn", str(out / "strip_dark.png")]
    dark = iio.imread(out / "strip_dark.png")
    assert dark.shape[1] == 900
    assert (dark[0, 0] == np.rint(255 * np.array(DARK.background))).all()
    assert cli.main([str(out), *words.split(), "--transparent"]) == 0
    capsys.readouterr()
    clear = iio.imread(out / "strip_transparent.png").astype(float)
    assert clear[0, 0, 3] == 0
    assert clear[200, 200, 3] == 255
    plain = iio.imread(render.strip(out, [], columns=2, width=900, backend="raster"))
    assert abs(clear[..., :3] * clear[..., 3:] / 255 + 255 - clear[..., 3:] - plain).max() <= 2  # on white
    for wrong, says in (
        ("--columns 2", "--columns needs --strip"),
        ("--transparent --movie a.mp4", "a.mp4: movies have a background"),
        ("--strip --svg --width 500", "as wide as a page"),
    ):
        assert cli.main([str(out), *wrong.split()]) == 2
        assert says in capsys.readouterr().err


def test_frames_are_dark_or_without_a_ground(out):
    scene = render.Results(out).scene(0)
    with render.Renderer((480, 320), "raster", dark=True) as renderer:
        image = renderer.frame(scene)
        assert (image[0, 0] == np.rint(255 * np.array(DARK.background))).all()
        assert (image > 200).all(axis=2).any()  # the text
    with render.Renderer((480, 320), "raster", transparent=True) as renderer:
        assert renderer.frame(scene)[0, 0].tolist() == [0, 0, 0, 0]


@pytest.mark.parametrize(
    ("size", "count", "columns"),
    [((0.5, 0.5), 4, 4), ((1.5, 0.7), 4, 2), ((6.0, 1.6), 4, 2), ((0.5, 0.5), 5, 3), ((20.0, 1.0), 3, 1)],
)
def test_flat_tanks_have_fewer_columns(size, count, columns):
    """Tanks of 6 m x 1.6 m, of which four in a row would be 153 pixels high, stand in twos."""
    assert strips.usual_columns(count, 1600, (0, 0), size) == columns


def test_the_flattest_tank_is_drawn(tmp_path):
    """A tank 40 times as long as it is high has room below it."""
    out = write_results(tmp_path / "run", times=(0.0, 0.05))
    view = render.View(window=(0.0, 0.24, 0.5, 0.2525))
    image = iio.imread(render.strip(out, [0.0, 0.05], view=view, backend="raster"))
    assert image.shape[0] >= 2 * 240


def test_a_long_legend_stands_in_rows_that_fit():
    entries = [(name, np.zeros(3)) for name in ("water", "glycerin and water", "the air above both of them", "oil")]
    rows = strips._legend_rows(entries, 2.0, 900)
    assert [[entry[0] for entry, _ in row] for row in rows] == [
        ["water", "glycerin and water"],
        ["the air above both of them", "oil"],
    ]
    for row in rows:
        assert sum(length for _, length in row) + 2.0 * strips._GAP * (len(row) - 1) < 900


def test_a_single_time_is_a_picture_and_no_poster(out, tmp_path):
    """Half as wide as a strip of several, unless a width is given."""
    alone = iio.imread(render.strip(out, 0.1, tmp_path / "one.png", backend="raster"))
    assert alone.shape[1] == 800
    assert alone.shape[0] < 1000
    assert iio.imread(render.strip(out, [0.0, 0.1], tmp_path / "two.png", backend="raster")).shape[1] == 1600
    wide = iio.imread(render.strip(out, 0.1, tmp_path / "wide.png", backend="raster", width=1200))
    assert wide.shape[1] == 1200


@pytest.mark.parametrize(
    ("size", "shown"), [(0.024, (1e3, "mm")), (0.1, (1.0, "m")), (3.0, (1.0, "m")), (5e-5, (1e6, "\u00b5m"))]
)
def test_lengths_have_a_unit_that_fits(size, shown):
    """As on pages, see `fitting` in page/plots.js."""
    assert fitting(size) == shown


def test_a_small_tank_has_its_axes_in_millimetres(tmp_path):
    """Of a tank of 5 mm: labels of pictures as vectors, which are text."""
    out = write_results(tmp_path / "small", times=(0.0,))
    case = json.loads((out / "case.json").read_text())
    for name in (out / "fields").glob("*.vtu"):
        mesh = meshio.read(name)
        mesh.points *= 0.01
        mesh.write(name)
    case |= {"upper": [0.01 * SIDE, 0.01 * SIDE], "spacing": 0.01 * case["spacing"]}
    (out / "case.json").write_text(json.dumps(case))
    (svg,) = draw_vectors(out, None, [".svg"])
    words = re.findall(r">([^<>]+)</text>", svg.read_text())
    assert {"x [mm]", "y [mm]", "5"} <= set(words)
    assert not any("[m]" in word for word in words)
