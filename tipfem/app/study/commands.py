"""The command sweep."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cyclopts import App

from tipfem.app.options import FilePath, Flag, Whole
from tipfem.app.running import bad_input, said
from tipfem.app.study.study import Study, load_study
from tipfem.casefile.describing import toml_value


def register(app: App) -> None:
    """Add the command to an application."""
    app.command(sweep, help_epilogue="")


def sweep(
    study: FilePath,
    /,
    *,
    workers: Whole | None = None,
    threads: Whole = 1,
    scheduler: str | None = None,
    dry_run: Flag = False,
    overwrite: Flag = False,
) -> int:
    """Run a study: one case with other values, many times; go on with one that was stopped.

    Args:
        study: The study file, in TOML.
        workers: How many runs go at the same time; by default as many as there are cores for.
        threads: CPU threads of each run.
        scheduler: Address of the scheduler of a Dask cluster, such as tcp://10.0.0.1:8786, whose workers take the runs
            in place of processes on this machine.
        dry_run: List the runs, how far they are and what they will take; run nothing.
        overwrite: Replace runs that are in the folder of the study, instead of going on with them.
    """
    with bad_input() as failed:
        read = load_study(study)
        for name, count in (("--workers", workers), ("--threads", threads)):
            if count is not None and count < 1:
                raise ValueError(f"{name} is {count}; it must be a whole number >= 1")
        if dry_run:
            _list(read)
            return 0
        # Here, for they import Taichi, which a study with a mistake does not need.
        from tipfem.app.study.cluster import DaskWorkers
        from tipfem.app.study.running import LocalWorkers, Sweep, Workers, prepare, usable_cores

        crew: Workers
        if scheduler is None:
            crew = LocalWorkers(workers or max(1, len(usable_cores()) // threads), threads)
        elif workers is not None:
            raise ValueError(f"--workers is {workers}, but --scheduler has workers of its own; give one of the two")
        else:
            crew = DaskWorkers(scheduler, threads, read.folder)
        prepare(read, overwrite=overwrite)
    if failed:
        return 2

    def ended(failures: dict[str, str]) -> None:
        try:
            _write(read, failures)
        except OSError as error:  # a full disk, say; the runs go on, and the table is written after the next one
            print(f"note: the table cannot be written: {error}")

    progress = Sweep(read, crew, print, ended)
    try:
        stopped = progress.run()
    except KeyboardInterrupt:
        return said(130, f"stopped at once; `tipfem sweep {study}` goes on from the last checkpoints")
    try:
        written = _write(read, progress.failures)
    except OSError as error:
        return said(1, f"error: the table of the runs, which have ended, cannot be written: {error}")
    if stopped:
        return said(128 + stopped, f"stopped; `tipfem sweep {study}` goes on")
    print(f"table: {', '.join(map(str, written))}")
    return 1 if progress.failures else 0


def _write(study: Study, failures: dict[str, str]) -> list[Path]:
    from tipfem.app.study.running import folder_of
    from tipfem.app.study.table import figures_of, status_of, write_table

    rows: list[dict[str, Any]] = []
    for run in study.runs:
        folder = folder_of(study, run)
        status = failures.get(run.name) or status_of(folder, run.file.end)
        rows.append({"run": run.name, "status": status, **run.values, **figures_of(folder)})
    return write_table(study.folder, rows)


def _list(study: Study) -> None:
    """Print the runs of a study."""
    from tipfem.app.study.running import folder_of
    from tipfem.app.study.table import status_of
    from tipfem.casefile.estimate import duration, estimate

    total = 0.0
    for run in study.runs:
        try:
            case = run.file.case()
        except ValueError as error:
            raise ValueError(f"run {run.name!r}: {error}") from None
        table = run.file.table
        taken = estimate(case, run.file.end, table.time.largest_step, table.output.interval)
        status = status_of(folder_of(study, run), run.file.end)
        total += 0.0 if status == "complete" else sum(taken.seconds) / 2
        values = ", ".join(f"{key} = {toml_value(value)}" for key, value in run.values.items())
        print(f"{run.name}: {values}; {taken.particles} particles, about {duration(sum(taken.seconds) / 2)}; {status}")
    print(f"{len(study.runs)} runs, about {duration(total)} of one core; results: {study.folder}")
