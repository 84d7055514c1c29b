"""From the checked tables of a case file to the objects of `tipfem` that they describe."""

from __future__ import annotations

import copy
import math
import zipfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path as FilePath
from typing import Any, TypeVar

import numpy as np

from tipfem.arguments import meant
from tipfem.case.case import DEFAULT_INTERFACE, Case, contradictions
from tipfem.case.declaration import made
from tipfem.case.fluid import Fluid
from tipfem.case.grading import Grading
from tipfem.case.memory import too_many
from tipfem.case.mesh_file import MeshTank, read_mesh
from tipfem.case.numerics import Numerics
from tipfem.case.particles import Particles
from tipfem.case.rheology import law_from
from tipfem.case.surface_tension import Pair, TensionTable
from tipfem.case.tank import Tank
from tipfem.case.walls import Motion
from tipfem.casefile.fills import shape_of, shapes_of
from tipfem.casefile.forms import FORMS, VECTORS, Limits, Model, Polyline, Ramp, Table, Uniform, WaveForm
from tipfem.casefile.lists import Listed, Place
from tipfem.casefile.outlines import ShapeTable
from tipfem.casefile.pairs import by_pairs
from tipfem.casefile.problems import listed
from tipfem.casefile.registry import LISTED
from tipfem.casefile.schema import FillTable, TankTable
from tipfem.casefile.source import Path
from tipfem.casefile.times import check_times
from tipfem.errors import Invalid
from tipfem.geometry import solids
from tipfem.geometry.box_sides import sides_of
from tipfem.geometry.plane.shapes import Shape
from tipfem.geometry.solids import Solid
from tipfem.probes import KINDS, Probe

Report = Callable[[Path, str], None]
T = TypeVar("T")


class Parts:
    """The parts of a case, as far as their tables have no mistakes; ``report`` takes those that they make together.

    ``sections`` of the case file are checked; those that are missing or None have mistakes. Paths are relative to
    ``folder``.
    """

    def __init__(self, sections: Mapping[str, Any], folder: FilePath, report: Report) -> None:
        self.sections, self.folder, self.report = sections, folder, report
        self.fluids = {
            name: self._made(("fluids", name), Fluid, name, table.density, self._viscosity(name, table.viscosity))
            for name, table in (sections.get("fluids") or {}).items()
            if table is not None
        }
        self.fluid_names = list(sections.get("fluids") or {})
        self.end = sections["time"].end if sections.get("time") else None
        self._particles = self._read_particles()
        self._shape: Shape | Solid | None = None
        self._mesh: MeshTank | None = None
        self.tank, self.dimension = self._tank()
        self._blocks = self._read_blocks()
        self.interface = sections.get("interface") or DEFAULT_INTERFACE
        self.sides = self._sides()
        self._fill()
        tank, particles = (sections.get(key) is not None for key in ("tank", "particles"))
        place = Place(self.dimension, tank, particles, isinstance(self._shape, Shape), self.sides)
        self.lists: dict[str, list[Any]] = {}
        for each in LISTED:
            self.lists[each.attribute] = [
                one for key in each.kinds for one in self._items(key, partial(each.made, key, place))
            ]
            if self._is_whole(each):
                self._made((), each.check, self.lists[each.attribute], bool(sections.get("free_surface")))
        self.motion = self._motion()
        self.grading = self._grading()
        self.tension = self._tension()
        table = sections.get("numerics")
        self.numerics: Numerics | None = table and self._made(("numerics",), made, Numerics, table.model_dump())
        self._check_choices()
        self.force = self._force()
        self.probes = self._probes()
        self._check_names()
        check_times(sections, report)

    def _viscosity(self, name: str, given: Any) -> Any:
        """The viscosity of a fluid, or the law that a table of it describes."""
        if not isinstance(given, Model):
            return given
        return self._made(("fluids", name, "viscosity"), law_from, given.model_dump())

    def case(self) -> Case:
        """A new case; `ValueError` if the parts do not fit together."""
        tank = self._new_tank() if self.tank else None
        particles = tank or self._particles
        if particles is None:
            raise ValueError("the case file has mistakes; no case can be made of it")
        lists: Any = {
            each.attribute: each.into(tank, self.lists[each.attribute]) if tank else self.lists[each.attribute]
            for each in LISTED
        }
        return Case(
            particles,
            list(self.fluids.values()),
            self.sections["gravity"],
            body_force=self.force,
            interface=self.sections.get("interface"),
            free_surface=self.sections["free_surface"],
            numerics=self.numerics or Numerics(),
            title=self.sections["title"],
            tank_motion=self.motion,
            grading=self.grading,
            surface_tension=self.tension,
            **lists,
        )

    def place_of(self, error: ValueError, around: Path = ()) -> tuple[Path, str]:
        """The path in the file that an error of an object made of the table at ``around`` is about, and the fault."""
        if not isinstance(error, Invalid):
            return around, f": {error}"
        path = error.path
        if around and path[:1] == around[:1]:
            return (*around, *path[len(around) :]), error.text
        if around:
            return (*around, *path), error.text
        items = self.sections.get(str(path[0])) if path else None
        if isinstance(items, list) and len(path) > 1 and isinstance(path[1], str):  # an item by its name
            name = next((each.name for each in LISTED if path[0] in each.kinds), lambda _, table: table.name)
            names = [name(str(path[0]), table) for table in items if table is not None]
            path = (path[0], *(() if path[1] not in names else (names.index(path[1]), *path[2:])))
        return path, error.text

    def _made(self, path: Path, make: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        """Result of a function on further arguments; its ValueError is reported, and the result None."""
        try:
            return make(*arguments, **options)
        except ValueError as error:
            self.report(*self.place_of(error, path))
            return None

    def _tank(self) -> tuple[Tank | None, int | None]:
        """The tank, empty, and the dimension; None where they have mistakes."""
        tank, particles = self.sections.get("tank"), self.sections.get("particles")
        if "tank" in self.sections and "particles" in self.sections:
            if tank is None and particles is None:
                text = "is missing; give a tank with size or shape and spacing, or particles with a file"
                self.report(("tank",), text)
            if tank is not None and particles is not None:
                self.report(("particles",), "is given beside tank; give one of the two")
        gravity = self.sections.get("gravity")
        if tank is None:
            dimension = self._particles.dimension if self._particles else len(gravity) if gravity else None
        else:
            in_space = tank.surface is not None or tank.corners is not None
            dimension = len(tank.size) if tank.size is not None else 3 if in_space else 2
            given = [
                name for name in ("size", "shape", "corners", "surface", "mesh") if getattr(tank, name) is not None
            ]
            if len(given) != 1:
                has = f"has both {' and '.join(given)}" if given else "has neither size nor shape"
                text = "give a box its size, a tank in 2-D its shape or its mesh, one in 3-D its corners or its surface"
                self.report(("tank",), f"{has}; {text}")
                return None, dimension
            if tank.scale != 1.0 and tank.mesh is None and tank.surface is None:
                self.report(("tank", "scale"), "is given without a mesh or a surface, whose coordinates it multiplies")
            if tank.mesh is not None:
                self._mesh = self._read_mesh(tank)
                if self._mesh is None:
                    return None, dimension
            elif tank.size is None:
                if tank.periodic is not None:
                    text = f"is given with a {given[0]}, which has walls all around; leave it out"
                    self.report(("tank", "periodic"), text)
                self._shape = self._read_shape(tank)
                if self._shape is None:
                    return None, dimension
        if gravity and dimension and len(gravity) != dimension:
            why = f"is {gravity} m/s^2; it must be {dimension} numbers, for the case is {dimension}-D"
            self.report(("gravity",), why)
        if tank is not None:
            if self._mesh is not None:
                assert self._mesh.domain is not None
                size, content = self._mesh.size.tolist(), self._mesh.domain.area
            else:
                size = tank.size if self._shape is None else np.ptp(self._shape.box, axis=0).tolist()
                content = math.prod(size)
                if self._shape is not None:
                    content = self._shape.whole if isinstance(self._shape, Solid) else self._shape.area
            graded = self.sections.get("grading") is not None
            if wrong := too_many(content, tank.spacing, len(size), graded=graded):
                self.report(("tank", "spacing"), wrong)
                return None, dimension
        return (self._made(("tank",), self._new_empty_tank) if tank else None), dimension

    def _read_shape(self, tank: TankTable) -> Any:
        """The shape or the solid of a tank that is no box; None with a mistake."""
        if tank.shape is not None:
            return self._made(("tank", "shape"), tank.shape.shape, self.folder)
        if tank.corners is not None:
            return self._made(("tank", "corners"), solids.hull, tank.corners)
        assert tank.surface is not None
        try:
            return solids.read(self.folder / tank.surface, scale=tank.scale)
        except (OSError, ValueError) as error:
            self.report(("tank", "surface"), f": {error}")
        return None

    def _read_blocks(self) -> dict[str, list[list[float]]]:
        """The boxes taken out of the tank, by their names, and out of `tank`."""
        tables = self.sections.get("blocks") or {}
        if tables and self.sections.get("tank") is None and self.sections.get("particles") is not None:
            self.report(("blocks",), "is given with particles; blocks are taken out of a tank")
        found = {}
        for name, table in tables.items():
            if table is not None and self.tank is not None:
                done = self._made(("blocks", name), self.tank.block, name, table.box)
                found.update({name: table.box} if done else {})
        return found

    def _read_mesh(self, tank: TankTable) -> MeshTank | None:
        """The tank that a mesh file is; None with a mistake."""
        for key in ("jitter", "seed", "periodic", "coordinates"):
            if getattr(tank, key) not in (0, None, "planar"):
                self.report(("tank", key), "is given with a mesh, whose points are the particles; leave it out")
        assert tank.mesh is not None
        try:
            return read_mesh(self.folder / tank.mesh, tank.spacing, scale=tank.scale)
        except Invalid as error:
            self.report(*self.place_of(error, ("tank",)))
        except ValueError as error:
            self.report(("tank", "mesh"), f": {error}")
        return None

    def _sides(self) -> list[str] | None:
        """Names of the walls of the tank; None where there is none, or it has mistakes."""
        tank = self.sections.get("tank")
        if tank is None or (tank.size is None and self._shape is None and self._mesh is None):
            return None
        if self._mesh is not None:
            return list(self._mesh.sides)
        if self._shape is not None:
            return list(self._shape.sides)
        if self._blocks and self.tank is not None:
            return list(self.tank.sides)
        axes = [k for k in range(self.dimension or 3) if "xyz"[k] not in (tank.periodic or "")]
        return sides_of(axes, tank.coordinates)

    def _new_empty_tank(self) -> Tank:
        tank = self.sections["tank"]
        if self._mesh is not None:
            return copy.deepcopy(self._mesh)
        return Tank(tank.size, tank.spacing, tank.jitter, tank.seed, tank.periodic, self._shape, tank.coordinates)

    def _new_tank(self) -> Tank:
        """The tank, filled; see `_fill` for what is refused."""
        tank = self._new_empty_tank()
        for name, box in self._blocks.items():
            tank.block(name, box)
        for table in self.sections["fill"]:
            tank.fill(self.fluids[table.fluid], velocity=table.velocity, **shape_of(table, self.folder))
        return tank

    def _fill(self) -> None:
        fills = self.sections.get("fill")
        if fills is None:
            return
        if self.sections.get("particles") is not None and self.sections.get("tank") is None:
            if fills:
                self.report(("fill",), "is given with particles; only a tank is filled")
            return
        tank = self.sections.get("tank")
        if tank is not None and tank.mesh is not None:
            if fills:
                text = "is given with a mesh, whose surfaces are named after the fluids that fill them; leave it out"
                self.report(("fill",), text)
            return
        if self.sections.get("tank") is not None and not fills:
            self.report(("fill",), "is missing; give at least one table [[fill]] with a fluid")
        if self.sections.get("free_surface") is False and fills and fills[0] is not None and shapes_of(fills[0]):
            self.report(("fill", 0), "has a shape; the first fill must take the whole tank, or set free_surface = true")
        for k, table in enumerate(fills):
            if table is None:
                continue
            path: Path = ("fill", k)
            if len(given := shapes_of(table)) > 1:
                self.report(path, f"has {', '.join(given)}; give one shape, in tables [[fill]] of their own")
            elif self.dimension and self._fits(path, table) and self.tank:
                part = shape_of(table, self.folder)
                self._made(path, self._new_empty_tank().fill, Fluid(table.fluid or "?", 1.0, 0.0), **part)

    def _fits(self, path: Path, table: FillTable) -> bool:
        """Whether a fill's shape has the right dimension, and curves make sense."""
        d, fits = self.dimension, True
        if table.half_space:
            for key in ("point", "normal"):
                value = getattr(table.half_space, key)
                if len(value) != d:
                    self.report((*path, "half_space", key), f"is {value}; it must be {d} numbers, as the tank is {d}-D")
                    fits = False
            if not any(table.half_space.normal):
                self.report((*path, "half_space", "normal"), "is zero; it must be a direction")
                fits = False
        for key in ("shape", "polygon"):
            if getattr(table, key) and d != 2:
                self.report((*path, key), f"is given in 3-D; {key}s are for 2-D only")
                fits = False
        if table.shape and d == 2:
            fits = self._made((*path, "shape"), table.shape.shape, self.folder) is not None and fits
        for key in ("below", "above"):
            curve = getattr(table, key)
            if isinstance(curve, Polyline) and (np.diff([point[0] for point in curve.points]) <= 0).any():
                self.report((*path, key, "points"), f"is {curve.points} m; x must ascend from point to point")
                fits = False
        return fits

    def _given(self, path: Path, table: Model) -> dict[str, Any] | None:
        """The keys that a table has, with their values as objects take them; None where one of these has a mistake."""
        given = {key: self._value((*path, key), value) for key, value in table.given().items()}
        return None if any(value is None for value in given.values()) else given

    def _value(self, path: Path, value: Any) -> Any:
        """A value as an object takes it: a function of time checked, a table made; None where it has a mistake."""
        if isinstance(value, (*FORMS.values(), WaveForm)):
            return self._function(path, value, self.dimension if path[-1] in VECTORS else 0)
        if isinstance(value, ShapeTable):
            return self._made(path, value.shape, self.folder)
        if isinstance(value, Model) and value.kind is not None:
            given = self._given(path, value)
            return None if given is None else self._made(path, value.kind, **given)
        return value

    def _items(self, kind: str, make: Callable[..., T]) -> list[T]:
        """Objects that the tables of a list, or by names, describe, those without mistakes."""
        found, tables = [], self.sections.get(kind) or []
        for k, table in tables.items() if isinstance(tables, Mapping) else enumerate(tables):
            given = None if table is None else self._given((kind, k), table)
            if given is not None:
                name = {"name": k} if isinstance(k, str) else {}
                one = self._made((kind, k), make, **name, **given)
                found += [] if one is None else [one]
        return found

    def _is_whole(self, each: Listed) -> bool:
        """Whether all tables of lists could be made."""
        return len(self.lists[each.attribute]) == sum(len(self.sections.get(key, [None])) for key in each.kinds)

    def _check_names(self) -> None:
        """Report the names in tables that are those of no fluid, no wall, and none of the lists."""
        known, tank = {"fluid": self.fluid_names}, self.sections.get("tank")
        for each in LISTED:
            if each.key and self._is_whole(each):
                known[each.key] = [one.name for one in self.lists[each.attribute]]
        for section in ("fill", *(key for each in LISTED for key in each.kinds), "probes"):
            if self.sides is not None:
                more = [*self._blocks, *(wall.name for wall in self.lists["walls"])] if section == "probes" else []
                known["wall"] = self.sides + more
            for k, table in enumerate(self.sections.get(section) or ()):
                for key, names in known.items():
                    if key == "wall" and section != "probes" and tank is not None and tank.periodic is not None:
                        continue  # which none of the lists goes with
                    found = getattr(table, key, None)
                    several = getattr(found, f"{key}s", None)
                    path = (key,) if several is None else (key, f"{key}s")
                    for name in [found] if several is None else several:
                        if isinstance(name, str) and name and name not in names:
                            there = listed(names) or "(there is none)"
                            why = f"is {name!r}; it must be one of the {key}s {there}{meant(name, names)}"
                            self.report((section, k, *path), why)

    def _function(self, path: Path, function: Any, size: int | None) -> Any:
        """A function of time, checked, its table read, ``size`` coordinates, 0 for a number; None if wrong."""
        if function is None:
            return None
        if isinstance(function, Ramp) and function.end_time <= function.start_time:
            self.report(
                (*path, "end_time"),
                f"is {function.end_time} s; it must be later than start_time, {function.start_time} s",
            )
            return None
        if isinstance(function, WaveForm):
            return self._made(path, function.made)
        if isinstance(function, Table):
            function = self._read_table(path, function)
            if function is None:
                return None
        for key, found in function.sizes():
            if size is not None and found != size:
                wanted = f"{size} numbers" if size else "a number alone"
                self.report((*path, key), f"has values of {found or 1} number(s); it must be {wanted}")
                return None
        return function

    def _read_table(self, path: Path, table: Table) -> Table | None:
        if (table.file is None) == (table.times is None) or (table.times is None) != (table.values is None):
            self.report(path, "has neither a file nor times and values, or both; give one of them")
            return None
        try:
            table = table.read(self.folder)
        except ValueError as error:
            self.report((*path, "file"), f"is {table.file!r}: {error}")
            return None
        times, values, key = table.times or [], table.values or [], "times" if table.file is None else "file"
        if len(times) != len(values):
            self.report((*path, "values"), f"has {len(values)} items for {len(times)} times; give one for each")
            return None
        falls = np.flatnonzero(np.diff(times) <= 0)
        if len(falls):
            k = int(falls[0]) + 1
            self.report((*path, key), f"has the time {times[k]} s after {times[k - 1]} s; times must ascend")
            return None
        slack = 1e-9 * (times[-1] - times[0])  # round-off
        if times[0] > slack or (self.end is not None and times[-1] < self.end - slack):
            wanted = f"from 0 to {self.end} s, the end of the run" if self.end is not None else "from 0"
            late = f"; start_time = {times[0]} would let the run begin there" if times[0] > 0 else ""
            self.report((*path, key), f"has times from {times[0]} to {times[-1]} s; it must go {wanted}{late}")
            return None
        return table

    def _motion(self) -> Motion | None:
        if self.dimension is None or self.sections.get("tank_motion") is None:
            return None
        motion: Motion | None = self._value(("tank_motion",), self.sections["tank_motion"])
        if motion is not None:
            self._made(("tank_motion",), motion.check, self.dimension)
        return motion

    def _grading(self) -> Grading | None:
        table, tank = self.sections.get("grading"), self.sections.get("tank")
        if table is None:
            return None
        film = table.film_resolution
        if not table.largest and not table.limits and film is None:
            text = "has neither largest nor limits nor film_resolution; give one of them, or leave the table out"
            self.report(("grading",), text)
            return None
        for k, limit in enumerate(table.limits):
            box = np.array(limit.box) if len({len(corner) for corner in limit.box}) == 1 else None
            if box is None or (self.dimension and box.shape != (2, self.dimension)) or not (box[0] < box[1]).all():
                what = "two corners, the lower one first"
                self.report(("grading", "limits", k, "box"), f"is {limit.box} m; it must be {what}")
                return None
        where = Limits(limits=table.limits) if table.limits else None
        grading: Grading | None = self._made(("grading",), Grading, table.largest, table.growth, where, film)
        for name, value in table.largest.items():
            path: Path = ("grading", "largest", name)
            if name not in self.fluid_names:
                names = self.fluid_names
                self.report(path, f"is of no fluid; the fluids are {listed(names)}{meant(name, names)}")
            elif tank is not None and value < tank.spacing * (1 - 1e-9):
                self.report(path, f"is {value} m; it must be at least the tank's spacing, {tank.spacing} m")
        return grading

    def _tension(self) -> dict[Pair, float]:
        """Surface tension by interface, checked with the contact angles of all walls."""
        given = by_pairs(self.sections.get("surface_tension") or {})
        fluids, free = [Fluid(name, 1.0, 0.0) for name in self.fluid_names], bool(self.sections.get("free_surface"))
        right = [self._made((), TensionTable, {pair: value}, fluids, empty=free) for pair, value in given.items()]
        if None not in right and (whole := self._made((), TensionTable, given, fluids, empty=free)) is not None:
            for one in (one for ones in self.lists.values() for one in ones if hasattr(one, "contact_angle")):
                self._made((), whole.cosines, one, one.path[0])
            return given
        return {}  # it has mistakes

    def _force(self) -> Uniform | None:
        function = self._function(("body_force",), self.sections.get("body_force"), self.dimension)
        return None if function is None else Uniform(function)

    def _probes(self) -> list[Probe]:
        probes: dict[str, Probe] = {}
        for k, table in enumerate(self.sections.get("probes") or ()):
            if table is None:
                continue
            path: Path = ("probes", k)
            given = table.given()
            if table.name in probes:
                self.report((*path, "name"), f"is {table.name!r}, the name of an earlier probe; give another")
            probe = self._made(path, KINDS[given.pop("type")], **given)
            if probe is not None:
                probes[table.name] = probe
        return list(probes.values())

    def _check_choices(self) -> None:
        """Check the tables for interface, free surface, grading and tank for contradictions."""
        for path, text in contradictions(
            self.interface,
            free_surface=bool(self.sections.get("free_surface")),
            pressure=self.numerics.pressure if self.numerics else "auto",
            graded=self.sections.get("grading") is not None,
            dimension=self.dimension,
            tension=self.tension,
        ):
            self.report(tuple(path.split(".")), text)
        tank = self.sections.get("tank")
        if tank is not None and self.dimension == 3 and tank.jitter == 0:
            self.report(("tank", "jitter"), "is 0 in 3-D; it must be > 0 there, 0.1 for instance")

    def _read_particles(self) -> Particles | None:
        table = self.sections.get("particles")
        if table is None or self.sections.get("tank") is not None:
            return None
        path = self.folder / table.file
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = dict(file)
        except (OSError, ValueError, EOFError, zipfile.BadZipFile, AttributeError, TypeError) as error:
            reason = getattr(error, "strerror", None) or "it is no NPZ file"
            self.report(("particles", "file"), f"is {table.file!r}, which cannot be read ({reason})")
            return None
        needed, more = ("position", "fluid", "wall"), ("velocity", "acceleration", "pressure", "spacing")
        missing = [name for name in needed if name not in arrays]
        unknown = [name for name in arrays if name not in needed + more]
        if missing or unknown:
            what = f"lacks the arrays {listed(missing)}" if missing else f"has unknown arrays {listed(unknown)}"
            self.report(("particles", "file"), f"is {table.file!r}, which {what}; it takes {listed(needed + more)}")
            return None
        if "spacing" in arrays and arrays["spacing"].shape == ():
            arrays["spacing"] = arrays["spacing"].item()
        particles: Particles | None = self._made(("particles", "file"), Particles, **arrays)
        return particles
