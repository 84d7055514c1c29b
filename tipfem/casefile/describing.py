"""The other way: a case as the text of a case file."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.arguments import is_number, numbers
from tipfem.case.case import Case
from tipfem.case.declaration import changed
from tipfem.case.fluid import Fluid
from tipfem.case.mesh_file import MeshTank
from tipfem.case.particles import Particles
from tipfem.case.region import Region
from tipfem.case.rheology import law_record
from tipfem.case.tank import Tank
from tipfem.case.walls import Motion
from tipfem.case.waves import WaveMaker
from tipfem.casefile.forms import FORMS, HalfSpace, Limits, Model, Polygon, Side, Table, Uniform
from tipfem.casefile.outlines import shape_content
from tipfem.casefile.pairs import by_names
from tipfem.casefile.registry import LISTED
from tipfem.casefile.schema import SCHEMA_ID, CheckpointTable
from tipfem.casefile.source import BARE
from tipfem.probes import Probe, probe_record
from tipfem.results.fields import FieldOutput
from tipfem.results.whole_file import replaced

NOT_KEPT = "not kept: "  # begins what stands in place of a part that a case file cannot keep
ARRAYS = ("position", "fluid", "wall", "velocity", "acceleration", "pressure")
FUNCTIONS: tuple[type[Model], ...] = (*FORMS.values(), *(form for each in LISTED for form in each.forms))


@dataclass(frozen=True)
class Description:
    """A case as a case file."""

    # in TOML. `read_case` makes of it a case with bitwise the same particles, unless parts are missing: then it refuses
    # the text, at each of them
    text: str
    # the parts that a case file cannot keep, most of them functions in Python; empty if it keeps all
    missing: tuple[str, ...]
    particles_file: str | None = None  # the file of particles that the text needs, or None
    mesh_file: str | None = None  # the file of a mesh that the text needs, or None

    def __str__(self) -> str:
        return self.text


def describe(
    case: Case,
    end: float,
    *,
    largest_step: float | None = None,
    interval: float | None = None,
    folder: str | None = None,
    checkpoint_interval: float | None = None,
    checkpoint_wall_interval: float | None = 60.0,
    probes: Sequence[Probe] = (),
    fields: FieldOutput | None = None,
    particles_file: str | None = None,
) -> Description:
    """A case as a case file.

    Args:
        case: the case.
        end: simulated time to run to [s].
        largest_step: largest time step [s], or None for the default.
        interval: time between states written to disk [s], or None for the first and the last only.
        folder: for the results, or None for the default.
        checkpoint_interval: simulated time between checkpoints [s], or None.
        checkpoint_wall_interval: wall-clock time between them [s], or None.
        probes: what is measured on the way.
        fields: how states are written, or None for the default.
        particles_file: what to call the file of particles that were not sampled from a tank; `write_case` writes it.
            Without it they count as missing. The copy of a mesh file has this name with its own suffix; without, the
            mesh stays where it is.

    Raises:
        ValueError: ``end`` is not a number > 0.
    """
    if not (is_number(end) and end > 0):
        raise ValueError(f"describe: end is {end!r} s; it must be a number > 0")
    writer = _Writer()
    writer.head(case)
    for fluid in case.fluids:
        writer.table(("fluids", fluid.name), {"density": fluid.density, "viscosity": law_record(fluid.viscosity)})
    sampled, mesh_file = _sampled(case), None
    # Walls that a file of particles does not describe.
    if not sampled and (case.period.axial or (case.domain is not None and not case.is_box)):
        particles_file = None
        reason = "read from a mesh file" if case.tank else "particles with a shape, or around an axis"
        writer.table(("particles",), {"file": writer.lost("tank", reason)})
    elif sampled:
        assert case.tank is not None
        if isinstance(case.tank, MeshTank):
            mesh_file = writer.mesh(case.tank, particles_file)
        else:
            writer.tank(case.tank)
        particles_file = None
    elif particles_file is None:
        reason = "changed after they were sampled from the tank" if case.tank else "given as arrays"
        writer.table(("particles",), {"file": writer.lost("particles", reason)})
    else:
        writer.table(("particles",), {"file": particles_file})
    for each in LISTED:
        for one in each.written(case, case.tank if sampled else None):
            content = each.content(one, writer.content(".".join(one.path), one))
            writer.table(one.path if each.named else one.path[:1], content, item=not each.named)
    writer.rest(case)
    writer.table(("time",), {"end": end, "largest_step": largest_step})
    chosen, usual = (fields or FieldOutput()).record(), FieldOutput().record()
    written = {"fields" if key == "format" else key: chosen[key] for key in chosen if chosen[key] != usual[key]}
    writer.table(("output",), {"folder": folder, "interval": interval, **written})
    wall_interval = checkpoint_wall_interval if checkpoint_wall_interval is not None else 0.0
    given = None if wall_interval == CheckpointTable().wall_interval else wall_interval
    writer.table(("checkpoint",), {"interval": checkpoint_interval, "wall_interval": given})
    for probe in probes:
        writer.probe(probe)
    return Description(writer.text(), tuple(writer.missing), particles_file, mesh_file)


def write_case(path: str | Path, case: Case, end: float, **options: Any) -> Description:
    """Write a case to a case file, and its particles to an NPZ file beside it if they are not those of a tank.

    Args:
        path: of the case file.
        case: the case.
        end: simulated time to run to [s].
        options: further ones of `describe`.

    Returns:
        What was written.
    """
    path = Path(path)
    file = path.with_suffix(".npz")
    described = describe(case, end, particles_file=file.name, **options)
    if described.mesh_file:
        assert isinstance(case.tank, MeshTank)
        assert case.tank.file is not None
        source, target = case.tank.file[0], path.with_name(described.mesh_file)
        if not (target.exists() and target.samefile(source)):
            with replaced(target) as temporary:
                shutil.copyfile(source, temporary)
    if described.particles_file:
        arrays = {name: getattr(case.particles, name) for name in ARRAYS}
        with replaced(file) as temporary, open(temporary, "wb") as opened:
            np.savez(opened, spacing=np.float64(case.particles.spacing), **arrays)
    with replaced(path) as temporary:
        # In a C locale a name of a folder that is not ASCII has bytes that Python has not decoded.
        temporary.write_bytes(described.text.encode("utf-8", "surrogateescape"))
    return described


def _sampled(case: Case) -> bool:
    """Whether the case's particles are those that its tank gives."""
    if case.tank is None or (isinstance(case.tank, MeshTank) and case.tank.file is None):
        return False
    try:
        again = case.tank.sample(
            case.fluids, fitted=case.interface == "sharp", empty=case.free_surface, grading=case.grading
        )
    except ValueError:
        return False
    return _same(again, case.particles)


def _same(one: Particles, other: Particles) -> bool:
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ARRAYS)


class _Writer:
    """Collects the lines of a case file, and ``missing``: names of parts that it cannot keep, each with a reason."""

    def __init__(self) -> None:
        self.missing: list[str] = []
        self._lines: list[str] = []

    def text(self) -> str:
        """The whole text; what is missing stands on top."""
        top = [
            f"# Editors complete and check this file by `tipfem schema --out {SCHEMA_ID}` beside it, and a first line",
            f"# #:schema {SCHEMA_ID}",
        ]
        if self.missing:
            top += ["# A case file cannot keep these parts, and cannot be loaded without them:"]
            top += [f"#   {part}" for part in self.missing]
        return "\n".join([*top, *self._lines]) + "\n"

    def lost(self, part: str, reason: str) -> str:
        """Note a part that cannot be kept, and return its placeholder, which is refused when the text is loaded."""
        self.missing.append(f"{part}: {reason}")
        return f"{NOT_KEPT}{reason}"

    def table(self, path: tuple[str, ...], content: Mapping[str, Any], *, item: bool = False) -> None:
        """A table, or an item of an array of tables; values that are None are left out."""
        kept = {key: value for key, value in content.items() if value is not None}
        if kept or item:
            name = ".".join(map(_key, path))
            self._lines += ["", f"[[{name}]]" if item else f"[{name}]"]
            self.pairs(kept)

    def pairs(self, content: Mapping[str, Any]) -> None:
        """Keys with their values."""
        self._lines += [f"{_key(key)} = {toml_value(value)}" for key, value in content.items() if value is not None]

    def head(self, case: Case) -> None:
        """Write the keys before all tables."""
        force: Any = case.body_force
        if force is not None:
            force = self.function("body_force", force)
        self.pairs(
            {
                "title": case.title or None,
                "gravity": np.asarray(case.gravity).tolist(),
                "body_force": force,
                "interface": case.interface,
                "free_surface": True if case.free_surface else None,
            }
        )

    def tank(self, tank: Tank) -> None:
        """A tank, what it is filled with, and its walls."""
        seed: Any = int(tank.seed) if isinstance(tank.seed, (int, np.integer)) else self.lost("tank.seed", "no number")
        given: dict[str, Any] = {"spacing": float(tank.spacing)}
        if tank.shape is not None:
            given["shape"] = shape_content(tank.shape)
        elif tank.solid is not None:
            given["corners"] = tank.solid.corners.tolist()
        else:
            given = {"size": numbers(tank.size).tolist(), **given}
        more = {"jitter": float(tank.jitter) or None, "seed": seed or None, "periodic": tank.periodic}
        more["coordinates"] = tank.coordinates if tank.period.axial else None
        self.table(("tank",), {**given, **more})
        for name, box in tank.boxes.items():
            self.table(("blocks", name), {"box": box.tolist()})
        for k, region in enumerate(tank.regions):
            part = f"fill[{k}]"
            velocity: Any = region.velocity
            if callable(velocity):
                velocity = self.lost(f"{part}.velocity", _named(velocity))
            elif velocity is not None:
                velocity = velocity.tolist()
            content = {"fluid": region.fluid.name, **self.shape(part, region), "velocity": velocity}
            self.table(("fill",), content, item=True)

    def mesh(self, tank: MeshTank, name: str | None) -> str | None:
        """A tank from a mesh file, and its walls; returns the name of the file's copy, with the stem of ``name``."""
        assert tank.file is not None
        path, scale = tank.file
        copied = None if name is None else Path(name).with_suffix(path.suffix).name
        content = {"mesh": copied or str(path.absolute()), "scale": None if scale == 1.0 else scale}
        self.table(("tank",), {**content, "spacing": float(tank.spacing)})
        return copied

    def shape(self, part: str, region: Region) -> dict[str, Any]:
        """The shape of a filled part."""
        if "box" in region.given:
            return {"box": numbers(region.given["box"]).tolist()}
        if "disc" in region.given:
            centre, radius = region.given["disc"]
            return {"disc": {"centre": np.asarray(centre).tolist(), "radius": float(radius)}}
        if "shape" in region.given:
            return {"shape": shape_content(region.given["shape"])}
        if "where" not in region.given:
            return {}
        where = region.given["where"]
        if isinstance(where, Side):
            return {"above" if where.above else "below": _plain(where.curve)}
        if isinstance(where, HalfSpace):
            return {"half_space": _plain(where)}
        if isinstance(where, Polygon):
            return {"polygon": _plain(where)["points"]}
        return {"where": self.lost(f"{part}.where", _named(where))}

    def probe(self, probe: Probe) -> None:
        """A probe; keys that have their defaults are left out."""
        record = probe_record(probe)
        if "type" not in record:
            reason = f"a class of Python's, {record['class']}"
            record = {"type": self.lost(f"probes.{probe.name}", reason), "name": probe.name}
        else:
            kept = changed(probe)
            record = {key: value for key, value in record.items() if key == "type" or key in kept}
        self.table(("probes",), record, item=True)

    def function(self, part: str, function: Callable[..., Any]) -> Any:
        """A function: a named form, or what stands for one that cannot be kept."""
        function = function.function if isinstance(function, Uniform) else function
        if isinstance(function, WaveMaker):
            return {"form": function.form, **changed(function)}
        if not isinstance(function, FUNCTIONS):
            return self.lost(part, _named(function))
        content = _plain(function)
        if isinstance(function, Table) and function.times is not None:
            content = {key: value for key, value in content.items() if key not in ("file", "columns")}
        return content

    def content(self, part: str, instance: Any) -> dict[str, Any]:
        """The values of a dataclass that are not as by default: functions by their forms, fluids by their names."""
        found = changed(instance)
        for name in found:
            value = getattr(instance, name)
            if callable(value):
                found[name] = self.function(f"{part}.{name}", value)
            elif isinstance(value, Fluid):
                found[name] = value.name
            elif isinstance(value, Motion):
                found[name] = self.content(f"{part}.{name}", value)
            else:
                found[name] = np.asarray(value).tolist() if isinstance(value, Sequence) else found[name]
        return found

    def rest(self, case: Case) -> None:
        """Motion of the tank, grading and numerics."""
        if case.tank_motion is not None:
            self.table(("tank_motion",), self.content("tank_motion", case.tank_motion))
        if case.grading is not None:
            where = case.grading.where
            limits: dict[str, Any] = {}
            if isinstance(where, Limits):
                limits = {"limits": _plain(where)["limits"]}
            elif where is not None:
                limits = {"where": self.lost("grading.where", _named(where))}
            largest = {name: float(value) for name, value in case.grading.largest.items()}
            rest = {"growth": float(case.grading.growth), "film_resolution": case.grading.film_resolution}
            self.table(("grading",), {"largest": largest or None, **rest, **limits})
        self.table(("surface_tension",), by_names(case.surface_tension.given))
        numerics = changed(case.numerics)
        rules = {key: numerics.pop(key) for key in list(numerics) if isinstance(numerics[key], dict)}
        self.table(("numerics",), numerics)
        for key, rule in rules.items():
            self.table(("numerics", key), rule)


def _plain(model: Model) -> dict[str, Any]:
    return model.model_dump(exclude_defaults=True, exclude_none=True)


def _named(function: Any) -> str:
    """A function's name, for people."""
    name = getattr(function, "__qualname__", type(function).__qualname__)
    return f"the Python function {name} of {getattr(function, '__module__', '?')}"


def _key(key: str) -> str:
    return key if BARE.fullmatch(key) else json.dumps(key)


def toml_value(value: Any) -> str:
    """A value in TOML; numbers with all their digits."""
    if isinstance(value, Mapping):
        pairs = [f"{_key(key)} = {toml_value(item)}" for key, item in value.items() if item is not None]
        return "{" + ", ".join(pairs) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    if isinstance(value, (float, np.floating)):
        return repr(float(value))
    return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
