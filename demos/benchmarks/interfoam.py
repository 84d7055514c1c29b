"""OpenFOAM's interFoam, a two-phase solver of the volume of fluid: cases in 2-D written, run and read back."""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import tipfem as tp

Array = NDArray[np.float64]

MISSING = "interFoam and blockMesh are not on the path: install OpenFOAM (on Debian: apt-get install openfoam)"
DEBIAN = Path("/usr/share/openfoam")

CONTROL = """application interFoam;
startFrom startTime; startTime 0; stopAt endTime; endTime {end};
deltaT 1e-4; writeControl adjustable; writeInterval {interval};
purgeWrite 0; writeFormat ascii; writePrecision 10; writeCompression off; timeFormat general; timePrecision 10;
runTimeModifiable no; adjustTimeStep yes; maxCo {courant}; maxAlphaCo {courant}; maxDeltaT {largest_step};
"""
# Second order in space with a limiter for the fraction; the pressure to 1e-7 as in OpenFOAM's own dam break.
SCHEMES = """ddtSchemes {{ default {scheme}; }}
gradSchemes {{ default Gauss linear; }}
divSchemes
{{
    div(rhoPhi,U) Gauss linearUpwind grad(U);
    div(phi,alpha) Gauss vanLeer;
    div(phirb,alpha) Gauss linear;
    div(((rho*nuEff)*dev2(T(grad(U))))) Gauss linear;
}}
laplacianSchemes {{ default Gauss linear corrected; }}
interpolationSchemes {{ default linear; }}
snGradSchemes {{ default corrected; }}
"""
SOLUTION = """solvers
{
    "alpha.water.*"
    {
        nAlphaCorr 2; nAlphaSubCycles 1; cAlpha 1; MULESCorr yes; nLimiterIter 5;
        solver smoothSolver; smoother symGaussSeidel; tolerance 1e-8; relTol 0;
    }
    "pcorr.*" { solver PCG; preconditioner DIC; tolerance 1e-5; relTol 0; }
    p_rgh { solver PCG; preconditioner DIC; tolerance 1e-7; relTol 0.05; }
    p_rghFinal { $p_rgh; relTol 0; }
    U { solver smoothSolver; smoother symGaussSeidel; tolerance 1e-6; relTol 0; }
}
PIMPLE
{
    momentumPredictor no; nOuterCorrectors 1; nCorrectors 3; nNonOrthogonalCorrectors 0; pRefCell 0; pRefValue 0;
}
relaxationFactors { equations { ".*" 1; } }
"""
TRANSPORT = """phases (water air);
water {{ transportModel Newtonian; nu {nu[0]!r}; rho {rho[0]!r}; }}
air {{ transportModel Newtonian; nu {nu[1]!r}; rho {rho[1]!r}; }}
sigma {sigma!r};
"""


class NoInterFoam(ValueError):
    """OpenFOAM is not installed."""


Point = tuple[float, float]
Edge = tuple[Point, Point]


@dataclass(frozen=True)
class Blocks:
    """A mesh of quadrilaterals, each with cells of its own number along its sides.

    Attributes:
        cells: their corners [m], counter-clockwise from the lower left, and how many cells are in each from left to
            right and upwards.
        patches: edges of the hull by name, from which the fluids are on the left. The others are "walls".
        conditions: by name of a patch and of its field; patches without them are walls.
    """

    cells: Sequence[tuple[Sequence[Point], tuple[int, int]]]
    patches: Mapping[str, Sequence[Edge]]
    conditions: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    def walls(self) -> list[Edge]:
        """Edges of the hull that are in no patch."""
        edges = [edge for corners, _ in self.cells for edge in zip(corners, [*corners[1:], corners[0]], strict=True)]
        taken = {edge for patch in self.patches.values() for edge in patch}
        return [edge for edge in edges if edge not in taken and edge[::-1] not in edges]


@dataclass(frozen=True)
class Flow:
    """Two fluids in a rectangle that is closed, or in blocks.

    Attributes:
        size: of the rectangle [m].
        cells: along its sides.
        fluids: the lower one, and the one above.
        fraction: (ny, nx) of the lower fluid in each cell at the start; of blocks one after the other, row by row.
        slip: whether the walls slip, or the names of those that do.
        end: simulated time to run to [s].
        interval: between stored times [s].
        courant: largest Courant number.
        largest_step: [s].
        scheme: of the time integration.
        sigma: surface tension [N/m].
        gravity: downwards [m/s^2].
        blocks: in place of the rectangle, whose size and cells say how thick the mesh is.
    """

    size: tuple[float, float]
    cells: tuple[int, int]
    fluids: tuple[tp.Fluid, tp.Fluid]
    fraction: Array
    slip: bool | tuple[str, ...]
    end: float
    interval: float
    courant: float = 1.0
    largest_step: float = 1.0
    scheme: str = "Euler"
    sigma: float = 0.0
    gravity: float = 9.81
    blocks: Blocks | None = None

    @property
    def thickness(self) -> float:
        """Of the only layer of cells [m]."""
        return self.size[0] / self.cells[0]


@dataclass(frozen=True)
class Run:
    """A run that has ended.

    Attributes:
        seconds: processor time of the solver [s].
        steps: their number.
        version: of OpenFOAM, as its log says it.
        time: (K,) stored times [s].
        fraction: of the lower fluid at each of them.
        speed: (K,) the largest of all cells [m/s].
    """

    seconds: float
    steps: int
    version: str
    time: Array
    fraction: Array
    speed: Array


def require() -> None:
    """Refuse to go on without interFoam.

    Raises:
        NoInterFoam: it is not there.
    """
    if not (shutil.which("interFoam") and shutil.which("blockMesh")):
        raise NoInterFoam(MISSING)


def run(flow: Flow, folder: Path) -> Run:
    """Write a case, run it on one core, and read the fractions at its stored times.

    Args:
        flow: what is simulated.
        folder: for the case; what is there is replaced.

    Raises:
        NoInterFoam: it is not there.
        RuntimeError: it fails.
    """
    require()
    shutil.rmtree(folder, ignore_errors=True)
    _write(flow, folder)
    _call(folder, "blockMesh")
    before = os.times()
    _call(folder, "interFoam")
    after = os.times()
    seconds = after.children_user + after.children_system - before.children_user - before.children_system
    log = (folder / "log.interFoam").read_text(encoding="utf-8")
    steps = len(re.findall(r"^Time = ", log, re.MULTILINE))
    found = re.search(r"OPENFOAM=v?(\w+)|Version: +(\w+)", log)
    version = (found[1] or found[2]) if found else "of an unknown version"
    stored = sorted((p for p in folder.iterdir() if re.fullmatch(r"[\d.e+-]+", p.name)), key=lambda p: float(p.name))
    fractions = [_read(path / "alpha.water", flow) for path in stored]
    speeds = [_largest_speed(path / "U") for path in stored]
    time = np.array([float(p.name) for p in stored])
    return Run(seconds, steps, version, time, np.array(fractions), np.array(speeds))


def front(flow: Flow, fraction: Array) -> float:
    """Largest x of the lower fluid [m] along the floor, where its fraction is a half, linear between cells."""
    row, h = fraction[0], flow.size[0] / flow.cells[0]
    i = int(np.flatnonzero(row >= 0.5).max())
    beyond = (row[i] - 0.5) / (row[i] - row[i + 1]) if i + 1 < len(row) else 0.5
    return float((i + 0.5 + beyond) * h)


def mode(flow: Flow, fraction: Array) -> float:
    """Amplitude of the first mode [m]: 2 / L times the integral of cos(pi x / L) over the lower fluid."""
    (length, height), (nx, ny) = flow.size, flow.cells
    edges = np.sin(math.pi * np.linspace(0.0, 1.0, nx + 1)) * length / math.pi
    return float(2 / length * (fraction.sum(axis=0) * height / ny) @ np.diff(edges))


def _call(folder: Path, program: str) -> None:
    log = folder / f"log.{program}"
    # Debian's package keeps OpenFOAM's own settings in a folder that its programs ask the environment for.
    settings = {"WM_PROJECT_DIR": str(DEBIAN), **os.environ} if DEBIAN.is_dir() else None
    with log.open("w") as file:
        done = subprocess.run([program], cwd=folder, stdout=file, stderr=subprocess.STDOUT, env=settings, check=False)
    if done.returncode:
        raise RuntimeError(f"{program} failed in {folder}; {log.name} there says why: {log.read_text()[-300:].strip()}")


def _write(flow: Flow, folder: Path) -> None:
    """All files of a case."""
    x, y = flow.size
    box = (0.0, 0.0), (x, 0.0), (x, y), (0.0, y)
    sides = {name: [(box[k], box[(k + 1) % 4])] for k, name in enumerate(("bottom", "right", "top", "left"))}
    blocks = flow.blocks or Blocks([(box, flow.cells)], sides)
    points = list(dict.fromkeys(point for corners, _ in blocks.cells for point in corners))
    number = {point: k for k, point in enumerate(points)}
    count, names = len(points), {**blocks.patches, **({"walls": walls} if (walls := blocks.walls()) else {})}
    corners = " ".join(f"({a!r} {b!r} {c!r})" for c in (0.0, flow.thickness) for a, b in points)
    hexes = " ".join(
        f"hex ({' '.join(str(number[point] + up) for up in (0, count) for point in of)}) ({nx} {ny} 1) "
        "simpleGrading (1 1 1)"
        for of, (nx, ny) in blocks.cells
    )
    patches = ""
    for name, edges in names.items():
        ends = [(number[a], number[b]) for a, b in edges]
        faces = " ".join(f"({a} {b} {b + count} {a + count})" for a, b in ends)
        patches += f"{name} {{ type {'patch' if name in blocks.conditions else 'wall'}; faces ({faces}); }} "
    rho = [fluid.density for fluid in flow.fluids]
    nu = [fluid.viscosity / fluid.density for fluid in flow.fluids]
    values = "\n".join(f"{value:.10g}" for value in flow.fraction.ravel())
    fields = {
        "alpha.water": (
            "volScalarField",
            "0 0 0 0 0 0 0",
            f"nonuniform List<scalar> {flow.fraction.size}\n(\n{values}\n)",
            "zeroGradient",
        ),
        "U": ("volVectorField", "0 1 -1 0 0 0 0", "uniform (0 0 0)", "noSlip"),
        "p_rgh": ("volScalarField", "1 -1 -2 0 0 0 0", "uniform 0", "fixedFluxPressure; value uniform 0"),
    }
    texts = {
        "system/blockMeshDict": f"scale 1; vertices ( {corners} ); edges (); mergePatchPairs ();\n"
        f"blocks ( {hexes} );\nboundary ( {patches} );\n",
        "system/controlDict": CONTROL.format(
            end=flow.end, interval=flow.interval, courant=flow.courant, largest_step=flow.largest_step
        ),
        "system/fvSchemes": SCHEMES.format(scheme=flow.scheme),
        "system/fvSolution": SOLUTION,
        "constant/transportProperties": TRANSPORT.format(nu=nu, rho=rho, sigma=flow.sigma),
        "constant/turbulenceProperties": "simulationType laminar;\n",
        "constant/g": f"dimensions [0 1 -2 0 0 0 0]; value (0 {-flow.gravity!r} 0);\n",
    }
    slippery = names if flow.slip is True else flow.slip or ()
    for name, (_, units, inside, condition) in fields.items():
        of = {wall: "slip" if name == "U" and wall in slippery else condition for wall in names}
        of |= {patch: given[name] for patch, given in blocks.conditions.items()}
        at_walls = " ".join(f"{wall} {{ type {each}; }}" for wall, each in of.items())
        texts[f"0/{name}"] = (
            f"dimensions [{units}];\ninternalField {inside};\n"
            f"boundaryField {{ {at_walls} defaultFaces {{ type empty; }} }}\n"
        )
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        kind = fields[path.name][0] if path.name in fields else "dictionary"
        kind = "uniformDimensionedVectorField" if path.name == "g" else kind
        head = f"FoamFile {{ version 2.0; format ascii; class {kind}; object {path.name}; }}\n"
        path.write_text(head + text, encoding="utf-8")


def _largest_speed(path: Path) -> float:
    """The largest speed in the cells at a stored time [m/s]; 0 where it is the same everywhere, as at the start."""
    text = path.read_text(encoding="utf-8")
    found = re.search(r"internalField\s+nonuniform\s+List<vector>\s*\d+\s*\(\s*((?:\([^)]*\)\s*)*)\)", text)
    if not found:
        return 0.0
    vectors = np.array(re.sub(r"[()]", " ", found[1]).split(), float).reshape(-1, 3)
    return float(np.linalg.norm(vectors, axis=1).max())


def _read(path: Path, flow: Flow) -> Array:
    """The fractions of a stored time, as those of the start."""
    text = path.read_text(encoding="utf-8")
    found = re.search(r"internalField\s+nonuniform\s+List<scalar>\s*\d+\s*\(([^)]*)\)", text)
    if not found:
        raise RuntimeError(f"{path} has no field of fractions")
    return np.array(found[1].split(), float).reshape(flow.fraction.shape)
