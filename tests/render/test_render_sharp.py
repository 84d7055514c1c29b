"""Pictures of results in which every cell has its fluid, with the rasteriser."""

import numpy as np
import pytest
from render_results import SIDE, sharp_tank, tank
from scipy.spatial import Delaunay
from tipfem.render import Scene, View, render_frame
from tipfem.render.annotation import panel_width
from tipfem.render.colours import INTERFACE, colour_table, dot_colours, fluid_colours, map_values, mix, rgb, tone
from tipfem.render.drawing import Drawing
from tipfem.render.interface import fluid_regions, particle_fluids
from tipfem.render.layout import make_layout
from tipfem.render.picture import draw_scene
from tipfem.render.scales import FieldSample, muted_fluids
from tipfem.render.view import Look

SIZE = (1280, 720)
COUNT = 16
DENSITIES = np.array([998.2, 1.204])
FILLS = fluid_colours(("water", "air"))


def made_scene(**changes):
    points, cells, fluid, cell_fluid, wall = sharp_tank(0.0, COUNT)
    given = dict(
        position=points,
        cells=cells,
        fluid=fluid,
        cell_fluid=cell_fluid,
        wall=wall,
        fluid_names=("water", "air"),
        lower=(0, 0),
        upper=(SIDE, SIDE),
        spacing=SIDE / COUNT,
        fields={"density": DENSITIES[fluid], "pressure": 1000 * points[:, 1]},
        cell_fields={"density": DENSITIES[cell_fluid]},
    )
    return Scene(**(given | changes))


def layout_of(scene, field=None):
    return make_layout(SIZE, scene.lower, scene.upper, bool(scene.title), panel_width(scene, field))


def away_from_the_interface(scene, layout, clear):
    """Every pixel of the tank whose centre is `clear` px or more from walls and interface: rows, columns, cell."""
    left, top, right, bottom = layout.box
    columns, rows = np.meshgrid(np.arange(left + clear, right - clear), np.arange(top + clear, bottom - clear))
    columns, rows = columns.ravel().astype(int), rows.ravel().astype(int)
    points = np.column_stack([columns, rows]) + 0.5
    regions = fluid_regions(scene.position, scene.cells, scene.fluid, scene.cell_fluid)
    near = np.zeros(len(points), bool)
    for start, end in layout.pixels(regions.segments):
        along = end - start
        share = np.clip((points - start) @ along / (along @ along), 0, 1)
        near |= np.linalg.norm(start + share[:, None] * along - points, axis=1) < clear
    columns, rows, points = columns[~near], rows[~near], points[~near]
    triangulation = Delaunay(scene.position)
    assert (triangulation.simplices == scene.cells).all()
    metres = (points - [left, bottom]) / layout.scale * [1, -1]
    return rows, columns, triangulation.find_simplex(metres)


def test_cells_have_their_colour_up_to_the_interface():
    scene = made_scene()
    rows, columns, cell = away_from_the_interface(scene, layout_of(scene), 2)
    bubble = (scene.fluid[scene.cells] == 0).all(axis=1) & (scene.cell_fluid == 1)
    assert bubble[cell].sum() > 500
    image = render_frame(scene, SIZE, backend="raster")
    expected = np.rint(255 * FILLS[scene.cell_fluid[cell]])
    assert np.abs(image[rows, columns] - expected).max() <= 1


def test_line_is_dark_all_along_the_interface():
    scene = made_scene()
    regions = fluid_regions(scene.position, scene.cells, scene.fluid, scene.cell_fluid)
    start, end = np.moveaxis(layout_of(scene).pixels(regions.segments), 1, 0)
    share = np.linspace(0, 1, 30)[:, None, None]
    columns, rows = ((1 - share) * start + share * end).reshape(-1, 2).astype(int).T
    image = render_frame(scene, SIZE, backend="raster")
    # The line is 1.5 px wide: where its middle crosses the corner of a pixel, a neighbour is covered.
    around = np.arange(-1, 2)
    patches = image[rows[:, None, None] + around[:, None], columns[:, None, None] + around].reshape(-1, 9, 3)
    away = np.abs(patches - 255 * rgb(INTERFACE)).max(axis=2).min(axis=1)
    assert away.max() < 0.35 * 255
    assert np.median(away) < 1


def test_density_jumps_at_the_interface():
    scene = made_scene()
    rows, columns, cell = away_from_the_interface(scene, layout_of(scene, "density"), 3)
    image = render_frame(scene, SIZE, "density", (0, 1000), backend="raster")
    expected = 255 * map_values(scene.cell_fields["density"][cell], 0, 1000, colour_table("viridis"))
    assert np.abs(image[rows, columns] - expected).max() <= 1


def test_other_fields_do_not_depend_on_the_fluid_of_the_cells():
    scene = made_scene()
    rows, columns, _ = away_from_the_interface(scene, layout_of(scene, "pressure"), 3)
    sharp = render_frame(scene, SIZE, "pressure", (0, 500), backend="raster")
    plain = render_frame(
        made_scene(fluid=0 * scene.fluid, cell_fluid=None), SIZE, "pressure", (0, 500), backend="raster"
    )
    assert (sharp[rows, columns] == plain[rows, columns]).all()


def test_dots_on_the_interface_have_its_colour_and_the_others_that_of_their_fluid():
    scene = made_scene(fluid=np.zeros((COUNT + 1) ** 2, int))  # the cells decide
    image = render_frame(scene, SIZE, particles=True, backend="raster")
    inside = ~scene.wall
    columns, rows = layout_of(scene).pixels(scene.position[inside]).astype(int).T
    owner, between = (values[inside] for values in particle_fluids(scene.cells, scene.fluid, scene.cell_fluid))
    expected = np.where(between[:, None], rgb(INTERFACE), dot_colours(FILLS)[owner])
    assert between.any()
    assert np.abs(image[rows, columns] - 255 * expected).max() <= 1


def test_mesh_lines_in_a_bubble_are_those_of_its_fluid():
    scene = made_scene()
    bubble = np.flatnonzero((scene.fluid[scene.cells] == 0).all(axis=1) & (scene.cell_fluid == 1))
    edges = [set(a) & set(b) for a in scene.cells[bubble].tolist() for b in scene.cells[bubble].tolist() if a < b]
    shared = [list(edge) for edge in edges if len(edge) == 2]
    assert shared
    middles = layout_of(scene).pixels(scene.position[shared].mean(axis=1))
    image = render_frame(scene, SIZE, mesh=True, backend="raster").astype(float) / 255
    line, other = tone(FILLS)[1], tone(FILLS)[0]
    for column, row in middles.astype(int):
        # The darkest pixel about the middle is air with some of its own line on it.
        patch = image[row - 1 : row + 2, column - 1 : column + 2].reshape(-1, 3)
        darkest = patch[patch.sum(axis=1).argmin()]
        shares = np.linspace(0, 1, 101)
        to_line = min(np.abs(darkest - mix(FILLS[1], line, share)).max() for share in shares)
        to_other = min(np.abs(darkest - mix(FILLS[1], other, share)).max() for share in shares[30:])
        assert to_line < 0.01 < to_other
        assert np.abs(darkest - FILLS[1]).max() > 0.1


def test_scenes_without_a_fluid_for_the_cells_are_cut_as_before():
    points, cells, fluid, wall = tank(0.0, COUNT)
    scene = Scene(
        position=points,
        cells=cells,
        fluid=fluid,
        wall=wall,
        fluid_names=("water", "air"),
        lower=(0, 0),
        upper=(SIDE, SIDE),
    )
    mixed = np.flatnonzero(np.ptp(fluid[cells], axis=1))
    corners = points[cells[mixed]]
    image = render_frame(scene, SIZE, backend="raster")
    layout = layout_of(scene)
    for k in range(3):  # a quarter of the way from a corner to the centre, a cell has the corner's fluid
        near = 0.75 * corners[:, k] + 0.25 * corners.mean(axis=1)
        inside = (np.abs(near - SIDE / 2) < SIDE / 2 - 0.01).all(axis=1)
        columns, rows = layout.pixels(near[inside]).astype(int).T
        expected = 255 * FILLS[fluid[cells[mixed[inside], k]]]
        assert np.abs(image[rows, columns] - expected).max() <= 1


def test_values_of_the_cells():
    scene = made_scene()
    assert (scene.cell_values("density") == DENSITIES[scene.cell_fluid]).all()
    scene.cell_fields["density"][3] = np.nan
    with pytest.raises(ValueError, match=r"density.*cell 3"):
        render_frame(scene, field="density", backend="raster")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cell_fluid": [0, 1]}, "cell_fluid: shape"),
        ({"cell_fluid": np.full(2 * COUNT**2, 2)}, "cell_fluid: indices"),
        ({"cell_fields": {"density": np.zeros(3)}}, "cell_fields 'density': shape"),
        ({"cell_fields": {"salt": np.zeros(2 * COUNT**2)}}, "'salt' is not among fields"),
    ],
)
def test_bad_values_of_cells_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        made_scene(**changes)


def calm_air(**changes):
    """Hydrostatic water below air at pressures around zero, with a bubble deep below that has the water's pressure."""
    scene = made_scene(**changes)
    depth = np.maximum(0.25 - scene.position[:, 1], 0)
    return made_scene(
        fluid_densities=tuple(DENSITIES),
        cell_fields={},
        fields={"pressure": 9810 * depth, "speed": 0 * depth},
        **changes,
    )


def test_air_of_even_pressure_is_left_uncoloured_but_its_bubbles_are_not():
    scene = calm_air()
    assert FieldSample([scene], "pressure").muted() == ("air",)
    assert FieldSample([scene], "speed").muted() == ()
    spans = FieldSample([scene], "pressure").spans()
    assert muted_fluids(spans) == ("air",)
    assert muted_fluids(spans | {"air": (-2000.0, 2000.0)}) == muted_fluids({}) == ()  # at another time it presses
    view = View(muted=("air",))
    drawing, keys = draw_scene(scene, layout_of(scene), FILLS, Look("pressure", (0, 2500), view=view))
    assert [key.text for key in keys] == ["interface"]
    # The cells' triangles come with one colour where they are muted, and with the table's elsewhere.
    above = layout_of(scene).pixels(scene.position[scene.cells].mean(axis=1))
    muted = flat_cells(drawing, FILLS[1])
    air = scene.cell_fluid == 1
    high = scene.position[scene.cells][..., 1].min(axis=1) > 0.31
    bubble = air & (scene.position[scene.cells][..., 1].max(axis=1) < 0.17)
    assert bubble.any()
    inside = {tuple(np.round(centre, 1)) for centre in muted}
    assert all(tuple(np.round(centre, 1)) in inside for centre in above[air & high].astype(np.float32))
    assert not any(tuple(np.round(centre, 1)) in inside for centre in above[bubble].astype(np.float32))
    coloured, _ = draw_scene(scene, layout_of(scene), FILLS, Look("pressure", (0, 2500), view=View(muted=())))
    assert len(flat_cells(coloured, FILLS[1])) == 0


def flat_cells(drawing: Drawing, fill):
    """Middles of the triangles of one colour."""
    vertices, shades = drawing.arrays()
    return vertices[(np.abs(shades - fill) < 1e-6).all(axis=(1, 2))].mean(axis=1)


def test_air_that_presses_is_coloured():
    scene = calm_air()
    values = np.where(scene.fluid == 1, 3000 * scene.position[:, 0], 9810 * (0.5 - scene.position[:, 1]))
    pressed = made_scene(fluid_densities=tuple(DENSITIES), cell_fields={}, fields={"pressure": values})
    assert FieldSample([pressed], "pressure").muted() == ()
    heavy = made_scene(fluid_densities=(998.2, 900.0), cell_fields={}, fields={"pressure": scene.fields["pressure"]})
    assert FieldSample([heavy], "pressure").muted() == ()


def test_the_muted_picture_names_the_fluid_and_no_contour_is_in_it():
    scene = calm_air()
    plain = render_frame(scene, SIZE, "pressure", backend="raster", view=View(muted=()))
    image = render_frame(scene, SIZE, "pressure", backend="raster")
    air = (image == np.rint(255 * FILLS[1]).astype(np.uint8)).all(axis=2)
    assert air.mean() > 0.1
    assert not (plain == np.rint(255 * FILLS[1]).astype(np.uint8)).all(axis=2).any()
    noisy = dict(scene.fields) | {
        "pressure": scene.fields["pressure"] + np.where(np.arange(len(scene.fluid)) % 2, 5, -5)
    }
    lines = render_frame(
        made_scene(fluid_densities=tuple(DENSITIES), fields=noisy, cell_fields={}),
        SIZE,
        "pressure",
        backend="raster",
        view=View(contours="pressure"),
    )
    red = (lines[..., 0] > 200) & (lines[..., 1] < 90)
    left, top, right, bottom = layout_of(scene, "pressure").box
    surface = round(bottom - (bottom - top) * (0.25 + 0.06) / SIDE)
    assert red[round(top) : surface - 20, round(left) : round(right)].sum() == 0
    assert red[surface:, round(left) : round(right)].sum() > 100


def test_interfaces_of_three_fluids_show_which_side_is_which():
    base = made_scene()
    middle = base.position[base.cells].mean(axis=1)
    cell_fluid = np.digitize(middle[:, 1], [0.17, 0.33])
    fluid = np.digitize(base.position[:, 1], [0.17, 0.33])
    names = ("glycerin", "water", "air")
    scene = made_scene(cell_fluid=cell_fluid, fluid=fluid, fluid_names=names, cell_fields={})
    image = render_frame(scene, SIZE, "pressure", backend="raster").astype(int)
    fills = np.rint(255 * fluid_colours(names)).astype(int)
    left, top, right, bottom = layout_of(scene, "pressure").box

    def height(fill):
        rows, _ = np.nonzero((np.abs(image[:, round(left) + 20 : round(right) - 20] - fill) < 3).all(axis=2))
        return SIDE * (bottom - rows) / (bottom - top)

    glycerin, water, air = (height(fill) for fill in fills)
    assert np.median(glycerin) < 0.2
    assert (np.abs(glycerin - 0.17) < 0.05).mean() > 0.95
    assert np.abs(water - 0.17).min() < 0.03
    assert np.abs(water - 0.33).min() < 0.03
    assert np.abs(air - 0.33).max() < 0.06
