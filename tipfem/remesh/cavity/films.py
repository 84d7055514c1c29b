"""Films: cells between interfaces, or between them and walls, that break; particles that come down on walls."""

import taichi as ti

from tipfem.backend.array_types import Template
from tipfem.remesh.cavity.arrays import (
    AHEAD,
    CAVITY,
    COUNT,
    FIXED,
    KIND,
    LAND,
    LIMIT,
    ON,
    RELABEL,
    WALL,
    P,
    Q,
    cell,
    finest_at,
    gradient,
    has_mark,
    in_cavity,
    index,
    measure,
    place_of,
    position,
    quality,
    quality_with,
    set_place,
)
from tipfem.remesh.cavity.stars import add_star, labels_at

# Parts of the area of a film's faces that are on the interface where it breaks: over a wall, and elsewhere.
OVER_WALL, BETWEEN = 0.6, 0.45
SQUARE = 1e-6  # cosine of the angle between walls at right angles, at most
LANDED = 0.02  # quality of cells that suffices where a particle is put on a wall
CLOSING = 0.2  # part of its volume that a cell of empty space would keep, below which it closes
CLOSE = 0.5  # part of the height of a film below which it goes to the heavier fluid
LOW = 0.7  # the same below which a particle comes down on a wall: angles beside it are 4 degrees


@ti.func
def heavier_beside(mesh: Template, rows: Template, r, t, p):
    """The highest label around particle p of cell t, if that is above the cell's; else -1."""
    bits, label = labels_at(mesh, rows, r, add_star(mesh, rows, r, 0, t, p), p, -1, -1), -1
    for b in ti.static(range(8)):
        if (bits >> b) & 1 and b > mesh.label[t]:
            label = b
    return label


@ti.func
def propose_relabelling(mesh: Template, rows: Template, fields: Template, limits: Template, r, t):
    """Propose another label for cell t, a film; whether there is one. Labels are the higher the heavier fluids are.

    The label beyond its largest face, if as much of its faces is on the interface. Over a wall only those opposite the
    wall's particles count: so a film that comes down on the wall breaks from above, and no interface climbs up a wall.
    What is lower still goes to a heavier fluid beside it, or at a wall to the heaviest at its particles, as what closes
    does; it does not come back.
    """
    largest, label, at_wall, over, enclosed = 0.0, -1, False, -1, True
    for i in range(mesh.dim + 1):
        held = has_mark(mesh, mesh.cells[t, i], WALL)
        at_wall, enclosed = at_wall or held, enclosed and held
        if mesh.across[t, i] < 0 and not held:
            over = i
    that, whole, upper, widest, rise = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(mesh.dim + 1):
        o, area = mesh.across[t, i], gradient(mesh, t, i).norm()
        widest = ti.max(widest, area)
        if o >= 0 and (not at_wall or has_mark(mesh, mesh.cells[t, i], WALL)):
            whole += area
            upper = ti.max(upper, area)
            if mesh.label[o] != mesh.label[t] and area > largest:
                largest, label = area, mesh.label[o]
    for i in range(mesh.dim + 1):
        o = mesh.across[t, i]
        if o >= 0 and (not at_wall or has_mark(mesh, mesh.cells[t, i], WALL)):
            if mesh.label[o] == label:
                that += gradient(mesh, t, i).norm()
    beyond = label
    if that < ti.select(at_wall, OVER_WALL, BETWEEN) * whole or (not at_wall and largest < upper):
        label = -1
    if over >= 0:
        rise = speed_off(mesh, fields, t, over)
        if rise < 0.0 and label < mesh.label[t]:
            label = -1
    close = measure(mesh, cell(mesh, t)) < CLOSE * limits[LIMIT] * finest_at(mesh, limits, t) * widest
    if enclosed and close and label < mesh.label[t]:
        label = -1
    if label < 0 and close and not at_wall and beyond > mesh.label[t]:
        label = beyond
    if label < 0 and rise <= 0.0 and close and at_wall:
        for i in range(mesh.dim + 1):
            if enclosed or not has_mark(mesh, mesh.cells[t, i], WALL):
                label = ti.max(label, heavier_beside(mesh, rows, r, t, mesh.cells[t, i]))
    if label < 0 and closes(mesh, fields, limits, t):
        for i in range(mesh.dim + 1):
            label = ti.max(label, heavier_beside(mesh, rows, r, t, mesh.cells[t, i]))
    lands, height = False, LOW * limits[LIMIT] * finest_at(mesh, limits, t)
    for i in range(mesh.dim + 1):
        if not lands and mesh.across[t, i] < 0 and measure(mesh, cell(mesh, t)) < height * gradient(mesh, t, i).norm():
            if speed_off(mesh, fields, t, i) < 0.0:
                lands = propose_landing(mesh, rows, r, t, i)
    if not lands:
        rows.row[r, CAVITY], rows.row[r, COUNT], rows.row[r, P], rows.row[r, KIND] = t, 1, label, RELABEL
    return lands or label >= 0


@ti.func
def closes(mesh: Template, fields: Template, limits: Template, t):
    """Whether cell t is of empty space, between surfaces, and would be flat after the time [AHEAD], if that is any."""
    found = limits[AHEAD] > 0.0 and mesh.label[t] == 0
    if found:
        for i in ti.static(range(mesh.dim + 1)):
            found = found and has_mark(mesh, mesh.cells[t, i], ON)
    if found:
        y = ti.Matrix.rows([position(mesh, mesh.cells[t, i]) for i in ti.static(range(mesh.dim + 1))])
        for i in ti.static(range(mesh.dim + 1)):
            for k in ti.static(range(mesh.dim)):
                y[i, k] += limits[AHEAD] * fields[mesh.cells[t, i], k]
        side = ti.Matrix.rows(
            [[y[i, k] - y[0, k] for k in ti.static(range(mesh.dim))] for i in ti.static(range(1, mesh.dim + 1))]
        )
        found = side.determinant() <= CLOSING * measure(mesh, cell(mesh, t))
    return found


@ti.func
def speed_off(mesh: Template, fields: Template, t, i):
    """A multiple of the speed at which corner i of cell t leaves the opposite face, by a corner there."""
    up, speed = gradient(mesh, t, i), 0.0
    for k in ti.static(range(mesh.dim)):
        speed += up[k] * (fields[mesh.cells[t, i], k] - fields[mesh.cells[t, (i + 1) % (mesh.dim + 1)], k])
    return speed


@ti.func
def propose_landing(mesh: Template, rows: Template, r, t, i):
    """Propose to put corner i of cell t on the wall that the other corners are on; whether it may slide there.

    The cell vanishes. Others must keep some of their quality. A particle of another wall stays on that.
    """
    p, free = mesh.cells[t, i], False
    for k in ti.static(range(mesh.dim + 1)):
        if k != i and not has_mark(mesh, mesh.cells[t, k], FIXED):
            free = True
    up, foot = gradient(mesh, t, i), position(mesh, mesh.cells[t, (i + 1) % (mesh.dim + 1)])
    up /= up.norm() + 1e-300
    place = position(mesh, p) - up * up.dot(position(mesh, p) - foot)
    count = add_star(mesh, rows, r, 0, t, p)
    good = free and count > 0 and not has_mark(mesh, p, FIXED)
    for k in ti.static(range(mesh.dim + 1)):
        # Beside the face the wall may have ended: at a block.
        if k != i and gradient(mesh, t, k).dot(place - position(mesh, p)) < 0.0:
            good = False
    for m in range(count):
        c = in_cavity(rows, r, m)
        if c != t:
            if quality_with(mesh, cell(mesh, c), index(mesh, c, p), place) < ti.min(LANDED, 0.3 * quality(mesh, c)):
                good = False
            for k in range(mesh.dim + 1):
                if mesh.across[c, k] < 0 and mesh.cells[c, k] != p:
                    other = gradient(mesh, c, k)
                    if mesh.across[c, k] == mesh.across[t, i] or ti.abs(other.dot(up)) > SQUARE * other.norm():
                        good = False
    if good:
        rows.row[r, KIND], rows.row[r, COUNT], rows.row[r, P], rows.row[r, Q] = LAND, count, p, t
        set_place(mesh, rows, r, place)
    return good


@ti.func
def land(mesh: Template, rows: Template, r):
    """Put particle P of row r on the wall under cell Q, which vanishes."""
    t, p, wall = rows.row[r, Q], rows.row[r, P], -1
    for i in ti.static(range(mesh.dim + 1)):
        if mesh.cells[t, i] == p:
            wall = mesh.across[t, i]
    for i in ti.static(range(mesh.dim + 1)):
        o = mesh.across[t, i]
        if o >= 0:
            for k in ti.static(range(mesh.dim + 1)):
                if mesh.across[o, k] == t:
                    mesh.across[o, k] = wall
    mesh.label[t] = -1
    mesh.marks[p] |= WALL
    place = place_of(mesh, rows, r)
    for k in ti.static(range(mesh.dim)):
        mesh.x[p, k] = place[k]
