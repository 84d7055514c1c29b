"""Drawing of a scene's tank: walls, fluids or a field, mesh, particles, interface."""

import numpy as np

from . import colours
from .arrays import Array
from .drawing import Drawing
from .interface import edge_means, particle_fluids
from .layers import WALL_THICKNESS, draw_layers, mask_outside
from .layout import Layout
from .scales import colour_map_of
from .scene import Scene
from .view import View

INTERFACE_WIDTH = 1.5  # in design pixels, like the widths below
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
    view: View | None = None,
) -> tuple[Drawing, list[str]]:
    """Drawing of one scene, and lines of text on the scales of its layers.

    Args:
        scene: what is drawn.
        layout: of the picture.
        fills: (F, 3) colours of the fluids.
        field: a name in `scene.fields`, or None to show the fluids.
        field_range: (low, high) of the colours, used with a field.
        mesh: draw the edges of the cells.
        particles: draw the particles as dots.
        view: the part shown and the layers; None for all of the scene without layers.
    """
    view = View() if view is None else view
    assert scene.wall is not None, "a Scene fills in what was left out"
    assert scene.spacing is not None, "a Scene fills in what was left out"
    drawing = Drawing()
    unit = layout.unit
    pixels = layout.pixels(scene.position)
    geometry = scene.geometry
    regions, edges = geometry.regions, geometry.edges
    walls, inside, spray, dry = geometry.surroundings

    # Walls are stroked on both sides of the mesh's boundary; the fluids painted next hide the inner half.
    thick = WALL_THICKNESS * unit
    drawing.lines(pixels[walls], 2 * thick, colours.rgb(colours.WALL), cap=thick)
    drawing.triangles(pixels[inside], np.array(colours.BACKGROUND))
    if not view.fill:
        drawing.triangles(pixels[scene.cells], np.array(colours.BACKGROUND))

    # Colours are those of cells, (M, 3), where fields or fluids jump between them, else of particles, (N, 3).
    if field is None:
        shown = colours.mix(fills, 1.0, 0.62) if particles else fills
        if view.fill:
            drawing.triangles(layout.pixels(regions.triangles), shown[regions.fluid])
        tones = colours.tone(shown)[scene.fluid if scene.cell_fluid is None else scene.cell_fluid]
        by_cell = scene.cell_fluid is not None
        dots = colours.dot_colours(fills)
    else:
        low, high = (0.0, 1.0) if field_range is None else field_range
        table = colours.colour_table(view.colour_map or colour_map_of(field))
        values = scene.field_values(field)
        by_cell = field in scene.cell_fields
        shades = colours.map_values(scene.cell_values(field) if by_cell else values, low, high, table)
        shades = shades.astype(np.float32)
        if view.fill:
            drawing.triangles(pixels[scene.cells], shades if by_cell else shades[scene.cells])
        tones = 0.6 * shades
        dots = colours.dot_colours_on_field(fills)

    # A particle in no cell is drawn as a drop of about the volume that it carries.
    drop, tints = SPRAY_RADIUS * scene.spacing * layout.scale, fills[scene.fluid[spray]]
    if field is not None:
        tints = colours.map_values(values[spray], low, high, table)
    drawing.dots(pixels[spray], max(drop, 0.9 * unit), tints)

    if mesh:
        ends = pixels[edges.pairs]
        lines = edge_means(edges, tones) if by_cell else tones[edges.pairs].mean(axis=1)
        drawing.lines(ends, max(MESH_WIDTH * unit, 0.5), lines)
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
    if not view.fill:  # nothing else shows where the fluids end
        ends = edges.pairs[edges.shared_by == 1]
        interface = np.concatenate([interface, pixels[ends[~scene.wall[ends].all(axis=1)]]])
    light, dark = colours.rgb(colours.HALO), colours.rgb(colours.INTERFACE)
    if field is not None:
        # A light line under the dark one, so that it is visible on every colour of the table.
        drawing.lines(interface, HALO_WIDTH * unit, light, cap=0.5 * unit)
        drawing.dots(beads, radius + (HALO_WIDTH - INTERFACE_WIDTH) / 2 * unit, light)
    drawing.lines(interface, INTERFACE_WIDTH * unit, dark, cap=0.3 * unit)
    # Particles on the interface belong to both fluids and have its colour.
    drawing.dots(beads, radius, dark)
    notes = draw_layers(drawing, scene, layout, view, field is not None and view.fill)
    if view.window is not None or view.follow is not None:
        mask_outside(drawing, scene, layout)
    return drawing, notes
