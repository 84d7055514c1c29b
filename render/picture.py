"""Drawing of a scene's tank: walls, fluids or a field, mesh, particles, interface."""

import numpy as np

from . import colours
from .arrays import Array
from .drawing import Drawing
from .interface import edge_means, fluid_regions, loose_particles, mesh_edges, particle_fluids, walls_around
from .layout import Layout
from .scene import Scene

WALL_THICKNESS = 7.0  # in design pixels, like the widths below
INTERFACE_WIDTH = 1.5
HALO_WIDTH = 3.4
SPRAY_RADIUS = 0.4  # in spacings
MESH_WIDTH = 0.8


def draw_scene(
    scene: Scene,
    layout: Layout,
    fills: Array,
    *,
    field: str | None = None,
    field_range: tuple[float, float] | None = None,
    mesh: bool = False,
    particles: bool = False,
) -> Drawing:
    """Drawing of one scene.

    Args:
        scene: what is drawn.
        layout: of the picture.
        fills: (F, 3) colours of the fluids.
        field: a name in `scene.fields`, or None to show the fluids.
        field_range: (low, high) of the colours, used with a field.
        mesh: draw the edges of the cells.
        particles: draw the particles as dots.
    """
    assert scene.wall is not None, "a Scene fills in what was left out"
    assert scene.spacing is not None, "a Scene fills in what was left out"
    drawing = Drawing()
    unit = layout.unit
    pixels = layout.pixels(scene.position)
    regions = fluid_regions(scene.position, scene.cells, scene.fluid, scene.cell_fluid)
    edges, on_boundary = mesh_edges(scene.cells)

    # Walls are stroked on both sides of the mesh's boundary; the fluids painted next hide the inner half.
    hull = edges[on_boundary & scene.wall[edges].all(axis=1)]
    thick = WALL_THICKNESS * unit
    # Dry walls are drawn around the empty space between them.
    spray, dry = loose_particles(scene.cells, scene.wall)
    box, inside = walls_around(scene.position, scene.wall & dry.any())
    drawing.lines(pixels[np.concatenate([hull, box])], 2 * thick, colours.rgb(colours.WALL), cap=thick)
    drawing.triangles(pixels[inside], np.array(colours.BACKGROUND))

    if field is None:
        shown = colours.mix(fills, 1.0, 0.62) if particles else fills
        drawing.triangles(layout.pixels(regions.triangles), shown[regions.fluid])
        tones = colours.tone(shown)[_corner_fluids(scene)]
        dots = colours.dot_colours(fills)
    else:
        low, high = (0.0, 1.0) if field_range is None else field_range
        table = colours.colour_table(is_signed(field))
        at_corners = colours.map_values(scene.corner_values(field), low, high, table)
        drawing.triangles(pixels[scene.cells], at_corners)
        tones = 0.6 * at_corners
        dots = colours.dot_colours_on_field(fills)

    # A particle in no cell is drawn as a drop of about the volume that it carries.
    drop, tints = SPRAY_RADIUS * scene.spacing * layout.scale, fills[scene.fluid[spray]]
    if field is not None:
        tints = colours.map_values(scene.field_values(field)[spray], low, high, table)
    drawing.dots(pixels[spray], max(drop, 0.9 * unit), tints)

    if mesh:
        drawing.lines(pixels[edges], max(MESH_WIDTH * unit, 0.5), edge_means(scene.cells, tones))
    radius = min(max(0.27 * scene.spacing * layout.scale, 0.9 * unit), 6 * unit)
    beads = pixels[:0]
    if particles:
        fluid, between = scene.fluid, np.zeros(len(pixels), bool)
        if scene.cell_fluid is not None:
            fluid, between = particle_fluids(scene.cells, fluid, scene.cell_fluid)
        single = ~between & ~dry
        drawing.dots(pixels[single], radius, dots[fluid[single]])
        beads = pixels[between]

    interface = layout.pixels(regions.segments)
    light, dark = colours.rgb(colours.HALO), colours.rgb(colours.INTERFACE)
    if field is not None:
        # A light line under the dark one, so that it is visible on every colour of the table.
        drawing.lines(interface, HALO_WIDTH * unit, light, cap=0.5 * unit)
        drawing.dots(beads, radius + (HALO_WIDTH - INTERFACE_WIDTH) / 2 * unit, np.tile(light, (len(beads), 1)))
    drawing.lines(interface, INTERFACE_WIDTH * unit, dark, cap=0.3 * unit)
    # Particles on the interface belong to both fluids and have its colour.
    drawing.dots(beads, radius, np.tile(dark, (len(beads), 1)))
    return drawing


def _corner_fluids(scene: Scene) -> Array:
    """The fluid at the corners of each cell, (M, 3): the cell's, else the particles'."""
    if scene.cell_fluid is None:
        return np.asarray(scene.fluid[scene.cells])
    return np.repeat(scene.cell_fluid[:, None], 3, axis=1)


def is_signed(field: str) -> bool:
    """Whether the field has a direction, and zero is the middle of its colours."""
    return field.startswith("velocity_")
