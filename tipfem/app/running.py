"""The commands that run: run and resume.

Both return an exit code, see `tipfem.app.commands.EXIT_CODES`, and end in an orderly way when they are told to
stop; see `tipfem.run.steering.stop_request.StopRequest`.
"""

from __future__ import annotations

import functools
import json
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec

from tipfem.app.options import Arch, FilePath, Flag, Number, Overrides, Shown, Start, Whole, printable
from tipfem.arguments import is_number
from tipfem.casefile.problems import CaseFileError
from tipfem.logs import log_json, log_lines
from tipfem.results.output import CASE_FILE
from tipfem.results.remeshing_table import remeshing_table
from tipfem.run.progress import on_terminal

if TYPE_CHECKING:
    from tipfem.case.case import Case
    from tipfem.run.case_file import CaseFile
    from tipfem.run.liveview.control import LiveControl
    from tipfem.run.simulation import Column, Simulation
    from tipfem.run.steering import RunControl

P = ParamSpec("P")
RESULTS = ("case.json", "history.csv", "summary.json")
# Written by the harness of the demos: the words of the command that goes on with the run.
COMMAND_FILE = "command.json"


def run(
    case: FilePath,
    /,
    *,
    until: Number | None = None,
    start: Start = Start(),  # noqa: B008 - it is frozen, as Shown is
    shown: Shown = Shown(),  # noqa: B008
) -> int:
    """Run a case file.

    Args:
        case: The case file, in TOML.
        until: Simulated time to run to [s], in place of time.end.
    """
    with ExitStack() as log:
        with bad_input() as failed:
            file, made = loaded(case, start.set, until)
            simulation, control = begun(file, made, start, shown, log)
        return 2 if failed else run_to(simulation, file.end, progress=shown.progress, control=control)


def begun(
    file: CaseFile,
    case: Case,
    start: Start,
    shown: Shown,
    log: ExitStack,
    *,
    columns: Mapping[str, Column] | None = None,
    again: bool = False,
) -> tuple[Simulation, LiveControl | None]:
    """The simulation of a case file at its start, in a folder of its own, and what shows it; starts Taichi.

    ``log`` closes the log at its end; ``columns`` are further ones, see `Simulation`; with ``again`` a run of less than
    ten minutes is replaced without being asked to.

    Raises:
        ValueError: an option is not possible, or there are results in the folder.
    """
    from tipfem.backend import runtime
    from tipfem.casefile.hints import hints

    folder = start.out or file.folder
    found = [] if again else [name for name in RESULTS if (folder / name).exists()]
    if found and not start.overwrite:
        text = f"{folder} holds results ({found[0]}); choose another folder by --out, say --overwrite, or go on "
        raise ValueError(f"{text}with that run by `tipfem resume {folder}`")
    for hint in hints(case, file.end, file.table.output.interval, file.parts.probes):
        print(f"note: {printable(hint)}", file=sys.stderr)
    open_log(log, shown)
    runtime.init(start.arch, threads=start.threads)
    simulation = started(
        file, case, folder, start.steering, columns, overwrite=(start.overwrite or None) if again else True
    )
    return simulation, viewer_of(simulation, shown)


def resume(
    out: FilePath,
    /,
    *,
    until: Number | None = None,
    set: Overrides = None,
    allow_changes: Flag = False,
    threads: Whole | None = None,
    arch: Arch | None = None,
    shown: Shown = Shown(),  # noqa: B008 - it is frozen
) -> int:
    """Go on with a run that was stopped or killed, from its newest checkpoint; from its start, if it has none yet.

    Args:
        out: The results folder.
        until: Simulated time to run to [s]; by default that which the run was to reach.
        set: What is written from now on, in place of what the folder's case.toml says: output.interval=0.005, and
            others of output, checkpoint and probes. Can be given several times.
        allow_changes: Go on although numbers of the method in the folder's case.toml have been changed.
        threads: Number of CPU threads; by default as many as there are cores.
        arch: cpu, cuda or vulkan; by default what the run had.
    """
    log = ExitStack()
    with bad_input() as failed:
        open_log(log, shown)
        if until is not None and not (is_number(until) and until > 0):
            raise ValueError(f"--until is {until} s; it must be a number > 0 in s")
        simulation, end = resumed(
            out, until=until, threads=threads, arch=arch, overrides=set or (), allow_changes=allow_changes
        )
        for note in simulation.notes:
            print(f"note: {printable(note)}", file=sys.stderr)
        if until is not None and until < simulation.time:
            raise ValueError(f"--until is {until:g} s; it must be later than the {simulation.time:g} s that are done")
    with log:
        if failed:
            return 2
        if simulation.time >= end:
            if not (out / "summary.json").exists():  # the run was killed before its last line
                simulation.write_summary({"status": "complete"})
            print(f"t = {simulation.time:g} s has been reached; give a later --until to go on; results: {out}")
            return 0
        with bad_input() as failed:
            control = viewer_of(simulation, shown)
        if failed:
            return 2
        at = simulation.step_number
        begun = f"from step {at}, t = {simulation.time:g} s" if at else "from t = 0"
        print(f"going on {begun} to t = {end:g} s", file=sys.stderr)
        return run_to(simulation, end, progress=shown.progress, control=control)


def open_log(stack: ExitStack, shown: Shown) -> None:
    """Send a command's log to a file of JSON, and to the error output where there is no progress bar.

    ``stack`` closes both. Without progress, only warnings and errors are printed; `ValueError` if the file cannot be
    written.
    """
    if shown.log_json is not None:
        stack.enter_context(log_json(shown.log_json))
    if not on_terminal():
        level = shown.log_level
        stack.enter_context(log_lines(level if shown.progress or level != "info" else "warning"))


def resumed(
    out: Path,
    *,
    until: float | None = None,
    threads: int | None = None,
    arch: str | None = None,
    overrides: Sequence[str] = (),
    allow_changes: bool = False,
) -> tuple[Simulation, float]:
    """The simulation that goes on with a run, and the time to which it does [s]; starts Taichi.

    Args:
        out: the results folder.
        until: that time [s]; None for that which the run was to reach.
        threads: number of CPU threads, or None for as many as there are cores.
        arch: "cpu", "cuda" or "vulkan", or None for what the run had.
        overrides: what is written from now on, in place of what the folder's case file says; see `tipfem.load_case`.
        allow_changes: see `Simulation.resume`.

    Raises:
        ValueError: the folder is none of a run that can go on, or its case file has mistakes or another flow.
        CheckpointError: see `Simulation.resume`.
    """
    from tipfem.app.changes import file_to_go_on
    from tipfem.backend import runtime
    from tipfem.run.checkpoint import CheckpointFolder

    if not out.is_dir():
        what = "is a file" if out.exists() else "there is no such folder"
        raise ValueError(f"{out}: {what}; give the results folder of a run")
    if words := demo_command(out):
        raise ValueError(f"{out}: the run is that of a script; go on with it by: {' '.join(words)}")
    checkpoints = CheckpointFolder(out)
    file = file_to_go_on(out, overrides, allow_changes=allow_changes)
    if not checkpoints.files():
        if file is None:
            raise ValueError(f"{out}: it holds neither checkpoints nor {CASE_FILE}; give the results folder of a run")
        runtime.init(arch or "cpu", threads=threads)
        return started(file, file.case(), out), file.end if until is None else until
    if file is not None:
        simulation = gone_on(out, file, threads=threads, arch=arch, allow_changes=allow_changes)
        if until is None and file.end > simulation.until:
            simulation.notes.append(
                f"{CASE_FILE} has time.end = {file.end:g} s, and the run is to reach {simulation.until:g} s; "
                f"`--until {file.end:g}` goes on further"
            )
    else:
        from tipfem.run.simulation import Simulation

        before = checkpoints.read()["environment"]
        runtime.init(arch or before["arch"], before["precision"], threads)
        simulation = Simulation.resume(out, allow_changes=allow_changes)
    return simulation, simulation.until if until is None else until


def gone_on(
    out: Path,
    file: CaseFile,
    *,
    threads: int | None = None,
    arch: str | None = None,
    allow_changes: bool = False,
    columns: Mapping[str, Column] | None = None,
) -> Simulation:
    """The simulation that a run was at its newest checkpoint, with what a case file says is written from now on.

    See `resumed` for ``threads``, ``arch`` and ``allow_changes``, `Simulation.resume` for ``columns``.

    Raises:
        ValueError: the file describes another flow.
        CheckpointError: see `Simulation.resume`.
    """
    from tipfem.app.changes import require_same_flow
    from tipfem.backend import runtime
    from tipfem.run.checkpoint import CheckpointFolder
    from tipfem.run.simulation import Simulation

    newest = CheckpointFolder(out).read()
    before = newest["environment"]
    runtime.init(arch or before["arch"], before["precision"], threads)
    require_same_flow(file, newest, allow_changes=allow_changes)
    written = {name: value for name, value in file.options().items() if name != "time_step"}  # which is kept
    return Simulation.resume(out, file.case(), columns=columns, allow_changes=allow_changes, **written)


def started(
    file: CaseFile,
    case: Case,
    folder: Path,
    steering: Path | None = None,
    columns: Mapping[str, Column] | None = None,
    overwrite: bool | None = True,
) -> Simulation:
    """The simulation of a case file at its start, with the whole case in its results folder; see `Simulation`.

    Raises:
        ValueError: the steering file has a mistake, the case cannot be meshed, or the folder cannot be written to.
    """
    from tipfem.casefile.describing import write_case

    simulation = file.simulation(folder, columns, case, steering, overwrite)
    assert simulation.results is not None
    written = write_case(folder / CASE_FILE, case, file.end, folder=str(folder), **file.settings())
    for name in (CASE_FILE, "case.npz", written.mesh_file):
        if name and (folder / name).exists():
            simulation.results.list_file(name)
    return simulation


def viewer_of(simulation: Simulation, shown: Shown) -> LiveControl | None:
    """Viewer of a run in a browser, or None; see `tipfem.live` for errors."""
    if not shown.view:
        return None
    from tipfem.run.liveview.control import LiveControl

    return LiveControl(
        simulation, port=shown.port, browser=not shown.no_browser, say=lambda line: print(line, flush=True)
    )


def run_to(simulation: Simulation, end: float, *, progress: bool, control: RunControl | None = None) -> int:
    """Run a simulation with a results folder to a time [s], say how it went, and return the exit code."""
    from tipfem.errors import SimulationError

    assert simulation.results is not None
    folder = simulation.results.path
    try:
        simulation.run(end, progress=progress, control=control)
    except SimulationError as error:
        return said(1, f"error: {error}\nthe results up to there are in {folder}")
    except KeyboardInterrupt:
        return _stopped(128 + signal.SIGINT, simulation, folder)
    except SystemExit as stop:
        return _stopped(int(stop.code or 0), simulation, folder)
    if simulation.time < end:
        print(f"stopped by a command at t = {simulation.time:g} s; `tipfem resume {folder}` goes on from there")
        return 0
    if simulation.steering.pending:
        record = simulation.steering.pending[0]
        print(f"note: the run ended before step {record.step}, at which the next command was to be repeated")
    row = simulation.history[-1]
    print(f"{row['step']} steps to t = {row['time']:g} s in {row['wall_seconds']:.0f} s; results: {folder}")
    if sums := simulation.remeshing_sums():
        print(remeshing_table(sums))
    return 0


def _stopped(code: int, simulation: Simulation, folder: Path) -> int:
    return said(code, f"stopped at t = {simulation.time:g} s; `tipfem resume {folder}` goes on from there")


def demo_command(out: Path) -> list[str]:
    """The words of the command that goes on with a demo's run; empty for other runs."""
    try:
        words: Any = json.loads((out / COMMAND_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return []
    return [str(word) for word in words] if isinstance(words, list) else []


def loaded(path: Path, overrides: Sequence[str] | None, until: float | None = None) -> tuple[CaseFile, Case]:
    """A case file with overrides, see `tipfem.load_case`, and its case, to end at ``until`` [s].

    Raises:
        ValueError: the file has mistakes, or ``until`` is no time.
    """
    from tipfem.run.case_file import load_case

    given = list(overrides or ())
    if until is not None:
        if not (is_number(until) and until > 0):
            raise ValueError(f"--until is {until} s; it must be a number > 0 in s")
        given.append(f"time.end={until!r}")
    file = load_case(path, given)
    return file, file.case()


@contextmanager
def bad_input() -> Iterator[list[str]]:
    """Print the errors that are raised in the block to the error output, and add them to the list that it yields."""
    failed: list[str] = []
    try:
        yield failed
    except CaseFileError as error:
        count = len(error.problems)
        failed.append(f"{error}\n{count} mistake{'s' if count > 1 else ''}; nothing was started")
    except BrokenPipeError:  # the reader of the output, such as head, has closed it
        raise
    except (ValueError, RuntimeError, OSError) as error:
        failed.append(f"error: {error}")
    if failed:
        print(printable(failed[0]), file=sys.stderr)


def refusing(command: Callable[P, None]) -> Callable[P, int]:
    """A decorator of commands: the exit code, 2 with the error in one line where it refuses what it is given."""

    @functools.wraps(command)
    def run(*given: P.args, **options: P.kwargs) -> int:
        with bad_input() as failed:
            command(*given, **options)
        return 2 if failed else 0

    return run


def said(code: int, message: str) -> int:
    """Print a message on the error output; returns the exit code."""
    print(printable(message), file=sys.stderr)
    return code
