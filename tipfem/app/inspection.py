"""Contents of a results folder, and the software that the machine has of what tipfem needs."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from tipfem.case.fluid import described_viscosity
from tipfem.case.rheology import law_from
from tipfem.casefile.estimate import duration
from tipfem.results.folder_lock import FolderLock
from tipfem.results.reader import read_results

TIMEOUT = 60.0  # of an examination in a process of its own [s]


def _states(folder: Path) -> str:
    """Number of states in a folder, and the file that lists them."""
    from tipfem.results.fields import vtkhdf

    files = len(list((folder / "fields").glob("step_*.vtu")))
    if not (folder / vtkhdf.NAME).is_file():
        return f"{files} in fields.pvd" if files else "none"
    count = len(vtkhdf.times(folder / vtkhdf.NAME)[0])
    return f"{count} in {vtkhdf.NAME}" + (f", {files} in fields.pvd" if files else "")


def describe_results(folder: Path) -> list[str]:
    """Lines on a results folder; `ValueError` if it is none, or a file in it cannot be read."""
    results = read_results(folder)
    case, history, summary = results.case, results.history, results.summary
    lines = [f"case        {case.get('title') or 'without a title'}"]
    fluids = []
    for fluid in case.get("fluids", []):
        viscosity = described_viscosity(law_from(fluid["viscosity"]))
        fluids.append(f"{fluid['name']} ({fluid['density']:g} kg/m^3, {viscosity})")
    lines.append(f"fluids      {', '.join(fluids)}")
    size = case.get("size") or [high - low for low, high in zip(case["lower"], case["upper"], strict=True)]
    around = ", radius and height of an axisymmetric flow" if case.get("coordinates") == "axisymmetric" else ""
    lines.append(f"size        {' x '.join(f'{edge:g}' for edge in size)} m{around}, spacing {case['spacing']:g} m")
    lines.append(f"interface   {case.get('interface')}{', free surface' if case.get('free_surface') else ''}")
    if not history.rows:
        lines.append("steps       none yet")
    else:
        time, particles, speed = (history[name][-1] for name in ("time", "particles", "max_speed"))
        lines.append(f"steps       {history.rows}, to t = {time:g} s, {particles} particles")
        lines.append(f"speed       at most {speed:.4g} m/s in the last step")
    if not summary:
        running = FolderLock(folder).is_held()
        lines.append(f"status      no summary: {'still running' if running else 'it was killed'}")
    else:
        lines.append(f"status      {summary.get('status')} after {duration(float(summary['wall_seconds']))}")
        how = [str(summary[key]) for key in ("arch", "precision") if key in summary]
        lines.append(f"back end    {', '.join(how)}")
        for name, value in {**summary.get("validation", {}), "check": summary.get("check")}.items():
            if value is not None:
                lines.append(f"figure      {name} {value if not isinstance(value, float) else f'{value:.4g}'}")
        if errors := summary.get("numerical_error"):
            lines.append("numerics    " + ", ".join(f"{name} {value:.2g}" for name, value in errors.items()))
        versions = summary.get("versions", {})
        lines.append("versions    " + ", ".join(f"{name} {number}" for name, number in versions.items()))
    total = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    lines += [f"probes      {', '.join(results.probes)}"] if results.probes else []
    return [*lines, f"states      {_states(folder)}", f"on disk     {total / 1e6:.1f} MB"]


@dataclass(frozen=True)
class Finding:
    """One thing that was examined."""

    name: str  # of it
    fine: bool  # whether it is there
    what: str  # what was found
    cure: str = ""  # the command that brings it, or what to do
    needed: bool = True  # whether nothing runs without it

    def __str__(self) -> str:
        mark = "ok     " if self.fine else "MISSING" if self.needed else "none   "
        return f"{mark}  {self.name:14s} {self.what}" + (f"\n{'':9}{'':15}{self.cure}" if not self.fine else "")


def examine() -> list[Finding]:
    """All that tipfem needs or can use. What could end the process is tried in another one."""
    return [
        _python(),
        _taichi(),
        _starts("processor", "import tipfem; tipfem.init('cpu')", "pip install --force-reinstall taichi==1.7.4"),
        _starts(
            "CUDA",
            "import tipfem; tipfem.init('cuda')",
            "optional; needs an NVIDIA GPU and its driver (on Debian: apt-get install nvidia-driver)",
            needed=False,
        ),
        _starts(
            "Vulkan",
            # Its output is what is said of it.
            "from tipfem.render.vulkan import software_driver\n"
            "if found := software_driver():\n"
            "    print(f'starts, in software alone ({found}): the rasteriser draws pictures')\n"
            "from tipfem.render.ggui import GGUICanvas; GGUICanvas((64, 64)).close()",
            "optional, for GGUI's pictures; on Debian: apt-get install libvulkan1 mesa-vulkan-drivers. "
            "The rasteriser draws without it.",
            needed=False,
        ),
        _ffmpeg(),
        _cache(),
        _threads(),
        _package("matplotlib", "optional, for the demos' figures: pip install 'tipfem[plot]'"),
        _package("websockets", "optional, for tipfem view: pip install 'tipfem[view]'"),
        _package("anywidget", "optional, for the viewer in notebooks: pip install 'tipfem[notebook]'"),
    ]


def _python() -> Finding:
    fine = (3, 10) <= sys.version_info[:2] < (3, 14) and sys.maxsize > 2**32
    what = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    return Finding("Python", fine, what, "install a 64-bit Python 3.10 to 3.13; Taichi has no other")


def _taichi() -> Finding:
    try:
        found = version("taichi")
    except PackageNotFoundError:
        found = "not installed"
    return Finding("Taichi", found == "1.7.4", found, "pip install taichi==1.7.4")


def _package(name: str, cure: str) -> Finding:
    try:
        return Finding(name, True, version(name), needed=False)
    except PackageNotFoundError:
        return Finding(name, False, "not installed", cure, needed=False)


def _starts(name: str, code: str, cure: str, *, needed: bool = True) -> Finding:
    """Whether some Python ends without an error, in a process of its own."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, timeout=TIMEOUT, check=False
        )
    except subprocess.TimeoutExpired:
        return Finding(name, False, f"does not start within {TIMEOUT:g} s", cure, needed)
    if done.returncode == 0:
        said = [line for line in done.stdout.splitlines() if line.startswith("starts")]
        return Finding(name, True, said[-1] if said else "starts", needed=needed)
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    why = lines[-1].strip()[:100] if lines else f"ended by signal {-done.returncode}"
    return Finding(name, False, why, cure, needed)


def _ffmpeg() -> Finding:
    cure = "needed for movies: pip install --force-reinstall imageio-ffmpeg"
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return Finding("ffmpeg", True, get_ffmpeg_exe(), needed=False)
    except (ImportError, RuntimeError) as error:
        return Finding("ffmpeg", False, str(error).splitlines()[0], cure, needed=False)


def _cache() -> Finding:
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path(os.environ.get("HOME") or "/nonexistent") / ".cache")
    place = next((path for path in (folder, *folder.parents) if path.exists()), folder)
    cure = f"kernels are compiled anew in every start; make {folder} writable, or set XDG_CACHE_HOME to such a folder"
    try:
        with tempfile.TemporaryFile(dir=place):
            return Finding("cache folder", True, f"{folder} can be written to", needed=False)
    except OSError as error:
        return Finding("cache folder", False, f"{folder}: {error.strerror}", cure, needed=False)


def _threads() -> Finding:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return Finding("threads", True, f"{cores}, as many as there are cores for this process")
