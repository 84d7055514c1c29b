"""Keys of a case file that may change when a run goes on: what is written, but nothing that changes the flow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any

from tipfem.casefile.loading import left_case
from tipfem.casefile.problems import CaseFileError, Problem
from tipfem.casefile.record import case_record, differences
from tipfem.casefile.source import Path, keys_of
from tipfem.results.output import CASE_FILE
from tipfem.run.case_file import CaseFile
from tipfem.run.resume import fields_refused

# Sections of a case file that say what is written, not how fluids flow.
WRITTEN = ("output", "checkpoint", "probes")


def file_to_go_on(out: FilePath, overrides: Sequence[str], *, allow_changes: bool) -> CaseFile | None:
    """The case file of a results folder with overrides; None if a run of Python's left one that is not complete.

    Raises:
        CaseFileError: the file has mistakes, or an override says what a run that goes on cannot have.
        ValueError: there are overrides, and no complete case file.
    """
    allowed = (*WRITTEN, "numerics") if allow_changes else WRITTEN
    refused = [Problem(f"--set {text}", (), why) for text in overrides if (why := _refused(text, allowed))]
    if refused:
        raise CaseFileError(refused)
    file = left_case(out, overrides)
    if overrides and file is None:
        text = f"{out}: there is no complete {CASE_FILE} that --set could change; give the run's script "
        raise ValueError(f"{text}tp.Simulation.resume(..., output_interval=...)")
    return None if file is None else CaseFile(**vars(file))


def _refused(override: str, allowed: Sequence[str]) -> str:
    """Why an override does not fit a run that goes on; empty if it does, or is to be told by `load_case`."""
    try:
        keys = keys_of(override.partition("=")[0].strip())
    except ValueError:
        return ""
    if keys == ["time", "end"]:
        return "the time to run to is given by --until"
    if keys == ["output", "folder"]:
        return "the results of a run stay in their folder"
    if keys[0] in allowed:
        return ""
    if keys[0] == "numerics":
        return "numbers of the method change the results; add --allow-changes"
    return (
        f"it changes the flow, and a run goes on with the flow it has; {', '.join(WRITTEN)} can be changed. Start "
        "another run by `tipfem run` with this --set"
    )


def require_same_flow(file: CaseFile, checkpoint: Mapping[str, Any], *, allow_changes: bool) -> None:
    """Check that a case file describes the flow of a checkpoint, and can write its results on.

    Raises:
        CaseFileError: it does not; each value that differs is named with its line.
    """
    problems = []
    added = set[str]()
    for line in differences(checkpoint["case"], case_record(file.case())):
        name, _, values = line.partition(": ")
        if values.startswith("'nothing', now") and name.count(".") > 1:  # one line for a wall that is new, say
            name, values = ".".join(name.split(".")[:2]), "not there, now given"
            if name in added:
                continue
            added.add(name)
        if not (allow_changes and name.startswith("numerics.")):
            place = file.problem(_path_of(name, file.data), "")
            but = ", except by --allow-changes" if name.startswith("numerics.") else ""
            why = f"{name}: {values}; the flow of a run that goes on cannot change{but}"
            problems.append(Problem(place.where, (), why, place.line))
    step, before = file.table.time.largest_step, checkpoint["settings"]["time_step"]
    if step is not None and step != before:
        text = f"is {step:g} s; the run has {before:g} s, which a run that goes on keeps"
        problems.append(file.problem(("time", "largest_step"), text))
    if reason := fields_refused(checkpoint["settings"]["fields"], file.fields):
        key = "fields" if reason[0] == "format" else reason[0]
        problems.append(file.problem(("output", key), reason[1].partition(" ")[2]))
    if problems:
        raise CaseFileError(problems)


def _path_of(name: str, data: Mapping[str, Any]) -> Path:
    """The path in a case file of a part of a case's record, as far as the two have the same names."""
    path: Path = ()
    node: Any = data
    for key in name.split("."):
        if isinstance(node, list):
            found = [k for k, item in enumerate(node) if isinstance(item, Mapping) and item.get("name") == key]
            if not found:
                break
            path, node = (*path, found[0]), node[found[0]]
        elif isinstance(node, Mapping) and key in node:
            path, node = (*path, key), node[key]
        else:
            break
    return path
