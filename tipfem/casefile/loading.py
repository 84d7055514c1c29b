"""Read a case file, check all of it, and build what it describes."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any, get_args, get_origin

from pydantic import TypeAdapter, ValidationError

from tipfem.arguments import meant, path_of
from tipfem.case.motion_sweep import require_room
from tipfem.casefile.building import Parts
from tipfem.casefile.describing import NOT_KEPT
from tipfem.casefile.problems import CaseFileError, Problem, Translator, child_at
from tipfem.casefile.schema import CaseTable, json_schema
from tipfem.casefile.source import Key, Path, Source, SyntaxProblem, keys_of, parse, value_of
from tipfem.casefile.variables import TABLE, substituted
from tipfem.errors import FolderRefused, Several, TriangulationError
from tipfem.geometry.box_sides import SIDES
from tipfem.results.fields import FieldOutput
from tipfem.results.output import CASE_FILE

if TYPE_CHECKING:
    from tipfem.case.case import Case
from tipfem.case.fluid import law_table


def load_case(path: str | FilePath, overrides: Sequence[str] = ()) -> CaseFile:
    """See `tipfem.load_case`, which gives a case file that can be run."""
    path = path_of("load_case: path", path)
    if isinstance(overrides, str) or not (
        isinstance(overrides, Sequence) and all(isinstance(text, str) for text in overrides)
    ):
        text = f"load_case: overrides is {overrides!r}; it must be a list of texts, as ['fluids.water.viscosity=2e-3']"
        raise ValueError(text)
    return read_case(text_of(path, "a case file"), str(path), path.parent, overrides)


def left_case(folder: FilePath, overrides: Sequence[str] = ()) -> CaseFile | None:
    """The case file left in a results folder; None without one, or if it lacks parts, see `Description`."""
    path = folder / CASE_FILE
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return None
    return None if f'"{NOT_KEPT}' in text else load_case(path, overrides)


def read_case(text: str, name: str, folder: FilePath | str = ".", overrides: Sequence[str] = ()) -> CaseFile:
    """The same as `load_case`, of a text in TOML, with a name for messages and a folder for its paths."""
    found = _Findings(name, source_of(text, name))
    data = substituted(found.overridden(overrides), found.add)
    table: CaseTable | None = None
    try:
        table = CaseTable.model_validate(data)
    except ValidationError as error:
        for place, message in Translator(json_schema(), data).problems(error.errors()).items():
            found.add(place, message)
    of_schema = [path for path in found.paths if path]

    def follow(place: Path, message: str) -> None:
        """Note a mistake that the parts make together, unless it follows from one that is noted already."""
        if not any(place[: len(other)] == other[: len(place)] for other in of_schema):
            found.add(place, message)

    parts = Parts(_sections(data, table, of_schema), FilePath(folder), follow)
    if found.problems or table is None:
        raise CaseFileError(found.problems)
    return CaseFile(name, data, table, parts, found)


@dataclass(frozen=True)
class CaseFile:
    """A case file without mistakes that can be told without making its particles."""

    name: str  # the file, as it was given
    data: Mapping[str, Any]  # its content with the overrides
    table: CaseTable  # the same, checked and with all defaults
    parts: Parts  # the fluids, the tank, walls and rules that it describes
    _findings: _Findings

    @property
    def end(self) -> float:
        """Simulated time to run to [s]."""
        return self.table.time.end

    @property
    def folder(self) -> FilePath:
        """The folder for the results: that of the file, or out/ and the file's name."""
        return FilePath(self.table.output.folder or f"out/{FilePath(self.name).stem}")

    def settings(self) -> dict[str, Any]:
        """Settings for `tipfem.describe` beside the case and its end: steps, output, checkpoints and probes."""
        return {
            "largest_step": self.table.time.largest_step,
            "interval": self.table.output.interval,
            "fields": self.fields,
            "checkpoint_interval": self.table.checkpoint.interval,
            "checkpoint_wall_interval": self.table.checkpoint.wall_interval or None,
            "probes": self.parts.probes,
        }

    def options(self) -> dict[str, Any]:
        """The same, as `tipfem.Simulation` takes it."""
        written = self.settings()
        return {"time_step": written.pop("largest_step"), "output_interval": written.pop("interval"), **written}

    @property
    def fields(self) -> FieldOutput:
        """Format and options of stored states."""
        output = self.table.output
        given = {"precision": output.precision, "compression": output.compression, "quantities": output.quantities}
        return FieldOutput(format=output.fields, **given)

    def problem(self, path: Path, text: str) -> Problem:
        """A mistake at a path, with its place: the line of the file, or the override."""
        return self._findings.problem(path, text)

    def case(self) -> Case:
        """The case, with its particles.

        Raises:
            CaseFileError: its parts do not fit together: a layer is thinner than the spacing allows, or a probe is
                outside of the tank, say; or a prescribed motion takes a body to a wall before the end.
        """
        made: Case = self.placed(self.parts.case)
        problems: list[Problem] = []
        checks: list[Callable[[], Any]] = [partial(probe.columns, made) for probe in self.parts.probes]
        checks.append(partial(require_room, made, 0.0, self.end, lambda: _volume(made)))
        checks.append(lambda: self.fields.require_laws(law_table(made.fluids)))
        for check in checks:
            try:
                self.placed(check)
            except CaseFileError as error:
                problems += error.problems
        if problems:
            raise CaseFileError(problems)
        return made

    def placed(self, make: Callable[[], Any]) -> Any:
        """Call a function, and place its ValueError in the file, unless a folder for results is refused."""
        try:
            return make()
        except (CaseFileError, FolderRefused):
            raise
        except ValueError as error:
            errors = error.errors if isinstance(error, Several) else (error,)
            raise CaseFileError(self._findings.problem(*self.parts.place_of(each)) for each in errors) from None


def _volume(case: Case) -> float:
    """Volume of the fluids at the start [m^2, or m^3 in 3-D]; `ValueError` if the particles cannot be meshed."""
    from tipfem.remesh.choice import remesher_for  # here, for it imports Taichi

    try:
        return remesher_for(case).first_volume(case.particles, case.boundary)
    except TriangulationError as error:
        raise ValueError(f"Case: the initial particles cannot be meshed: {error}") from error


class _Findings:
    """The mistakes of a file, each with its place."""

    def __init__(self, name: str, source: Source) -> None:
        self.name, self.source = name, source
        self.problems: list[Problem] = []
        self._overrides: dict[Path, str] = {}

    @property
    def paths(self) -> list[Path]:
        """The paths of all mistakes."""
        return [problem.path for problem in self.problems]

    def add(self, path: Path, text: str) -> None:
        """Note a mistake at a path."""
        self.problems.append(self.problem(path, text))

    def problem(self, path: Path, text: str) -> Problem:
        """A mistake at a path, with the line or the override that it stands in."""
        for length in range(len(path), 0, -1):
            if path[:length] in self._overrides:
                return Problem(f"--set {self._overrides[path[:length]]}", path, text, line=1 << 30)
        line = self.source.line(path)
        return Problem(f"{self.name}:{line}" if path else self.name, path, text, line)

    def overridden(self, overrides: Sequence[str]) -> dict[str, Any]:
        """The content with overrides; those that cannot be applied are noted."""
        data = copy.deepcopy(self.source.data)
        for text in overrides:
            try:
                path = _assign(data, text)
            except ValueError as error:
                self.problems.append(Problem(f"--set {text}", (), str(error), line=1 << 30))
            else:
                self._overrides[path] = text
        return data


def _assign(data: dict[str, Any], text: str) -> Path:
    """Apply one override to a content; returns its path, raises ValueError where it does not fit."""
    key, equals, value = text.partition("=")
    try:
        keys = keys_of(key.strip())
    except ValueError:
        keys = []
    if not equals or not keys:
        raise ValueError("it must be a dotted key, = and a value, as in fluids.water.viscosity=2e-3")
    if not value.strip():
        raise ValueError("there is no value after =")
    path: Path = ()
    node: Any = data
    for place, name in enumerate(keys, 1):
        index: Key = name
        if isinstance(node, list):
            if not (name.isdecimal() and int(name) < len(node)):
                raise ValueError(f"{name!r} is no item of {'.'.join(keys[: place - 1])}; they are 0 to {len(node) - 1}")
            index = int(name)
        elif not isinstance(node, dict):
            raise ValueError(f"{'.'.join(keys[: place - 1])} is {node!r} and has no keys in it")
        path = (*path, index)
        if place == len(keys):
            if path[:-1] == (TABLE,) and name not in node:
                known = ", ".join(node) or "none"
                raise ValueError(f"there is no variable {name!r}, but {known}{meant(name, list(node))}")
            node[index] = value_of(value.strip())
        elif isinstance(node, dict):
            if name not in node and (hint := _meant_name(path, list(node))):
                raise ValueError(hint)
            node = node.setdefault(name, {})
        else:
            node = node[index]
    return path


def _meant_name(path: Path, known: Sequence[str]) -> str:
    """Error for a name that a table of names, as of fluids, lacks; empty where it may be a new one."""
    table, name = path[:-1], str(path[-1])
    noun = {"fluids": "fluid", "walls": "wall"}.get(str(table[0])) if len(table) == 1 else None
    if noun is None or (noun == "wall" and name in SIDES):
        return ""
    hint = meant(name, known)
    return f"there is no {noun} {name!r}{hint}" if hint else ""


def _sections(data: Mapping[str, Any], table: CaseTable | None, wrong: Sequence[Path]) -> dict[str, Any]:
    """The sections of a content, checked and with defaults, but for what has mistakes and what needs that.

    The ``table`` has all where there are no mistakes.
    """
    if table is not None:
        return {name: getattr(table, name) for name in CaseTable.model_fields}
    kept = copy.deepcopy(dict(data))
    for path in wrong:
        _remove(kept, path)
    sections: dict[str, Any] = {}
    for name, field in CaseTable.model_fields.items():
        if name not in data:
            if not field.is_required():
                sections[name] = field.get_default(call_default_factory=True)
        elif name in kept and get_origin(field.annotation) in (list, dict) and name != "gravity":
            kind, items = get_args(field.annotation)[-1], kept[name]  # one table an item
            if isinstance(items, Mapping):
                sections[name] = {key: _validated(kind, items.get(key)) for key in data[name]}
            else:
                sections[name] = [_validated(kind, item) for item in items]
        elif name in kept:
            sections[name] = _validated(field.annotation, kept[name])
            if sections[name] is None:
                del sections[name]
    return sections


def _remove(data: Any, path: Path) -> None:
    """Take what stands at a path out of a content; in a list, None takes its place."""
    data = child_at(data, path[:-1])
    if isinstance(data, dict):
        data.pop(path[-1], None)
    elif isinstance(data, list) and isinstance(path[-1], int):
        data[path[-1]] = None


def _validated(kind: Any, value: Any) -> Any:
    try:
        return TypeAdapter(kind).validate_python(value)
    except ValidationError:
        return None


def text_of(path: FilePath, what: str) -> str:
    """The text of a file that is to be ``what`` in TOML; `CaseFileError` if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        why = f"it is not text in UTF-8 (byte {error.start}); give {what} in TOML"
    except OSError as error:
        beside = sorted(other.name for other in path.parent.glob("*.toml")) if path.parent.is_dir() else []
        reason = re.sub(r"^\[Errno \d+\] ", "", error.strerror or str(error))
        why = f"it cannot be read ({reason}); give {what} in TOML{'' if path.exists() else meant(path.name, beside)}"
    raise CaseFileError([Problem(str(path), (), why)])


def source_of(text: str, name: str) -> Source:
    """Content of a text of TOML, with the lines of its keys; `CaseFileError` if it is not valid."""
    try:
        return parse(text)
    except SyntaxProblem as problem:
        where = f"{name}:{problem.line}" if problem.line else name
        raise CaseFileError([Problem(where, (), f"this is not valid TOML: {problem.reason}")]) from None
