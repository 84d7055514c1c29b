"""Tanks from mesh files: points, triangles, fluids and walls of a file of Gmsh, or of any format that meshio reads."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.arguments import is_number, rounded
from tipfem.case.body import Body
from tipfem.case.fluid import Fluid, ranks
from tipfem.case.grading import Grading
from tipfem.case.particles import Particles
from tipfem.case.tank import Tank, require_near
from tipfem.case.walls import Wall
from tipfem.geometry.period import no_period
from tipfem.geometry.plane.curves import has_curve
from tipfem.geometry.plane.domain import Domain, enclosed
from tipfem.geometry.plane.vectors import cross
from tipfem.typing import Array

# Cell data in which formats other than Gmsh's keep the number of a cell's group.
GROUP_DATA = ("gmsh:physical", "medit:ref", "cell_tags", "CellEntityIds", "group", "region")


class MeshTank(Tank):
    """A tank whose particles are the points of a mesh; `tipfem.read_mesh` makes one.

    The names of the surfaces' groups are the fluids', those of the curves' groups the walls'. ``points`` (N, 2) [m]
    have triangles ``cells`` (M, 3), with the name of the fluid of each, ``regions``, and ``edges`` (E, 2) along walls,
    with the name of each wall, ``sides``. The spacing is by default the median length of the triangles' edges [m];
    ``source`` is for messages, ``file`` what it was read from, and by which factor its coordinates were multiplied.
    `ValueError` if the mesh is not a plane region with a boundary that has names.
    """

    def __init__(
        self,
        points: Array,
        cells: Array,
        regions: Sequence[str],
        edges: Array,
        sides: Sequence[str],
        spacing: float | None = None,
        source: str = "mesh",
        file: tuple[Path, float] | None = None,
    ) -> None:
        cells, groups = _each_once(np.asarray(cells), list(regions))
        used = np.unique(cells)
        number = np.full(len(points), -1)
        number[used] = np.arange(len(used))
        _require_edges_of_cells(points, number[edges] < 0, edges, list(sides), source)
        x, cells, edges = points[used], number[cells], number[edges]
        a, b, c = x[cells].transpose(1, 0, 2)
        area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
        cells = np.where((area < 0)[:, None], cells[:, ::-1], cells)
        pairs = cells[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        if spacing is None:
            spacing = float(np.median(np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)))
        super().__init__(np.ptp(x, axis=0), spacing)
        self.lower, self.upper = x.min(axis=0), x.max(axis=0)
        require_near(self.lower, self.upper)
        self._points, self._cells, self._groups, self._source, self.file = x, cells, groups, source, file
        self.domain = _domain_around(x, pairs, edges, list(sides), source)
        self.sides = tuple(self.domain.sides)

    def fill(self, fluid: Fluid, **part: Any) -> Tank:
        """`ValueError`: the mesh says what each of its triangles is filled with."""
        raise ValueError(
            f"fill {fluid.name!r}: the surfaces of a mesh have the fluids that they are named after; leave fill out"
        )

    @property
    def is_box(self) -> bool:
        """See `Tank.is_box`."""
        return False

    def _is_curved(self, side: str) -> bool:
        """See `Tank._is_curved`."""
        return has_curve(self.domain, side)

    def walls(self, particles: Particles) -> list[Wall]:
        """The walls described by `wall`, by their sides."""
        return [Wall(name, side=name, **what) for name, what in self.wall_options.items()]

    def holds(self, x: Array) -> Array:
        """Mask (K,) of the positions (K, 2) [m] that are in the mesh."""
        assert self.domain is not None
        return self.domain.contains(x)

    def first_cells(self, fluids: Sequence[Fluid]) -> tuple[Array, Array]:
        """The triangles (M, 3) of the particles of `sample`, and the number (M,) of the fluid of each."""
        return self._cells.astype(np.int32), self._fluid_of(fluids).astype(np.int32)

    def _fluid_of(self, fluids: Sequence[Fluid]) -> Array:
        """The number (M,) of the fluid of each triangle, the only one that its groups name; else `ValueError`."""
        names, of = [fluid.name for fluid in fluids], {}
        for group in dict.fromkeys(self._groups):
            own = [name for name in group if name in names]
            if len(own) > 1:
                text = f"{self._source}: triangles are in the physical groups {' and '.join(own)}; each must be of one "
                raise ValueError(f"{text}fluid")
            if not own:
                text = f"{self._source}: its surface {' and '.join(map(repr, group))} is not named after a fluid; the "
                raise ValueError(f"{text}case has {', '.join(names)}")
            of[group] = names.index(own[0])
        for k, name in enumerate(names):
            if k not in of.values():
                found = ", ".join(dict.fromkeys(each for group in of for each in group))
                text = f"{self._source}: no surface is in a physical group {name!r}, which is a fluid of the case; the "
                raise ValueError(f"{text}file has {found}")
        return np.array([of[group] for group in self._groups])

    def add(self, body: Body) -> Tank:
        """`ValueError`: a tank from a mesh has no room for bodies."""
        text = f"add: body {body.name!r} cannot be put into a tank that was read from a mesh, whose triangles fill it; "
        raise ValueError(f"{text}make the tank by tipfem.tank(shape=...)")

    def sample(
        self, fluids: Sequence[Fluid], *, fitted: bool = False, empty: bool = False, grading: Grading | None = None
    ) -> Particles:
        """Particles at the points of the mesh, each with the heaviest fluid around it; see `Tank.sample` for errors."""
        if empty:
            raise ValueError(f"{self._source}: the fluids of a mesh fill it, so that it has no free surface")
        rank = ranks(fluids)
        of_cell, label = self._fluid_of(fluids), np.full(len(self._points), -1)
        for f in np.argsort(rank):
            label[self._cells[of_cell == f]] = f
        wall = np.zeros(len(self._points), dtype=bool)
        assert self.domain is not None
        on = self.domain.on_edges(self._points, 1e-9 * self.spacing).any(axis=1)
        wall[on] = True
        return Particles(self._points, label, wall, spacing=self.spacing)


def read_mesh(
    path: str | Path,
    spacing: float | None = None,
    *,
    scale: float = 1.0,
    fluids: Mapping[int, str] | None = None,
    walls: Mapping[int, str] | None = None,
) -> MeshTank:
    """A tank from a mesh file: ``tp.Case(tp.read_mesh("tank.msh"), [water, air], (0, -9.81))``.

    Every point of the mesh is a particle. In a file of Gmsh (4.1 or 2.2, text or binary) the physical groups of
    surfaces are named after the fluids, and those of curves are the walls. A triangle may be in further groups. The
    interface of two fluids must run along edges of the triangles, for the sharp interface.

    Args:
        path: of the file, in any format that meshio reads.
        spacing: target distance between particles [m]; by default the median length of the triangles' edges.
        scale: by which all coordinates are multiplied, to have them in m: 1e-3 for a file in mm.
        fluids: names of the fluids by the numbers of the groups of triangles, for formats without names.
        walls: names of the walls by the numbers of the groups of lines, for formats without names.

    Raises:
        ValueError: the file cannot be read, has no triangles, is not plane, or a group is missing.
    """
    here = f"read_mesh {str(path)!r}"
    if spacing is not None and not (is_number(spacing) and spacing > 0):
        raise ValueError(f"{here}: spacing is {spacing!r} m; it must be a number > 0")
    if not (is_number(scale) and scale > 0):
        raise ValueError(f"{here}: scale is {scale!r}; it must be a number > 0, as 1e-3 for a file in mm")
    mesh = _read(Path(path), here)
    points = np.asarray(mesh.points, dtype=float) * scale
    if points.ndim != 2 or len(points) < 3 or not np.isfinite(points).all():
        raise ValueError(f"{here}: it must have three points or more, with finite coordinates")
    if points.shape[1] == 3:
        if np.ptp(points[:, 2]) > 1e-9 * max(np.ptp(points), 1e-300):
            raise ValueError(f"{here}: its points are not in one plane of constant z; the mesh must be 2-D")
        points = points[:, :2]
    names = {(int(dim), int(tag)): name for name, (tag, dim) in mesh.field_data.items()}
    names.update({(2, tag): name for tag, name in (fluids or {}).items()})
    names.update({(1, tag): name for tag, name in (walls or {}).items()})
    others = {block.type: len(block.data) for block in mesh.cells if block.type not in ("triangle", "line", "vertex")}
    if others:
        found = ", ".join(f"{count} of type {kind!r}" for kind, count in others.items())
        text = f"{here}: it has cells beside triangles with three corners, {found}; mesh it with triangles only"
        raise ValueError(text)
    cells, regions = _groups(mesh, "triangle", 2, names, "surface", here)
    edges, sides = _groups(mesh, "line", 1, names, "curve", here)
    kept = None if fluids or walls else (Path(path), float(scale))
    return MeshTank(points, cells, regions, edges, sides, spacing, here, kept)


def _read(path: Path, here: str) -> Any:
    """The file by meshio, which ends the process on a bad one."""
    import meshio

    if not path.is_file():
        raise ValueError(f"{here}: there is no such file")
    if version := _old_version(path):
        text = f"{here}: it has Gmsh's format {version}, which is not read; save it as 4.1 or 2.2, which Gmsh "
        raise ValueError(f"{text}writes by -format msh41 or msh22")
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            return meshio.read(path)
    except (Exception, SystemExit) as error:
        reason = str(error) or said.getvalue().strip()
        if "Incompatible cell data" in reason and "gmsh:physical" in reason:
            text = f"{here}: some of its cells are in no physical group, as where all is saved (Mesh.SaveAll); save it "
            raise ValueError(f"{text}without, so that it has the cells of physical groups alone") from error
        raise ValueError(f"{here}: meshio cannot read it: {reason}") from error


def _old_version(path: Path) -> str:
    """The version of a file of Gmsh whose format is not read; "" for others."""
    with open(path, "rb") as file:
        first, second = file.readline(100).strip(), file.readline(100).split()
    if first in (b"$NOD", b"$NOE"):
        return "1.0"
    version = second[0].decode("ascii", "replace") if first == b"$MeshFormat" and second else ""
    return f"{version}.0" if version in ("1", "3", "4") else version if version in ("1.0", "2.0", "3.0", "4.0") else ""


def _each_once(cells: Array, regions: Sequence[str]) -> tuple[Array, list[tuple[str, ...]]]:
    """Triangles (M, 3), each once, and the names of the groups of each: a file has them once for each group."""
    _, first, number = np.unique(np.sort(cells, axis=1), axis=0, return_index=True, return_inverse=True)
    if len(first) == len(cells):
        return cells, [(name,) for name in regions]
    order = np.argsort(first)
    place = np.empty(len(first), dtype=int)
    place[order] = np.arange(len(first))
    groups: list[dict[str, None]] = [{} for _ in first]
    for cell, name in zip(place[number.ravel()].tolist(), regions, strict=True):
        groups[cell][name] = None
    return cells[first[order]], [tuple(group) for group in groups]


def _require_edges_of_cells(points: Array, beyond: Array, edges: Array, sides: Sequence[str], here: str) -> None:
    """Check that all edges (E, 2) are of triangles; ``beyond`` (E, 2) is a mask of ends that are in none."""
    off = np.flatnonzero(beyond.any(axis=1))
    if not len(off):
        return
    name = sides[off[0]]
    mine = [k for k in off.tolist() if sides[k] == name]
    ends = [points[edges[k][~beyond[k]][0]] for k in mine if not beyond[k].all()]
    at = rounded(ends[0] if ends else points[edges[off[0]]].mean(axis=0))
    text = f"{here}: the curve {name!r} goes on beyond the triangles ({'from' if ends else 'at'} {at} m), where there "
    raise ValueError(f"{text}is no fluid; mesh what is there, too, or end the curve where the triangles end")


def _groups(
    mesh: Any, kind: str, dimension: int, names: Mapping[tuple[int, int], str], what: str, here: str
) -> tuple[Array, list[str]]:
    """The cells (K, n) of a kind, with the name of the group of each."""
    data = next((mesh.cell_data[name] for name in GROUP_DATA if name in mesh.cell_data), None)
    cells, found = [], []
    for k, block in enumerate(mesh.cells):
        if block.type != kind:
            continue
        cells.append(np.asarray(block.data))
        tags = np.zeros(len(block.data), dtype=int) if data is None else np.asarray(data[k]).astype(int)
        for tag in tags.tolist():
            if (dimension, tag) not in names:
                given = ", ".join(repr(name) for (d, _), name in names.items() if d == dimension) or "none"
                text = f"{here}: a {what} is in no named physical group (its number is {tag}); every {what} must be in "
                text += f"one, named after a {'fluid' if dimension == 2 else 'wall'}; the file names {given}"
                raise ValueError(text)
            found.append(names[dimension, tag])
    if not cells:
        raise ValueError(f"{here}: it has no cells of type {kind!r}; put every {what} into a named physical group")
    return np.concatenate(cells), found


def _domain_around(x: Array, pairs: Array, edges: Array, sides: list[str], here: str) -> Domain:
    """The polygon of a mesh's boundary from its cells' directed edges (K, 2) and those (E, 2) that have names."""
    n = len(x)
    key = pairs[:, 0].astype(np.int64) * n + pairs[:, 1]
    boundary = pairs[~np.isin(pairs[:, 1].astype(np.int64) * n + pairs[:, 0], key)]
    name_of: dict[tuple[int, int], str] = {}
    for (a, b), name in zip(edges.tolist(), sides, strict=True):
        if name_of.get((a, b), name) != name:
            middle = rounded(0.5 * (x[a] + x[b]))
            text = f"{here}: the edge at {middle} m is on two curves, {name_of[a, b]!r} and {name!r}"
            raise ValueError(f"{text}; a wall has one name")
        name_of[a, b] = name_of[b, a] = name
    ends = {(a, b) for a, b in boundary.tolist()}
    inner = [pair for pair in name_of if pair not in ends and pair[::-1] not in ends]
    if inner:
        middle = (0.5 * (x[inner[0][0]] + x[inner[0][1]])).tolist()
        text = f"{here}: the curve {name_of[inner[0]]!r} is inside the fluids, at {middle}, where there can be no "
        raise ValueError(f"{text}wall; cut a thin hole along it, or leave it out of the physical groups")
    after: dict[int, int] = {}
    for a, b in boundary.tolist():
        if (a, b) not in name_of:
            middle = (0.5 * (x[a] + x[b])).tolist()
            text = f"{here}: the edge of the boundary at {middle} is on no curve of a named physical group; all of the "
            raise ValueError(f"{text}boundary must be walls")
        if a in after:
            raise ValueError(f"{here}: two parts of the boundary touch at {x[a].tolist()}")
        after[a] = b
    loops, names = [], []
    while after:
        first = k = next(iter(after))
        loop = []
        while k in after:
            loop.append(k)
            k = after.pop(k)
        if k != first:
            raise ValueError(f"{here}: the boundary is not closed at {x[k].tolist()}")
        corners = x[loop]
        names.append([name_of[a, b] for a, b in zip(loop, [*loop[1:], loop[0]], strict=True)])
        loops.append(corners)
    area = [enclosed(corners, np.roll(corners, -1, axis=0), no_period(2)) for corners in loops]
    outline = [k for k, value in enumerate(area) if value > 0]
    if len(outline) != 1:
        raise ValueError(f"{here}: its surfaces are {len(outline)} separate parts; they must be connected")
    order = [outline[0], *(k for k in range(len(loops)) if k != outline[0])]
    merged = [_merged(loops[k], names[k]) for k in order]
    return Domain([m[0] for m in merged], [m[1] for m in merged], [[-1] * len(m[1]) for m in merged])


def _merged(corners: Array, names: list[str]) -> tuple[Array, list[str]]:
    """A loop with straight edges of one name in a row made one."""
    before, after = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    sizes = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    straight = np.abs(cross(before, after)) < 1e-9 * sizes
    same = np.array([one == other for one, other in zip(names, [names[-1], *names[:-1]], strict=True)])
    keep = np.flatnonzero(~(straight & same))
    return corners[keep], [names[k] for k in keep]
