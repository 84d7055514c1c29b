"""Cases as plain values: for what draws and steers their runs, and to compare a run that goes on with what it was."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tipfem.case.case import Case
from tipfem.case.declaration import declared, made, plain
from tipfem.case.fluid import Fluid, fluid_record
from tipfem.case.grading import Grading
from tipfem.case.numerics import Numerics
from tipfem.case.outline import tank_facts
from tipfem.case.particles import Particles
from tipfem.case.rheology import law_from
from tipfem.case.waves import WaveMaker
from tipfem.casefile.registry import LISTED
from tipfem.errors import CheckpointError
from tipfem.geometry.blocks import BlockedBox
from tipfem.geometry.plane.domain import Domain


def case_facts(case: Case) -> dict[str, Any]:
    """Content of case.json."""
    facts: dict[str, Any] = {
        "format": 1,
        "dimension": case.particles.dimension,
        "title": case.title,
        "fluids": [fluid_record(fluid) for fluid in case.fluids],
        "interface": case.interface,
        "free_surface": case.free_surface,
        **tank_facts(case),
    }
    for each in LISTED:
        facts |= each.facts(case)
    return facts


def steered(case: Case) -> dict[str, list[Any]]:
    """List by the names of commands to a run what they act on, of all that stands in lists of case files."""
    return {name: things for each in LISTED for name, things in each.steered(case).items()}


def case_record(case: Case) -> dict[str, Any]:
    """Record of a case as plain values and arrays, to compare and remake it; of functions of Python's their names."""
    return {
        "fluids": [fluid_record(fluid) for fluid in case.fluids],
        "gravity": np.asarray(case.gravity, dtype=float).tolist(),
        "body_force": _plain(case.body_force),
        "interface": case.interface,
        "free_surface": case.free_surface,
        "title": case.title,
        "numerics": _plain(case.numerics),
        "tank_motion": _plain(case.tank_motion),
        "grading": _plain(case.grading),
        "surface_tension": _by_interface(case.surface_tension.given),
        **{each.attribute: [each.record(one, _of_object(one)) for one in each.of(case)] for each in LISTED},
        "walls_have_fluids": case.walls_have_fluids,
        "particles": dict(vars(case.particles)),
        **({"blocks": case.blocks.record} if case.blocks else {}),
        **({} if case.is_box or case.domain is None else {"domain": case.domain.record}),
        **({"period": case.period.width.tolist()} if case.period else {}),
        **({"coordinates": case.coordinates} if case.period.axial else {}),
    }


def case_from(record: Mapping[str, Any]) -> Case:
    """The case that a record of `case_record` describes; `CheckpointError` if it has functions of Python's."""
    if functions := python_functions(record):
        text = f"the case has functions of Python's, which no file keeps: {', '.join(functions)}; give the case to "
        raise CheckpointError(f"{text}resume, as the script made it")
    particles = Particles.__new__(Particles)
    vars(particles).update(record["particles"])
    grading = record["grading"]
    lists: Any = {
        each.attribute: [each.restored(_with_angles(one)) for one in record.get(each.attribute, [])] for each in LISTED
    }
    case = Case(
        particles,
        [Fluid(**{**fluid, "viscosity": law_from(fluid["viscosity"])}) for fluid in record["fluids"]],
        record["gravity"],
        interface=record["interface"],
        free_surface=record["free_surface"],
        numerics=made(Numerics, record["numerics"]),
        title=record["title"],
        grading=None if grading is None else Grading(**grading),
        shape=BlockedBox(**record["blocks"]) if "blocks" in record else Domain.of(record.get("domain")),
        period=record.get("period"),
        coordinates=record.get("coordinates", "planar"),
        surface_tension=_from_interfaces(record["surface_tension"]),
        **lists,
    )
    case.walls_have_fluids = record["walls_have_fluids"]
    return case


def python_functions(record: Mapping[str, Any]) -> list[str]:
    """Names of the parts of a record that are functions."""
    leaves = _flat({key: value for key, value in record.items() if key != "particles"})
    return [key for key, value in leaves if isinstance(value, Mapping)]  # see `_flat`


def _by_interface(given: Mapping[Any, float] | None) -> list[dict[str, Any]] | None:
    """Values of interfaces, by one or two fluids, without keys that are tuples."""
    if given is None:
        return None
    pairs = {(one,) if isinstance(one, str) else one: value for one, value in given.items()}
    return [{"name": " and ".join(pair), "between": list(pair), "value": pairs[pair]} for pair in sorted(pairs)]


def _from_interfaces(record: Sequence[Mapping[str, Any]] | None) -> dict[Any, float] | None:
    return None if record is None else {tuple(each["between"]): each["value"] for each in record}


def _of_object(one: Any) -> dict[str, Any]:
    """Plain values of a dataclass, contact angles without keys that are tuples."""
    angles = {"contact_angle": _by_interface(one.contact_angle)} if hasattr(one, "contact_angle") else {}
    return {**_plain(one), **angles}


def _with_angles(record: Mapping[str, Any]) -> dict[str, Any]:
    """The values of `_of_object` with contact angles as they were."""
    angles = {"contact_angle": _from_interfaces(record["contact_angle"])} if "contact_angle" in record else {}
    return {**record, **angles}


def _plain(value: Any) -> Any:
    """A value as nested dicts of plain values."""
    return plain(value, _function)


def _function(function: Any) -> dict[str, Any]:
    if isinstance(function, WaveMaker):
        return {"form": function.form, **{name: getattr(function, name) for name in declared(type(function))}}
    return {"function": _described(function)}


def _described(function: Any) -> str:
    """The name of a function; of a form of case files, which is a function with parameters, these as well."""
    inner = getattr(function, "function", function)  # of a force that is the same everywhere
    if not hasattr(inner, "model_dump"):
        return str(getattr(function, "__qualname__", type(function).__name__))
    text = f"{type(inner).__name__}({inner})"
    return text if len(text) <= 200 else f"{text[:100]}... {hashlib.sha256(text.encode()).hexdigest()[:16]}"


def differences(recorded: Mapping[str, Any], present: Mapping[str, Any]) -> list[str]:
    """Differences between two records of cases, a line for each value: ``numerics.rho_inf: 0.0, now 0.5``."""
    before, after = dict(_flat(recorded)), dict(_flat(present))
    if "domain" not in recorded:  # of an earlier version, whose records have none
        after = {key: value for key, value in after.items() if not key.startswith("domain.")}
    lines = []
    for key in [*before, *(key for key in after if key not in before)]:
        old, new = before.get(key, "nothing"), after.get(key, "nothing")
        if isinstance(old, np.ndarray) or isinstance(new, np.ndarray):
            if not (np.shape(old) == np.shape(new) and np.array_equal(old, new, equal_nan=True)):
                lines.append(f"{key}: other values at the start")
        elif old != new:
            lines.append(f"{key}: {old!r}, now {new!r}")
    return lines


def _flat(tree: Any, name: str = "") -> list[tuple[str, Any]]:
    """The leaves of nested dicts and lists, by dotted names."""
    if isinstance(tree, Mapping) and set(tree) != {"function"}:
        items = tree.items()
    elif isinstance(tree, list) and any(isinstance(item, Mapping | list) for item in tree):
        names = [str(item.get("name", k) if isinstance(item, Mapping) else k) for k, item in enumerate(tree)]
        items = dict(zip(names, tree, strict=True)).items()
    else:
        return [(name, tree)]
    return [leaf for key, item in items for leaf in _flat(item, f"{name}.{key}" if name else str(key))]
