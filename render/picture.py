"""Drawing of a scene's tank: walls, fluids or a field, mesh, particles, interface."""

import numpy as np

from . import colours
from .arrays import Array
from .bodies import draw_bodies
from .drawing import Drawing
from .interface import edge_means, particle_fluids
from .joints import draw_walls
from .layers import INTERFACE, WALL_THICKNESS, Key, cover_ends, draw_layers, draw_openings, is_muted, mask_outside
from .layout import Layout
from .outlines import SMOOTHED, SPRAY_RADIUS, draw_smoothed
from .scales import MUTED_FIELD, MUTED_SHARE, colour_map_of
from .scene import Scene
from .view import Look

INTERFACE_WIDTH = 2.0  # in design pixels, like the widths below
HALO_WIDTH = 4.2
SIDE_WIDTH = 3.6  # of the stripes on both sides of an interface
MESH_WIDTH = 0.8
THIN_SOLID = 2.0  # circumradius of triangles of what is filled between walls, in thicknesses of a wall


def draw_scene(
    scene: Scene,
    layout: Layout,
    fills: Array,
    look: Look = Look(),  # noqa: B008 - it is a tuple
    scheme: colours.Scheme = colours.LIGHT,
) -> tuple[Drawing, list[Key]]:
    """Drawing of one scene, and the entries of the legend for its lines; see `Renderer.frame`.

    ``fills`` (F, 3) are the colours of the fluids. `ValueError` if particles are to be drawn in a slice.
    """
    field, field_range, mesh, particles, view = look
    if particles and scene.plane is not None:
        raise ValueError("particles do not lie in a plane that cuts the cells; leave out the particles or the slice")
    drawing = Drawing()
    unit = layout.unit
    pixels = layout.pixels(scene.position)
    geometry = scene.geometry
    regions, edges = geometry.regions, geometry.edges
    walls, around, inside, spray, dry = geometry.surroundings
    thick, drop = WALL_THICKNESS * unit, max(SPRAY_RADIUS * scene.spacing * layout.scale, 0.9 * unit)
    radius = min(max(0.27 * scene.spacing * layout.scale, 0.9 * unit), 6 * unit)

    # Of a window only what touches it is drawn, or touches the walls about it.
    every: slice | Array = slice(None)
    seen, parts, sides, borders = every, every, every, every
    near: Array = np.ones(len(pixels), bool)
    if view.window is not None or view.follow is not None:
        margin = (2 * thick + max(drop, radius + HALO_WIDTH * unit)) / layout.scale
        low, high = np.subtract(layout.lower, margin), np.add(layout.upper, margin)
        seen, sides = geometry.cell_bounds.touching(low, high), geometry.edge_bounds.touching(low, high)
        parts = seen if scene.cell_fluid is not None else geometry.region_bounds.touching(low, high)
        borders = geometry.interface_bounds.touching(low, high)
        near = np.all((scene.position >= low) & (scene.position <= high), axis=1)
    cells = scene.cells[seen]

    # Walls are stroked on both sides of the boundary; the fluids painted next hide the inner half.
    if scene.tank is not None:
        points, outlines = layout.pixels(scene.tank.points), [scene.tank.edges]
        hollow, (solids, radii, feet, reach) = layout.pixels(scene.tank.inside), scene.tank.solids
    else:
        points, outlines, hollow = pixels, [walls, around], pixels[inside]
        solids, radii, feet, reach = geometry.solids
    for outline in outlines:
        draw_walls(drawing, points, outline, thick, colours.rgb(scheme.wall))
    # Solid parts are filled, and what is too thin for two strokes.
    solids, feet = (each[r * layout.scale < THIN_SOLID * thick] for each, r in ((solids, radii), (feet, reach)))
    drawing.triangles(points[solids], colours.rgb(scheme.wall))
    drawing.lines(points[feet], 2 * thick, colours.rgb(scheme.wall), cap=thick)
    drawing.triangles(hollow, np.array(scheme.background))
    if not view.fill:
        drawing.triangles(pixels[cells], np.array(scheme.background))

    # Of the whole tank, whatever part of it is shown.
    ends, own = colours.shades(fills, scheme, view.look), fills
    fills = ends.mean(axis=1)
    top, bottom = layout.pixels(np.stack([scene.upper, scene.lower]))[:, 1]

    def shaded(corners: Array, fluid: Array | int) -> Array:
        # Of triangles (T, 3, 2) [px] of a fluid, or of one each.
        if view.look != "lit":
            return np.asarray(fills[fluid])
        both = ends[fluid] if np.ndim(fluid) == 0 else ends[fluid][:, None]
        return colours.at_depth(both, corners[..., 1], top, bottom)

    # Colours are those of cells, (M, 3), where fields or fluids jump between them, else of particles, (N, 3).
    if field is None:
        shown = colours.mix(fills, scheme.background, 0.62) if particles else fills
        if view.smooth:
            draw_smoothed(drawing, scene, layout, shaded, INTERFACE_WIDTH * unit, colours.rgb(scheme.line))
        elif view.fill:
            corners, of = layout.pixels(regions.triangles[parts]), regions.fluid[parts]
            drawing.triangles(corners, shown[of] if particles else shaded(corners, of))
        tones = colours.tone(shown)[scene.fluid if scene.cell_fluid is None else scene.cell_fluid]
        by_cell = scene.cell_fluid is not None
        dots = colours.dot_colours(own)
    else:
        lowest, highest = (0.0, 1.0) if field_range is None else field_range
        table = colours.colour_table(view.colour_map or colour_map_of(field))
        values = scene.field_values(field)
        by_cell = field in scene.cell_fields
        shades = colours.map_values(scene.cell_values(field) if by_cell else values, lowest, highest, table)
        shades = shades.astype(np.float32)
        plain = np.zeros(len(scene.cells), bool)
        if field == MUTED_FIELD:
            plain = is_muted(scene, view, MUTED_SHARE * (highest - lowest))
        if view.fill:
            hidden = plain[seen]
            drawing.triangles(pixels[cells[~hidden]], (shades[seen] if by_cell else shades[cells])[~hidden])
            if hidden.any():
                assert scene.cell_fluid is not None, "cells without a fluid are not muted"
                drawing.triangles(pixels[cells[hidden]], shaded(pixels[cells[hidden]], scene.cell_fluid[seen][hidden]))
        tones = 0.6 * shades
        if plain.any():
            tones = np.where(plain[:, None], colours.tone(fills)[scene.cell_fluid], tones[scene.cells].mean(axis=1))
            by_cell = True
        dots = colours.dot_colours_on_field(own)

    # A particle in no cell is drawn as a drop of about the volume that it carries.
    drops = np.flatnonzero(spray & near)
    tints = fills[scene.fluid[drops]]
    if field is not None:
        coloured = colours.map_values(values[drops], lowest, highest, table)
        muted = [name in (view.muted or ()) and field == MUTED_FIELD for name in scene.fluid_names]
        tints = np.where(np.array(muted)[scene.fluid[drops], None], tints, coloured)
    drawing.dots(pixels[drops], drop, tints)

    if mesh:
        pairs = edges.pairs[sides]
        lines = edge_means(edges, tones, sides) if by_cell else (tones[pairs[:, 0]] + tones[pairs[:, 1]]) / 2
        drawing.lines(pixels[pairs], max(MESH_WIDTH * unit, 0.5), lines)
    beads = pixels[:0]
    if particles:
        fluid, between = scene.fluid, np.zeros(len(pixels), bool)
        if scene.cell_fluid is not None:
            fluid, between = particle_fluids(scene.cells, fluid, scene.cell_fluid)
        single = ~between & ~dry & near
        drawing.dots(pixels[single], radius, dots[fluid[single]])
        beads = pixels[between & near]

    interface = layout.pixels(regions.segments[borders])
    if not view.fill:  # nothing else shows where the fluids end
        ends = edges.pairs[sides][edges.shared_by[sides] == 1]
        interface = np.concatenate([interface, pixels[ends[~scene.wall[ends].all(axis=1)]]])
    light, dark = colours.rgb(colours.HALO), colours.rgb(colours.INTERFACE if field is not None else scheme.line)
    if field is not None:
        if len(scene.fluid_names) > 2 and scene.cell_fluid is not None:
            _draw_sides(drawing, scene, layout, fills)
        # A light line under the dark one, so that it is visible on every colour of the table.
        drawing.lines(interface, HALO_WIDTH * unit, light, cap=0.5 * unit)
        drawing.dots(beads, radius + (HALO_WIDTH - INTERFACE_WIDTH) / 2 * unit, light)
    if not view.smooth:
        drawing.lines(interface, INTERFACE_WIDTH * unit, dark, cap=0.3 * unit)
    # Particles on the interface belong to both fluids and have its colour.
    drawing.dots(beads, radius, dark)
    muting = field == MUTED_FIELD and bool(view.muted)
    keys = []
    if len(interface) and (field is not None or not view.fill):
        keys.append(Key(INTERFACE, colours.INTERFACE, colours.HALO))
    if view.smooth:
        keys.append(Key(SMOOTHED, scheme.line, colours.WALL if scheme.dark else colours.HALO))
    ground = (view.colour_map or colour_map_of(field)) if field is not None and view.fill and not muting else None
    keys += draw_layers(drawing, scene, seen, layout, view, ground)
    draw_bodies(drawing, scene.bodies, layout, scheme)  # over the paths of tracers, which lead to where they were
    keys += draw_openings(drawing, scene.openings, layout, scheme.background)
    if scene.period is not None:
        cover_ends(drawing, scene, layout, scheme.background)
    if view.window is not None or view.follow is not None:
        mask_outside(drawing, scene, layout, scheme)
    return drawing, keys


def _draw_sides(drawing: Drawing, scene: Scene, layout: Layout, fills: Array) -> None:
    """Stripes along the interfaces in the colours of the fluids on their two sides, where there are three or more."""
    assert scene.cell_fluid is not None, "the caller has asked"
    edges = scene.geometry.edges
    first = edges.first[edges.shared_by == 2]
    pairs = edges.pairs[edges.shared_by == 2]
    cells = [edges.sides[first + k] % len(scene.cells) for k in (0, 1)]
    differ = scene.cell_fluid[cells[0]] != scene.cell_fluid[cells[1]]
    ends = layout.pixels(scene.position[pairs[differ]])
    along = ends[:, 1] - ends[:, 0]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    offset = (HALO_WIDTH + SIDE_WIDTH) / 2 * layout.unit
    for side in cells:
        inside = layout.pixels(scene.position[scene.cells[side[differ]]].mean(axis=1)) - ends[:, 0]
        towards = np.where((inside * across).sum(axis=1, keepdims=True) > 0, across, -across)
        stripe = ends + offset * towards[:, None]
        drawing.lines(stripe, SIDE_WIDTH * layout.unit, fills[scene.cell_fluid[side[differ]]], cap=0.4 * layout.unit)
