"""What a run that goes on may write otherwise than before: nothing that changes the flow, or loses what is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from tipfem.checkpoint import differences
from tipfem.errors import CheckpointError
from tipfem.fields import FieldOutput
from tipfem.probes import Probe, ProbeRecorder, probe_from, probe_record
from tipfem.run import require_intervals

Kept = Literal["kept"]
KEPT: Final[Kept] = "kept"  # in place of a setting that is to be as it was


@dataclass(frozen=True)
class Rewritten:
    """Settings of a run that goes on, where they may differ from those it had; "kept" stands for those.

    Attributes:
        output_interval: time between fields written to disk [s], or None for the last only.
        checkpoint_interval: simulated time between checkpoints [s], or None.
        checkpoint_wall_interval: wall-clock time between them [s], or None.
        fields: how fields are written.

    Raises:
        ValueError: a value is no length of time, or no way to write fields.
    """

    output_interval: float | Kept | None = KEPT
    checkpoint_interval: float | Kept | None = KEPT
    checkpoint_wall_interval: float | Kept | None = KEPT
    fields: str | FieldOutput = KEPT

    def __post_init__(self) -> None:
        given = {name: None if value == KEPT else value for name, value in vars(self).items()}
        if given.pop("fields") is not None:
            FieldOutput.of(self.fields)
        require_intervals(None, **given)

    def intervals(self, before: Mapping[str, Any]) -> tuple[dict[str, float | None], list[str]]:
        """The intervals to go on with, and a line on each that has changed.

        Args:
            before: the settings of the run.
        """
        chosen = {name: value for name, value in vars(self).items() if name != "fields" and value != KEPT}
        names = ("output_interval", "checkpoint_interval", "checkpoint_wall_interval")
        result = {name: before[name] for name in names} | chosen
        return result, [
            f"changed: {name}: {before[name]}, now {result[name]}" for name in names if before[name] != result[name]
        ]

    def field_output(self, before: FieldOutput) -> tuple[FieldOutput, list[str]]:
        """How fields are written from now on, and a line on what has changed.

        Args:
            before: how they have been written.

        Raises:
            CheckpointError: the states of the run would not be in one place, or not in one type of number.
        """
        if self.fields == KEPT:
            return before, []
        chosen = FieldOutput.of(self.fields)
        if reason := fields_refused(before, chosen):
            raise CheckpointError(f"fields: {reason[1]}")
        changed = chosen.precision != before.precision
        return chosen, [f"changed: precision of fields: {before.precision}, now {chosen.precision}"] if changed else []


def fields_refused(before: FieldOutput, chosen: FieldOutput) -> tuple[str, str] | None:
    """Which part of a way to write fields a run that goes on cannot have, and why; None if it can.

    Args:
        before: how they have been written.
        chosen: how they are to be written.
    """
    if chosen.format != before.format:
        return "format", (
            f"format is {chosen.format!r}; the run has written {before.format!r}, and all its states stay in one "
            "format: leave it, and convert the results afterwards by `tipfem convert`"
        )
    for name in ("precision", "compression") if before.vtkhdf else ():
        if getattr(chosen, name) != getattr(before, name):
            return name, (
                f"{name} is {getattr(chosen, name)!r}; fields.vtkhdf has {getattr(before, name)!r} from its first "
                "state on: leave it"
            )
    return None


def probes_to_go_on(
    recorded: Mapping[str, Any], probes: Sequence[Probe] | None, out: Path
) -> tuple[list[Probe], list[str]]:
    """The probes to go on with, and a line on each that has changed.

    Their intervals may change; probes may be added, whose files begin at the present time, and left out, whose files
    end there.

    Args:
        recorded: the probes of the run by their names, as a checkpoint has them.
        probes: those to go on with; None for those of the run.
        out: the results folder.

    Raises:
        CheckpointError: one measures something else under the same name, or has the file of one that was left out.
    """
    if probes is None:
        return [probe_from(record) for record in recorded.values()], []
    present = {probe.name: probe_record(probe) for probe in probes}
    both = [name for name in recorded if name in present]
    changed = differences({name: recorded[name] for name in both}, {name: present[name] for name in both})
    refused = [line for line in changed if not line.split(": ")[0].endswith(".interval")]
    if refused:
        raise CheckpointError(
            f"{out}: the probes are not those of the run: {'; '.join(refused)}; their intervals may change, and probes "
            "with names of their own may be added"
        )
    added = [name for name in present if name not in recorded]
    if taken := [name for name in added if (out / "probes" / f"{name}.csv").exists()]:
        raise CheckpointError(
            f"{out}: probes/{taken[0]}.csv is there from an earlier probe; give the probe another name"
        )
    notes = [f"changed: probe {line}" for line in changed]
    notes += [f"changed: probe {name!r} is added; its file begins here" for name in added]
    notes += [f"changed: probe {name!r} is left out; its file ends here" for name in recorded if name not in present]
    return list(probes), notes


def take_over_samples(
    recorder: ProbeRecorder, recorded: Mapping[str, Any], content: Mapping[str, Any], time: float
) -> None:
    """Let probes go on from the samples of a checkpoint.

    Args:
        recorder: of the probes to go on with.
        recorded: the probes of the run by their names.
        content: see `ProbeRecorder.content`.
        time: the present time [s].
    """
    recorder.go_on({name: samples for name, samples in content.items() if name in recorder.probes})
    for name, probe in recorder.probes.items():
        before = recorded.get(name)
        if before is None or dict(before).get("interval") != probe.interval:
            recorder.begin(name, time, afresh=before is None)
