"""From the checked tables of a case file to the objects of `tipfem` that they describe."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from tipfem.case.beaches import Beach
from tipfem.case.body import Body
from tipfem.case.case import Case, contradictions, default_interface
from tipfem.case.declaration import made
from tipfem.case.fluid import Fluid
from tipfem.case.grading import Grading
from tipfem.case.memory import too_many
from tipfem.case.numerics import Numerics
from tipfem.case.particles import Particles
from tipfem.case.surface_tension import Pair, TensionTable
from tipfem.case.tank import Tank
from tipfem.case.walls import Motion, Wall
from tipfem.casefile.bodies import read_bodies
from tipfem.casefile.fills import shape_of, shapes_of
from tipfem.casefile.forms import Constant, Limits, Polyline, Ramp, Table, UniformForce, WaveForm
from tipfem.casefile.openings import opening_name, read_openings
from tipfem.casefile.problems import cannot, listed, meant
from tipfem.casefile.schema import FillTable, MotionTable, WallTable
from tipfem.casefile.source import Path
from tipfem.casefile.times import check_times
from tipfem.errors import Invalid
from tipfem.geometry.box_points import SIDES
from tipfem.geometry.shapes import Shape
from tipfem.probes import KINDS, Probe

Report = Callable[[Path, str], None]


class Parts:
    """The parts of a case, as far as their tables have no mistakes; mistakes that they make together are reported.

    Args:
        sections: of the case file, checked; those that are missing or None have mistakes.
        folder: that paths are relative to.
        report: takes the path of a mistake and what is wrong.
    """

    def __init__(self, sections: Mapping[str, Any], folder: FilePath, report: Report) -> None:
        self.sections, self.folder, self.report = sections, folder, report
        self.fluids = {
            name: self._made(("fluids", name), Fluid, name, table.density, table.viscosity)
            for name, table in (sections.get("fluids") or {}).items()
            if table is not None
        }
        self.fluid_names = list(sections.get("fluids") or {})
        self.end = sections["time"].end if sections.get("time") else None
        self._particles = self._read_particles()
        self._shape: Shape | None = None
        self.tank, self.dimension = self._tank()
        default = default_interface(bool(sections.get("free_surface")), self.dimension)
        self.interface = sections.get("interface") or default
        self._fill()
        self.bodies = self._bodies()
        self.walls = self._walls()
        self.openings = read_openings(sections, self.fluid_names, self._function, self._made, report)
        tables = sections.get("beaches") or []
        made_beaches = (self._made(("beaches", k), lambda t=t: Beach(**t.given())) for k, t in enumerate(tables) if t)
        self.beaches: list[Beach] = [beach for beach in made_beaches if beach is not None]
        self.motion = self._motion()
        self.grading = self._grading()
        self.tension = self._tension()
        table = sections.get("numerics")
        self.numerics: Numerics | None = table and self._made(("numerics",), made, Numerics, table.model_dump())
        self._check_choices()
        self.force = self._force()
        self.probes = self._probes()
        check_times(sections, report)

    def case(self) -> Case:
        """A new case.

        Raises:
            ValueError: the parts do not fit together.
        """
        particles = self._new_tank() if self.tank else self._particles
        if particles is None:
            raise ValueError("the case file has mistakes; there is no case to be made of it")
        return Case(
            particles,
            list(self.fluids.values()),
            self.sections["gravity"],
            body_force=self.force,
            interface=self.sections.get("interface"),
            free_surface=self.sections["free_surface"],
            numerics=self.numerics or Numerics(),
            title=self.sections["title"],
            walls=self.walls,
            tank_motion=self.motion,
            grading=self.grading,
            surface_tension=self.tension,
            openings=self.openings,
            beaches=self.beaches,
        )

    def place_of(self, error: ValueError, around: Path = ()) -> tuple[Path, str]:
        """The path in the file that an error is about, and what is wrong there.

        Args:
            error: of an object that is made of the file.
            around: the path of the table that it is made of; empty for the whole case.
        """
        if not isinstance(error, Invalid):
            return around, f": {error}"
        path = error.path
        if around and path[:1] == around[:1]:
            return (*around, *path[len(around) :]), error.text
        if around:
            return (*around, *path), error.text
        items = self.sections.get(str(path[0])) if path else None
        if isinstance(items, list) and len(path) > 1 and isinstance(path[1], str):  # an item by its name
            names = [opening_name(str(path[0]), t) or getattr(t, "name", "") or t.wall for t in items if t is not None]
            path = (path[0], *(() if path[1] not in names else (names.index(path[1]), *path[2:])))
        return path, error.text

    def _made(self, path: Path, make: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        """What a function makes of further arguments; its ValueError is reported, and None made."""
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
                self.report(
                    ("tank",), "is missing; give a tank with size or shape and spacing, or particles with a file"
                )
            if tank is not None and particles is not None:
                self.report(("particles",), "is given beside tank; give one of the two")
        gravity = self.sections.get("gravity")
        if tank is None:
            dimension = self._particles.dimension if self._particles else len(gravity) if gravity else None
        else:
            dimension = 2 if tank.size is None else len(tank.size)
            if (tank.size is None) == (tank.shape is None):
                given = "has neither size nor shape" if tank.size is None else "has both size and shape"
                self.report(("tank",), f"{given}; give a box its size, or a tank in 2-D its shape")
                return None, dimension
            if tank.shape is not None:
                if tank.periodic is not None:
                    self.report(("tank", "periodic"), "is given with a shape, which has walls all around; leave it out")
                self._shape = self._made(("tank", "shape"), tank.shape.shape)
                if self._shape is None:
                    return None, dimension
        if gravity and dimension and len(gravity) != dimension:
            why = f"is {gravity} m/s^2; it must be {dimension} numbers, for the case is {dimension}-D"
            self.report(("gravity",), why)
        if tank is not None:
            size = tank.size if self._shape is None else np.ptp(self._shape.box, axis=0).tolist()
            content = math.prod(size) if self._shape is None else self._shape.area
            graded = self.sections.get("grading") is not None
            if wrong := too_many(content, tank.spacing, len(size), graded=graded):
                self.report(("tank", "spacing"), wrong)
                return None, dimension
        return (self._made(("tank",), self._new_empty_tank) if tank else None), dimension

    def _new_empty_tank(self) -> Tank:
        tank = self.sections["tank"]
        return Tank(tank.size, tank.spacing, tank.jitter, tank.seed, tank.periodic, self._shape)

    def _new_tank(self) -> Tank:
        """The tank, filled; see `_fill` for what is refused."""
        tank = self._new_empty_tank()
        for table in self.sections["fill"]:
            tank.fill(self.fluids[table.fluid], velocity=table.velocity, **shape_of(table))
        for body in self.bodies:
            tank.add(body)
        for name, table in self.sections["walls"].items():
            if table.between is None and table.particles is None:
                tank.wall(name, **self._wall_options(name, table))
        return tank

    def _bodies(self) -> list[Body]:
        tables = self.sections.get("bodies") or []
        if tables and (self.dimension == 3 or self.sections.get("particles") is not None):
            self.report(("bodies",), "is given, but bodies are for tanks in 2-D only")
            return []
        return read_bodies(tables, self._function, self.report, self.place_of)

    def _fill(self) -> None:
        fills = self.sections.get("fill")
        if fills is None:
            return
        if self.sections.get("particles") is not None and self.sections.get("tank") is None:
            if fills:
                self.report(("fill",), "is given with particles; only a tank is filled")
            return
        if self.sections.get("tank") is not None and not fills:
            self.report(("fill",), "is missing; give at least one table [[fill]] with a fluid")
        if self.sections.get("free_surface") is False and fills and fills[0] is not None and shapes_of(fills[0]):
            self.report(("fill", 0), "has a shape; the first fill must take the whole tank, or set free_surface = true")
        for k, table in enumerate(fills):
            if table is None:
                continue
            path: Path = ("fill", k)
            if table.fluid not in self.fluid_names:
                names = self.fluid_names
                self.report(
                    (*path, "fluid"),
                    f"is {table.fluid!r}; it must be one of the fluids {listed(names)}{meant(table.fluid, names)}",
                )
            if len(given := shapes_of(table)) > 1:
                self.report(path, f"has {', '.join(given)}; give one shape, in tables [[fill]] of their own")
            elif self.dimension and self._fits(path, table) and self.tank:
                self._made(path, self._new_empty_tank().fill, Fluid(table.fluid or "?", 1.0, 0.0), **shape_of(table))

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
        if table.shape and d != 2:
            self.report((*path, "shape"), "is given in 3-D; shapes are for 2-D only")
            fits = False
        elif table.shape:
            fits = self._made((*path, "shape"), table.shape.shape) is not None and fits
        if table.polygon and d != 2:
            self.report((*path, "polygon"), "is given in 3-D; polygons are for 2-D only")
            fits = False
        for key in ("below", "above"):
            curve = getattr(table, key)
            if isinstance(curve, Polyline) and (np.diff([point[0] for point in curve.points]) <= 0).any():
                self.report((*path, key, "points"), f"is {curve.points} m; x must ascend from point to point")
                fits = False
        return fits

    def _walls(self) -> list[Wall]:
        tables, tank = self.sections.get("walls"), self.sections.get("tank")
        walls = []
        ends = "" if tank is None else tank.periodic or ""
        sides = [n for n, (axis, _) in SIDES.items() if axis < (self.dimension or 3) and "xyz"[axis] not in ends]
        sides = sides if self._shape is None else list(self._shape.sides)
        for name, table in (tables or {}).items():
            path: Path = ("walls", name)
            if table is None:
                continue
            own = table.between is not None or table.particles is not None
            if not own and tank is not None and name not in sides:
                self.report(
                    path,
                    cannot(name)
                    or f"is no wall of the tank; it must be one of {', '.join(sides) or 'none'}, or have between, "
                    f"two points{meant(name, sides)}",
                )
                continue
            if not own and tank is None:
                if self.sections.get("particles") is not None:
                    self.report(path, "has neither between nor particles; without a tank, give the wall's place")
                continue
            options = self._wall_options(name, table)
            if not options:
                keys = "law, slip, slip_length, velocity, motion and contact_angle"
                self.report(path, f"has nothing to say; give one or more of {keys}, or leave the table out")
                continue
            place = {key: value for key in ("between", "particles") if (value := getattr(table, key)) is not None}
            wall = self._made(path, Wall, name, **(place or {"particles": []}), **options)
            if wall is not None and own:
                walls.append(wall)
            if wall is not None and self.dimension and self._sized(path, table):
                self._made((*path, "velocity"), wall.sliding, 0.0, self.dimension)
                self._made((*path, "motion"), wall.displacement, 0.0)
        return walls

    def _sized(self, path: Path, table: WallTable) -> bool:
        """Whether a wall's functions have as many coordinates as they must."""
        velocity = table.velocity
        if table.speed is not None:
            fits = self._shape is not None and velocity is None
            if not fits:
                why = "only a side of a shape has a speed" if velocity is None else "velocity is given, too"
                self.report((*path, "speed"), f"is {table.speed:g} m/s; {why}")
            return fits
        if isinstance(velocity, list):
            fits = len(velocity) == self.dimension
            if not fits:
                self.report((*path, "velocity"), f"is {velocity} m/s; it must be {self.dimension} numbers")
        else:
            fits = self._function((*path, "velocity"), velocity, self.dimension or 0) is not None or velocity is None
        motion = self._function((*path, "motion"), table.motion, 0)
        return fits and (motion is not None or table.motion is None)

    def _wall_options(self, name: str, table: WallTable) -> dict[str, Any]:
        options: dict[str, Any] = {"slip": True} if table.slip else {}
        if "slip" in table.model_fields_set:
            options["slip"] = table.slip
        for key in ("law", "slip_length", "velocity", "motion"):
            value = getattr(table, key)
            if value is not None:
                options[key] = self._loaded(value)
        if table.speed is not None:
            options["velocity"] = table.speed
        if table.contact_angle:
            options["contact_angle"] = _by_pairs(table.contact_angle)
        return options

    def _loaded(self, function: Any) -> Any:
        """A function of time, its table read, or waves; 0 where that cannot be, which is reported elsewhere."""
        try:
            if isinstance(function, Table):
                return function.read(self.folder)
            return function.made() if isinstance(function, WaveForm) else function
        except ValueError:
            return Constant(form="constant", value=0.0)

    def _function(self, path: Path, function: Any, size: int) -> Any:
        """A function of time, checked: its table read, its values of ``size`` coordinates; None with a mistake.

        Args:
            path: of it.
            function: as it is in the file, or None.
            size: how many coordinates its values have; 0 for a number alone.
        """
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
            if found != size:
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
        if times[0] > 0 or (self.end is not None and times[-1] < self.end):
            wanted = f"from 0 to {self.end} s, the end of the run" if self.end is not None else "from 0"
            self.report((*path, key), f"has times from {times[0]} to {times[-1]} s; it must go {wanted}")
            return None
        return table

    def _motion(self) -> Motion | None:
        table: MotionTable | None = self.sections.get("tank_motion")
        if table is None or self.dimension is None:
            return None
        path, d = ("tank_motion",), self.dimension
        given = {"translation": d, "angle": 0}
        functions = {key: self._function((*path, key), getattr(table, key), size) for key, size in given.items()}
        if any(functions[key] is None and getattr(table, key) is not None for key in given):
            return None

        def make() -> Motion:
            motion = Motion(functions["translation"], functions["angle"], table.pivot, tuple(table.axis))
            motion.check(d)
            return motion

        motion: Motion | None = self._made(path, make)
        return motion

    def _grading(self) -> Grading | None:
        table, tank = self.sections.get("grading"), self.sections.get("tank")
        if table is None:
            return None
        if not table.largest and not table.limits:
            self.report(("grading",), "has neither largest nor limits; give one of them, or leave the table out")
            return None
        for k, limit in enumerate(table.limits):
            box = np.array(limit.box) if len({len(corner) for corner in limit.box}) == 1 else None
            if box is None or (self.dimension and box.shape != (2, self.dimension)) or not (box[0] < box[1]).all():
                what = "two corners, the lower one first"
                self.report(("grading", "limits", k, "box"), f"is {limit.box} m; it must be {what}")
                return None
        where = Limits(limits=table.limits) if table.limits else None
        grading: Grading | None = self._made(("grading",), Grading, table.largest, table.growth, where)
        for name, value in table.largest.items():
            path: Path = ("grading", "largest", name)
            if name not in self.fluid_names:
                names = self.fluid_names
                self.report(path, f"is of no fluid; the fluids are {listed(names)}{meant(name, names)}")
            elif tank is not None and value < tank.spacing * (1 - 1e-9):
                self.report(path, f"is {value} m; it must be at least the tank's spacing, {tank.spacing} m")
        return grading

    def _tension(self) -> dict[Pair, float]:
        """Surface tension by interface."""
        given = _by_pairs(self.sections.get("surface_tension") or {})
        fluids, free = [Fluid(name, 1.0, 0.0) for name in self.fluid_names], bool(self.sections.get("free_surface"))
        right = [self._made((), TensionTable, {pair: value}, fluids, empty=free) for pair, value in given.items()]
        if all(table is not None for table in right):
            self._made((), TensionTable, given, fluids, empty=free)
        return given

    def _force(self) -> UniformForce | None:
        function = self._function(("body_force",), self.sections.get("body_force"), self.dimension or 0)
        return None if function is None else UniformForce(function)

    def _probes(self) -> list[Probe]:
        probes: dict[str, Probe] = {}
        for k, table in enumerate(self.sections.get("probes") or ()):
            if table is None:
                continue
            path: Path = ("probes", k)
            given = table.given()
            fluid = given.get("fluid")
            if fluid is not None and fluid not in self.fluid_names:
                names = self.fluid_names
                why = f"is {fluid!r}; it must be one of the fluids {listed(names)}{meant(fluid, names)}"
                self.report((*path, "fluid"), why)
                continue
            if table.name in probes:
                self.report((*path, "name"), f"is {table.name!r}, the name of an earlier probe; give another")
            probe = self._made(path, KINDS[given.pop("type")], **given)
            if probe is not None:
                probes[table.name] = probe
        return list(probes.values())

    def _check_choices(self) -> None:
        """What the tables for interface, free surface, grading and tank rule out together."""
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


def _by_pairs(table: Mapping[str, Any]) -> dict[Pair, float]:
    """Values by the names of two fluids, or of one at a free surface, of a table of tables of the second names."""
    found: dict[Pair, float] = {}
    for one, value in table.items():
        found.update({(one, other): each for other, each in value.items()} if isinstance(value, dict) else {one: value})
    return found
