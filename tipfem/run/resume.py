"""Going on with a run from its newest checkpoint, with the case that it has left."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, Literal

from tipfem.backend import runtime
from tipfem.case.case import Case
from tipfem.casefile.record import case_from, case_record, differences, python_functions
from tipfem.errors import CheckpointError
from tipfem.probes import Probe, probe_from, probe_record
from tipfem.results.fields import FieldOutput
from tipfem.results.output import CASE_FILE, ResultsFolder
from tipfem.run.checkpoint import CheckpointFolder

Kept = Literal["kept"]
KEPT: Final[Kept] = "kept"  # in place of a setting that is to be as it was


@dataclass(frozen=True)
class Continuation:
    """A run at its newest checkpoint, and what it goes on with."""

    case: Case  # of the run
    settings: Mapping[str, Any]  # arguments of `Simulation`
    content: Mapping[str, Any]  # of the checkpoint
    notes: list[str]  # lines on what may make it differ from a run that was not stopped
    changes: list[str]  # lines on what is written otherwise than before


def continuation(
    out: Path, case: Case | None, columns: Sequence[str], given: Mapping[str, Any], *, allow_changes: bool
) -> Continuation:
    """Plan for going on with a run; starts Taichi as the run had it, unless it has been started.

    ``case`` is None for that of the checkpoint or of the folder's case file; ``given`` are settings in place of those
    that the run had, ``columns`` names of further ones of the history. See `Simulation.resume` for errors, and
    `allow_changes`.
    """
    folder = CheckpointFolder(out)
    notes: list[str] = []
    newest = folder.read()
    case = _kept_case(out, newest["case"]) if case is None else case
    if not runtime.settings():
        runtime.init(newest["environment"]["arch"], newest["environment"]["precision"])
    content = folder.read(case, notes.append)
    notes += _differences(content, case, columns, out, allow_changes=allow_changes)
    before = content["settings"]
    probes, changes = _probes(before["probes"], given.get("probes"), out)
    settings = {**before, **given, "probes": probes, "fields": FieldOutput.of(given.get("fields", before["fields"]))}
    for name in ("output_interval", "checkpoint_interval", "checkpoint_wall_interval"):
        if before[name] != settings[name]:
            changes.append(f"changed: {name}: {before[name]}, now {settings[name]}")
    if reason := fields_refused(before["fields"], settings["fields"]):
        raise CheckpointError(f"fields: {reason[1]}")
    old, new = before["fields"].precision, settings["fields"].precision
    if old != new:
        changes.append(f"changed: precision of fields: {old}, now {new}")
    del settings["columns"]
    return Continuation(case, settings, content, [*notes, *changes], changes)


def fields_refused(before: FieldOutput, chosen: FieldOutput) -> tuple[str, str] | None:
    """Part of a chosen way to write fields that a run with another before cannot have, and why; None if it can."""
    if chosen.format != before.format:
        return "format", (
            f"format is {chosen.format!r}; the run has written {before.format!r}, and all its states stay in one "
            "format: leave it, and convert the results afterwards by `tipfem convert`"
        )
    for name in ("precision", "compression", "quantities") if before.vtkhdf else ():
        if getattr(chosen, name) != getattr(before, name):
            return name, (
                f"{name} is {getattr(chosen, name)!r}; fields.vtkhdf has {getattr(before, name)!r} from its first "
                "state on: leave it"
            )
    return None


def _probes(
    recorded: Mapping[str, Any], probes: Sequence[Probe] | None, out: Path
) -> tuple[Sequence[Probe], list[str]]:
    """The probes to go on with, those of the run by default, and a line on each that has changed.

    Their intervals may change; probes may be added, whose files begin at the present time, and left out, whose files
    end there. A CheckpointError tells of one that measures something else under its name, or has the file of another.
    """
    if probes is None:
        return [probe_from(record) for record in recorded.values()], []
    present = {probe.name: probe_record(probe) for probe in probes}
    both = [name for name in recorded if name in present]
    changed = differences({name: recorded[name] for name in both}, {name: present[name] for name in both})
    if refused := [line for line in changed if not line.split(": ")[0].endswith(".interval")]:
        text = f"{out}: the probes are not those of the run: {'; '.join(refused)}; their intervals may change, and "
        raise CheckpointError(f"{text}probes with names of their own may be added")
    added = [name for name in present if name not in recorded]
    if taken := [name for name in added if (out / "probes" / f"{name}.csv").exists()]:
        text = f"{out}: probes/{taken[0]}.csv is there from an earlier probe; give the probe another name"
        raise CheckpointError(text)
    notes = [f"changed: probe {line}" for line in changed]
    notes += [f"changed: probe {name!r} is added; its file begins here" for name in added]
    notes += [f"changed: probe {name!r} is left out; its file ends here" for name in recorded if name not in present]
    return probes, notes


def _differences(
    content: Mapping[str, Any], case: Case, columns: Sequence[str], out: Path, *, allow_changes: bool
) -> list[str]:
    """Lines on changes since a checkpoint that may change results; `CheckpointError` for another case or columns."""
    changed = differences(content["case"], case_record(case))
    if changed and not (allow_changes and all(line.startswith("numerics.") for line in changed)):
        remedy = "" if allow_changes else "; numbers of the method may change with allow_changes"
        raise CheckpointError(f"{out}: the case is not that of the run: {'; '.join(changed)}{remedy}")
    before = content["settings"]["columns"]
    if sorted(columns) != sorted(before):
        raise CheckpointError(f"{out}: the run had the columns {before}, and {list(columns)} are given")
    present = environment()
    return [f"changed: {line}" for line in changed] + [
        f"{key}: {value}, now {present.get(key)}; the results may differ by round-off from those of one run"
        for key, value in content["environment"].items()
        if key != "threads" and present.get(key) != value
    ]


def environment() -> dict[str, Any]:
    """Environment that results depend on to the bit, beside the case: processor, versions, settings of Taichi."""
    packages = {name: version(name) for name in ("tipfem", "taichi", "numpy", "scipy")}
    return {"processor": _processor(), "python": platform.python_version(), **packages, **runtime.settings()}


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            names = [line.split(":", 1)[1].strip() for line in file if line.startswith("model name")]
        return names[0]
    except (OSError, IndexError):
        return platform.processor() or platform.machine()


def leave_case(results: ResultsFolder, case: Case, end: float, settings: Mapping[str, Any]) -> None:
    """Write the whole case into a results folder, as a case file, unless there is one of this run or the user's own.

    Parts that no file keeps, functions of Python's, are named in it. ``end`` [s] is to be reached; nothing is written
    if it is infinite. ``settings`` are of `tipfem.describe`; `OSError` if the file cannot be written.
    """
    names = (CASE_FILE, "case.npz")
    if end == float("inf") or any((results.path / name).exists() for name in names):
        return
    from tipfem.casefile.describing import write_case  # here, for its import takes a while

    for name in names:
        results.list_file(name)
    written = write_case(results.path / CASE_FILE, case, end, folder=str(results.path), **settings)
    if written.mesh_file:
        results.list_file(written.mesh_file)


def leave_changes(out: Path, case: Case, end: float, settings: Mapping[str, Any]) -> None:
    """Write the case file of a run that goes on anew, unless it says already what the run writes; see `leave_case`."""
    from tipfem.casefile.describing import write_case
    from tipfem.casefile.loading import left_case

    file = left_case(out)
    if file is None or _written(file, settings) != settings:
        write_case(out / CASE_FILE, case, file.end if file else end, folder=str(out), **settings)


def note_on_edits(out: Path, case: Case, settings: Mapping[str, Any]) -> list[str]:
    """A note if a run goes on with a case file that was edited, which only `tipfem resume` reads; see `leave_case`."""
    from tipfem.casefile.loading import left_case

    path = out / CASE_FILE
    if not path.exists() or path.stat().st_mtime_ns <= CheckpointFolder(out).files()[0].stat().st_mtime_ns:
        return []
    try:
        file = left_case(out)
        if file is None or (
            _written(file, settings) == settings and not differences(case_record(case), case_record(file.case()))
        ):
            return []
    except ValueError:  # it has mistakes
        pass
    return [f"{path}: Simulation.resume does not read it; `tipfem resume` does, and arguments change what is written"]


def _written(file: Any, settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """The settings of a case file, with the largest step of the run, which it may leave to tipfem."""
    return {**file.settings(), "largest_step": settings["largest_step"]}


def _kept_case(out: Path, record: Mapping[str, Any]) -> Case:
    """The case of a run: of the case file that it left, if unchanged, else of the record, without tank and fills."""
    from tipfem.casefile.loading import left_case

    of_python = bool(python_functions(record))
    try:
        file = left_case(out)
        case = None if file is None else file.case()
    except ValueError:  # it has mistakes, by an edit
        if of_python:
            raise
        case = None
    if case is not None and (of_python or not differences(record, case_record(case))):
        return case
    return case_from(record)
