"""How fast a step is, where its time goes, and what other solvers take for the same systems.

The dam break of section 4.2 of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM
formulation", at t = 0.15 s; finer states are made from coarser ones by cutting every triangle into four. All sizes
are measured in one run, each in a process of its own, so that their ratios mean something on a machine that is
shared. Rivals for the linear systems: SciPy's SuperLU, PARDISO and pyamg if they are installed; for the mesh SciPy's
Delaunay; for the memory a copy of as many bytes as a step must move.

    python -m tipfem demo benchmarks/performance
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from tipfem.demos import harness
from tipfem.demos.benchmarks import cases, peers, states
from tipfem.demos.support.figures import new_figure, save
from tipfem.demos.support.options import Arch, Count, Flag

import tipfem as tp

# Sizes: distance of the particles in the run that a state is taken from [m], and how often it is refined.
SIZES = ((0.01, 1), (0.01, 2), (0.004, 1), (0.01, 3), (0.004, 2))
SHORT = ((0.03, 0), (0.03, 1))
DIRECT_LIMIT = 100_000  # particles up to which direct solvers are tried
STEPS = 10
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#999999", "#000000")

# Check: the largest figures that a run may show; see `check`.
MOST_ITERATIONS = 30  # of FGMRES to 1e-6; most states have 14 to 17
MOST_HARD = 35  # of systems that are hard for multigrid
MOST_GROWTH = 2.0  # of them, from the smallest size to the largest


def worker(state: str, refine: int, threads: int, arch: str, steps: int, result: str, solvers: bool) -> None:
    """Measure one size, and write the figures to a file, in a process of its own.

    Args:
        state: the file of the coarser state.
        refine: how often it is refined.
        threads: of the CPU.
        arch: where the kernels run.
        steps: that are measured.
        result: the file for the figures.
        solvers: whether the rivals of the linear solver are measured, too.
    """
    fields = dict(np.load(state))
    for _ in range(refine):
        fields = states.refined(fields)
    tp.init(arch=arch, threads=threads if arch == "cpu" else None)
    figures = cases.measure_steps(fields, steps)
    if solvers:
        figures["solvers"] = cases.measure_solvers(fields, direct=figures["particles"] <= DIRECT_LIMIT)
    Path(result).write_text(json.dumps(figures))


def measure(folder: Path, threads: int, steps: int, arch: str, *, short: bool) -> list[dict[str, Any]]:
    """All sizes, threads and devices, one process after the other; the figures of each."""
    sizes, found = SHORT if short else SIZES, []
    folder.mkdir(parents=True, exist_ok=True)
    for spacing in sorted({spacing for spacing, _ in sizes}, reverse=True):
        path = folder / f"state_{spacing * 1e3:g}mm.npz"
        if not path.exists():
            print(f"running the dam break at {spacing * 1e3:g} mm to t = {states.STATE_TIME:g} s", flush=True)
            _python(f"from tipfem.demos.benchmarks import states; states.make_state({str(path)!r}, {spacing!r})")
    jobs = [(size, threads, "cpu") for size in sizes]
    if arch == "cpu":
        jobs.insert(len(jobs) // 2 + 1, (sizes[len(sizes) // 2], 1, "cpu"))
    else:
        jobs = [(size, *where) for size in sizes for where in ((threads, "cpu"), (1, arch))]
    for (spacing, refine), many, where in jobs:
        result, state = folder / "worker.json", folder / f"state_{spacing * 1e3:g}mm.npz"
        words = (str(state), refine, many, where, steps, str(result), many == threads and arch == "cpu")
        _python(f"from tipfem.demos.benchmarks import performance; performance.worker(*{words!r})")
        found.append({"threads": many, "arch": where, **json.loads(result.read_text())})
        result.unlink()
        print(
            f"{found[-1]['particles']} particles, {_where(found[-1])}: {found[-1]['step'] * 1e3:.0f} ms per step",
            flush=True,
        )
    return sorted(found, key=lambda figures: (figures["arch"], figures["threads"], figures["particles"]))


def _python(code: str) -> None:
    if subprocess.run([sys.executable, "-c", code], check=False).returncode:
        harness.stop("a measurement failed; see its message above")


def _where(figures: Mapping[str, Any]) -> str:
    return figures["arch"] if figures["arch"] != "cpu" else f"{figures['threads']} thread(s)"


def table(found: Sequence[Mapping[str, Any]]) -> str:
    """The figures as tables in Markdown."""
    parts = [*cases.TIMERS, *cases.SHARED, "remeshing"]
    lines = [
        "Milliseconds a step, and where they go:",
        "",
        "| particles | on | step | "
        + " | ".join(parts)
        + " | rest | us a particle | of copying 12.5 kB a particle | Newton "
        "| Krylov per Newton | memory, MB | writing fields | Qhull |",
        "|" + "---|" * (len(parts) + 12),
    ]
    for f in found:
        ms = [f["parts"].get(name, 0.0) * 1e3 for name in parts]
        rest = f["step"] * 1e3 - sum(ms)
        copied = f["step"] / (f["particles"] * cases.BYTES_OF_A_STEP / f["copy"])
        lines.append(
            f"| {f['particles']} | {_where(f)} | {f['step'] * 1e3:.0f} | "
            + " | ".join(f"{v:.1f}" for v in ms)
            + f" | {rest:.1f} | {f['step'] / f['particles'] * 1e6:.2f} | {copied:.1f} | {f['newton']:.1f} | "
            f"{f['krylov']:.1f} | {f['memory'] / 1e6:.0f} | {f['output'] * 1e3:.0f} | {f['qhull'] * 1e3:.0f} |"
        )
    if any("solvers" in f for f in found):
        lines += [
            "",
            "The first Newton system of a step, to 1e-6 (seconds; times of ours in brackets):",
            "",
            "| particles | FGMRES iterations | ours | ours, matrix-free | with pyamg's cycle | PARDISO | SuperLU "
            "| product over copying its bytes | matrix-free product over it |",
            "|" + "---|" * 9,
        ]
    for f in found:
        if "solvers" not in f:
            continue
        s = f["solvers"]
        product = s["product"] / (s["product_bytes"] / s["copy"])
        amg = f"{s['pyamg']:.2f} ({s['pyamg_iterations']} iterations)" if "pyamg" in s else "not installed"
        free = f"{s['matrix_free']:.3f} ({s['matrix_free_iterations']} iterations)"
        direct = [f"{s[n]:.2f} ({s[n] / s['ours']:.0f})" if n in s else "-" for n in ("pardiso", "superlu")]
        lines.append(
            f"| {s['particles']} | {s['iterations']} | {s['ours']:.3f} | {free} | {amg} | "
            + " | ".join(direct)
            + f" | {product:.1f} | {s['matrix_free_product'] / s['product']:.1f} |"
        )
    first = ", ".join(f"{f['first_step']:.1f} ({f['particles']}, {_where(f)})" for f in found)
    speeds = ", ".join(f"{f['copy'] / 1e9:.0f} ({f['particles']}, {_where(f)})" for f in found)
    lines += ["", f"Seconds to make a simulation and take its first step, kernels included: {first}."]
    return "\n".join([*lines, "", f"Copying, GB/s read and written: {speeds}.", ""])


def kept(found: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The figures of a step that are kept from version to version, see `peers.keep`; wall-clock times."""
    head = {"flow": "dam_break_step", "code": "tipfem", "code_version": version("tipfem")}
    return [
        {
            **head,
            "resolution": f"{f['particles']} particles, {_where(f)}",
            "step": f["step"] * 1e3,
            "first_step": f["first_step"],
            "newton": f["newton"],
            "krylov": f["krylov"],
            "memory": f["memory"] / 1e6,
        }
        for f in found
    ]


def plot(path: Path, found: Sequence[Mapping[str, Any]]) -> None:
    """Time a particle of each part against the number of particles, and the rivals' times for one system."""
    from matplotlib.ticker import NullLocator

    figure = new_figure(12.0, 5.0, dpi=120)
    left, right = figure.subplots(1, 2)
    rows = [f for f in found if "solvers" in f]
    place, bottom = np.arange(len(rows)), np.zeros(len(rows))
    parts = [*cases.TIMERS, *cases.SHARED, "remeshing"]
    for name, colour in zip([*parts, "rest"], COLOURS, strict=False):
        value = np.array(
            [
                (f["step"] - sum(f["parts"].values()) if name == "rest" else f["parts"].get(name, 0.0))
                / f["particles"]
                * 1e6
                for f in rows
            ]
        )
        left.bar(place, value, 0.7, bottom=bottom, color=colour, label=name, edgecolor="white")
        bottom += value
    left.set_xticks(place, [f"{f['particles'] / 1e3:.0f}k" for f in rows])
    left.set(xlabel="particles", ylabel="time a step and particle [us]", title="Where the time of a step goes")
    left.set_ylim(0, 1.45 * bottom.max())
    left.legend(fontsize=9, ncols=3, loc="upper left")
    for name, key, style in (
        ("tipfem", "ours", "o-"),
        ("tipfem, matrix-free", "matrix_free", "d-"),
        ("with pyamg's cycle", "pyamg", "v:"),
        ("PARDISO", "pardiso", "s--"),
        ("SuperLU", "superlu", "^-."),
    ):
        known = [(f["solvers"]["particles"], f["solvers"][key]) for f in rows if key in f["solvers"]]
        if known:
            right.loglog(*zip(*known, strict=True), style, label=name, linewidth=2, markersize=7)
    right.set(xlabel="particles", ylabel="time [s]", title="One Newton system, solved to 1e-6")
    right.xaxis.set_minor_locator(NullLocator())
    right.set_xticks([f["particles"] for f in rows], [f"{f['particles'] / 1e3:.0f}k" for f in rows])
    right.grid(alpha=0.3, which="both")
    right.legend(fontsize=11)
    save(figure, path)


def _hard(systems: Mapping[str, tuple[int, int]]) -> str:
    lines = [f"| {name} | {particles} | {iterations} |" for name, (particles, iterations) in systems.items()]
    return "\n".join(
        ["", "Hard systems:", "", "| system | particles | FGMRES iterations |", "|---|---|---|", *lines, ""]
    )


def check(found: Sequence[Mapping[str, Any]], hard: Mapping[str, tuple[int, int]]) -> list[str]:
    """Limits that hold on every machine, loaded or not, and that the measurement exceeds; empty if all hold."""
    counts = [f["solvers"]["iterations"] for f in found if "solvers" in f]
    missed = [f"{n} iterations of FGMRES to 1e-6, above {MOST_ITERATIONS}" for n in counts if n > MOST_ITERATIONS]
    missed += [f"{n} iterations for {name}, above {MOST_HARD}" for name, (_, n) in hard.items() if n > MOST_HARD]
    if max(counts) > MOST_GROWTH * counts[0]:
        missed.append(f"iterations grow from {counts[0]} to {max(counts)}, by more than {MOST_GROWTH}")
    return missed


def main(
    *,
    out: Path = Path("out/performance"),
    threads: Count = 2,
    steps: Count = STEPS,
    arch: Arch = "cpu",
    short: Flag = False,
    keep_in: Path | None = None,
) -> int:
    """Measure everything.

    Args:
        out: folder for tables and figures.
        threads: CPU threads; one more run takes one.
        steps: time steps that are measured.
        arch: cuda or vulkan measure steps on a GPU, and the same ones on the processor, and nothing else.
        short: two small sizes only.
        keep_in: a CSV file that the figures of steps are added to, such as demos/benchmarks/figures.csv.
    """
    begun_with = peers.commit()  # the files may change while it runs
    found = measure(out, threads, steps, arch, short=short)
    text, missed = table(found), list[str]()
    if arch == "cpu":
        tp.init()
        hard = states.hard_systems(short)
        text, missed = text + _hard(hard), check(found, hard)
        plot(out / "performance.png", found)
    (out / "performance.md").write_text(text)
    (out / "performance.json").write_text(json.dumps(found, indent=1))
    if keep_in is not None:
        words = f"--threads {threads} --steps {steps} --arch {arch}" + " --short" * short
        peers.keep(keep_in, kept(found), f"tipfem demo benchmarks/performance {words}", begun_with)
    print(text)
    return harness.conclude(out, missed)


if __name__ == "__main__":
    harness.command(__name__)
