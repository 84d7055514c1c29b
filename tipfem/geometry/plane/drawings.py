"""Outlines from drawings: lines, arcs and curves of DXF and SVG files, joined to closed outlines with holes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tipfem.arguments import is_number, rounded
from tipfem.geometry.plane.shapes import Arc, Piece, Shape, of_loops, pieces_between
from tipfem.typing import Array

JOIN = 1e-5  # ends of lines that are closer than this are one corner, relative to the size of what is drawn
FLAT = 1e-3  # distance of a curve from its chords by default, relative to the size of what is drawn
# Entities of DXF that have no outline: text, dimensions, fillings and marks.
NOTES = ("TEXT MTEXT ATTRIB ATTDEF DIMENSION ARC_DIMENSION LEADER MULTILEADER HATCH POINT VIEWPORT IMAGE TOLERANCE "
         "OLE2FRAME WIPEOUT XLINE RAY").split()  # fmt: skip
LINES = ("LINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE")


@dataclass(frozen=True)
class Stroke:
    """A straight line or an arc of a drawing."""

    start: Array  # (2,)
    end: Array  # (2,)
    bulge: float  # the tangent of a quarter of the arc's angle, positive anticlockwise; 0 for a straight line
    name: str  # of its side: a layer's or an element's
    place: str  # of what it belongs to in the file, for messages

    @property
    def arc(self) -> Arc | None:
        """The arc that it is; None for a straight line."""
        if not self.bulge:
            return None
        (x, y), (dx, dy) = 0.5 * (self.start + self.end), self.end - self.start
        off = (1 - self.bulge**2) / (4 * self.bulge)
        return Arc((float(x - off * dy), float(y + off * dx)), self.bulge < 0)


def read_drawing(
    path: str | Path,
    layer: str | Sequence[str] | None = None,
    *,
    scale: float | None = None,
    tolerance: float | None = None,
) -> Shape:
    """A shape from a drawing, DXF or SVG: ``tp.tank(shape=tp.read_drawing("weir.dxf", "walls"), spacing=0.01)``.

    Lines, arcs and curves are joined where they end within 1e-5 of the drawing's size. The largest closed outline
    bounds the shape, those inside it are holes. Each side has the name of the layer that its lines are on; in SVG the
    id of its element. Blocks are taken apart; text, dimensions and hatches are left out. It takes ``tipfem[drawings]``.

    Args:
        path: of the file.
        layer: name, or names, of where the outline is: of layer in DXF, of element, group or layer in SVG. By default
            all of the drawing.
        scale: by which coordinates are multiplied to have them in m, 1e-3 for mm. By default the unit of a DXF file's
            header; needed for SVG.
        tolerance: largest distance of splines and ellipses from the chords that replace them [m], less than the
            spacing; by default 0.1 % of their size. Circular arcs stay arcs.

    Raises:
        ValueError: the file cannot be read, has no unit, or its lines are no closed outline with holes inside.
    """
    path = Path(path)
    here = f"read_drawing {str(path)!r}"
    chosen = [layer] if isinstance(layer, str) else layer
    for name, value in (("scale", scale), ("tolerance", tolerance)):
        if value is not None and not (is_number(value) and value > 0 and math.isfinite(value)):
            raise ValueError(f"{here}: {name} is {value!r}; it must be a number > 0")
    readers = {".dxf": _dxf, ".svg": _svg}
    if path.suffix.lower() not in readers:
        raise ValueError(f"{here}: it must be a file .dxf or .svg; for a mesh there is tipfem.read_mesh")
    if not path.is_file():
        raise ValueError(f"{here}: there is no such file")
    strokes = readers[path.suffix.lower()](path, chosen, scale, tolerance, here)
    loops = [_pieces(loop) for loop in _loops(strokes, here)]
    try:
        return of_loops(loops)
    except ValueError as error:
        raise ValueError(f"{here}: {error}") from error


def _require_known(chosen: Sequence[str] | None, known: Iterable[str], what: str, here: str) -> None:
    known = list(dict.fromkeys(known))
    for name in chosen or ():
        if name not in known:
            shown = ", ".join(map(repr, known[:20])) or "none"
            raise ValueError(f"{here}: it has no {what} {name!r} with lines; it has {shown}")


def _dxf(
    path: Path, chosen: Sequence[str] | None, scale: float | None, tolerance: float | None, here: str
) -> list[Stroke]:
    """The strokes of a DXF file [m]."""
    try:
        from ezdxf.enums import InsertUnits
        from ezdxf.filemanagement import readfile
        from ezdxf.lldxf.const import DXFError
        from ezdxf.units import conversion_factor
    except ImportError:
        raise ValueError(f"{here}: DXF files take ezdxf: pip install 'tipfem[drawings]'") from None
    try:
        document = readfile(str(path))
    except (OSError, DXFError, UnicodeDecodeError, ValueError) as error:
        raise ValueError(f"{here}: ezdxf cannot read it: {error}") from error
    if scale is None:
        if not document.units:
            raise ValueError(f"{here}: its header has no unit ($INSUNITS is 0); give scale, as 1e-3 for a file in mm")
        scale = conversion_factor(InsertUnits(document.units), InsertUnits.Meters)
    entities = [entity for entity in _exploded(document.modelspace()) if entity.dxftype() not in NOTES]
    _require_known(chosen, (entity.dxf.layer for entity in entities), "layer", here)
    entities = [entity for entity in entities if chosen is None or entity.dxf.layer in chosen]
    if not entities:
        raise ValueError(f"{here}: there are no lines in its model space")
    return [stroke for entity in entities for stroke in _strokes_of(entity, scale, tolerance, here)]


def _exploded(entities: Iterable[Any]) -> Iterable[Any]:
    """The entities, with those of blocks and the parts of polylines in place of them."""
    for entity in entities:
        if entity.dxftype() in ("INSERT", "LWPOLYLINE", "POLYLINE"):
            for part in _exploded(entity.virtual_entities()):
                if entity.dxftype() != "INSERT":
                    part.dxf.layer = entity.dxf.layer
                elif part.dxf.layer == "0":  # what a block has on layer 0 is on the layer where it is inserted
                    part.dxf.layer = entity.dxf.layer
                part.place = f"{entity.dxftype()} {entity.dxf.handle} on layer {part.dxf.layer!r}"
                yield part
        else:
            entity.place = f"{entity.dxftype()} {entity.dxf.handle} on layer {entity.dxf.layer!r}"
            yield entity


def _strokes_of(entity: Any, scale: float, tolerance: float | None, here: str) -> list[Stroke]:
    """The strokes of an entity of a DXF file; see `read_drawing` for errors."""
    kind, name, place = entity.dxftype(), entity.dxf.layer, entity.place
    if kind not in LINES:
        raise ValueError(f"{here}: {place} is no line, arc, polyline, circle, ellipse or spline; name another layer")
    up = np.array(entity.dxf.extrusion if entity.dxf.hasattr("extrusion") else (0, 0, 1), dtype=float)
    if kind != "LINE" and np.hypot(*up[:2]) > 1e-9:
        raise ValueError(f"{here}: {place} is not in the plane of x and y")
    bulges: list[float]
    if kind == "LINE":
        points, bulges = [entity.dxf.start, entity.dxf.end], [0.0]
    elif kind == "ARC" and (angle := math.radians((entity.dxf.end_angle - entity.dxf.start_angle) % 360)) > 1e-9:
        points = [entity.start_point, entity.end_point]
        bulges = [math.copysign(math.tan(angle / 4), up[2])]
    elif kind in ("ARC", "CIRCLE"):
        centre, radius = np.array(entity.ocs().to_wcs(entity.dxf.center)), entity.dxf.radius
        points = [centre + [radius, 0, 0], centre - [radius, 0, 0], centre + [radius, 0, 0]]
        bulges = [1.0, 1.0]
    else:
        if tolerance is None:  # relative to the curve's own size
            rough = np.array([tuple(point) for point in entity.flattening(1e9)])
            tolerance = FLAT * scale * float(np.ptp(rough, axis=0).max())
        points = list(entity.flattening(tolerance / scale))
        bulges = [0.0] * (len(points) - 1)
    x = np.array([tuple(point) for point in points], dtype=float)
    if np.ptp(x[:, 2]) > 1e-6 * np.ptp(x[:, :2]):
        raise ValueError(f"{here}: {place} is not in a plane of constant z; the drawing must be 2-D")
    x = x[:, :2] * scale
    return [Stroke(a, b, bulge, name, place) for a, b, bulge in zip(x[:-1], x[1:], bulges, strict=True)]


def _svg(
    path: Path, chosen: Sequence[str] | None, scale: float | None, tolerance: float | None, here: str
) -> list[Stroke]:
    """The strokes of an SVG file [m], with y upwards."""
    try:
        from svgpathtools import Document
    except ImportError:
        raise ValueError(f"{here}: SVG files take svgpathtools: pip install 'tipfem[drawings]'") from None
    if scale is None:
        raise ValueError(f"{here}: give scale, the length of one unit of the file in m, as 1e-3 where a unit is a mm")
    try:
        document = Document(str(path))
        paths = document.paths()
    except Exception as error:
        raise ValueError(f"{here}: svgpathtools cannot read it: {error}") from error
    around = {child: parent for parent in document.tree.iter() for child in parent}
    if any(element.tag.endswith("}use") for element in document.tree.iter()):
        raise ValueError(f"{here}: it has clones (the element use), which are not read; unlink them in the editor")
    names = []
    for k, each in enumerate(paths):
        element, own = each.element, []
        while element is not None:
            own += [value for key, value in element.items() if key == "id" or key.endswith("}label")]
            element = around.get(element)
        names.append(own or [f"path{k}"])
    _require_known(chosen, (name for own in names for name in own), "element, group or layer", here)
    strokes = []
    for each, own in zip(paths, names, strict=True):
        if chosen is not None and not set(chosen) & set(own):
            continue
        kind = each.element.tag.rpartition("}")[2]
        place = f"{kind} {own[0]!r}"
        size = max((abs(segment.end - segment.start) for segment in each), default=0.0)
        flat = FLAT * size if tolerance is None else tolerance / scale
        for segment in each:
            if abs(segment.end - segment.start) > 0:
                strokes += _strokes_of_segment(segment, flat, scale, own[0], place)
    if not strokes:
        raise ValueError(f"{here}: there are no paths in it")
    return strokes


def _strokes_of_segment(segment: Any, flat: float, scale: float, name: str, place: str) -> list[Stroke]:
    """The strokes of a segment of svgpathtools; circular arcs stay arcs, other curves become chords."""
    kind, bulge, count = type(segment).__name__, 0.0, 1
    if kind == "Arc" and abs(segment.radius.real - segment.radius.imag) < 1e-9 * segment.radius.real:
        bulge = -math.tan(math.radians(segment.delta) / 4)  # y is downwards in the file
    elif kind == "Arc":
        count = math.ceil(math.radians(abs(segment.delta)) * math.sqrt(max(abs(segment.radius), 1e-300) / (8 * flat)))
    elif kind != "Line":
        control = np.array(segment.bpoints())
        bend = (len(control) - 1) * (len(control) - 2) * float(np.abs(np.diff(control, 2)).max(initial=0.0))
        count = math.ceil(math.sqrt(bend / (8 * flat)))
    points = [segment.start, *(segment.point(k / count) for k in range(1, count)), segment.end]
    x = scale * np.array([[point.real, 0.0 - point.imag] for point in points])
    return [Stroke(a, b, bulge, name, place) for a, b in itertools.pairwise(x)]


def _loops(strokes: Sequence[Stroke], here: str) -> list[list[Stroke]]:
    """The strokes of each closed outline, in turn, with ends that are exactly the same."""
    ends = np.array([end for stroke in strokes for end in (stroke.start, stroke.end)])
    if not np.isfinite(ends).all():
        raise ValueError(f"{here}: {strokes[int(np.argmin(np.isfinite(ends).all(axis=1))) // 2].place} is not finite")
    size = float(np.ptp(ends, axis=0).max())
    tree = cKDTree(ends)
    corner = np.array([min(near) for near in tree.query_ball_point(ends, JOIN * size)]).reshape(-1, 2)
    at: dict[int, list[int]] = {}
    for k, (one, other) in enumerate(corner.tolist()):
        if one != other:  # else it is shorter than what joins two ends
            at.setdefault(one, []).append(k)
            at.setdefault(other, []).append(k)
    for i, meet in at.items():
        if len(meet) == 1:
            stroke, others = strokes[meet[0]], np.delete(np.arange(len(ends)), [2 * meet[0], 2 * meet[0] + 1])
            gap = np.linalg.norm(ends[others] - ends[i], axis=1).min(initial=math.inf)
            text = f"{here}: {stroke.place} ends at {rounded(ends[i])} m, {gap:.3g} m off the nearest other line; "
            raise ValueError(f"{text}an outline must be closed")
        if len(meet) > 2:
            places = " and ".join(dict.fromkeys(strokes[k].place for k in meet))
            text = f"{here}: {len(meet)} lines meet at {rounded(ends[i])} m, of {places}; an outline passes a point "
            raise ValueError(f"{text}once: erase lines drawn twice, or name the layer of the outline")
    result, left = [], dict.fromkeys(k for meet in at.values() for k in meet)
    while left:
        k = next(iter(left))
        here_corner, loop = int(corner[k, 0]), []
        while k in left:
            del left[k]
            forth = corner[k, 0] == here_corner
            one, other = corner[k] if forth else corner[k, ::-1]
            turned = strokes[k].bulge if forth else -strokes[k].bulge
            loop.append(replace(strokes[k], start=ends[one], end=ends[other], bulge=turned))
            here_corner = int(other)
            k = next((each for each in at[here_corner] if each in left), -1)
        result.append(loop)
    return result


def _pieces(loop: Sequence[Stroke]) -> tuple[Piece, ...]:
    """A closed outline as pieces of a shape."""
    return tuple(
        piece for stroke in loop for piece in pieces_between(stroke.start, stroke.end, stroke.arc, stroke.name)
    )
