"""The house: who may import whom, and what every file owes its reader. Read from the sources, nothing is run.

CONTRIBUTING.md says the same in words. When the package grows a file, add it to ORDER below and there.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

# Top first: a file of tipfem/ imports only from the files above it in this list.
ORDER = [
    "errors",
    "validation",
    "fluid",
    "particles",
    "faces",
    "lattice",
    "grading",
    "walls",
    "geometry",
    "mesh",
    "triangulation",
    "alpha_shape",
    "free_surface",
    "interface",
    "relocation_rule",
    "places",
    "relocation",
    "transfer",
    "probes",
    "fitting",
    "numerics",
    "launcher",
    "array_launch",
    "device",
    "surgery",
    "grading_kernels",
    "interface_kernels",
    "edge_kernels",
    "flip_kernels",
    "conservation_kernels",
    "conservation",
    "remeshing_kernels",
    "connectivity",
    "element",
    "assembly",
    "jacobian_rows",
    "block_kernels",
    "balance_kernels",
    "wall_kernels",
    "background_grid",
    "grid_assembly",
    "mesh_cycle_kernels",
    "cycle_kernels",
    "multigrid",
    "krylov_kernels",
    "krylov",
    "newton",
    "bubble_kernels",
    "bubbles",
    "time_integration",
    "linear_system",
    "boundary",
    "boundary_update",
    "wall_motion",
    "wall_spacing",
    "wall_step",
    "wall_rows",
    "flow",
    "case",
    "relocation_kernels",
    "moving",
    "delaunay_repair",
    "fitted",
    "remeshing",
    "budget",
    "volume_source",
    "output",
    "progress",
    "simulation",
    "cli",
]
ENTRANCES = {"__init__", "__main__"}  # may import any of ORDER, and are imported by none
# The only files of tipfem/ that import Taichi.
TAICHI = {
    "array_launch", "launcher", "device", "surgery", "grading_kernels", "interface_kernels", "conservation_kernels",
    "remeshing_kernels", "connectivity", "element", "assembly", "jacobian_rows", "block_kernels", "balance_kernels",
    "wall_kernels", "background_grid", "grid_assembly", "mesh_cycle_kernels", "cycle_kernels", "krylov_kernels",
    "bubble_kernels", "relocation_kernels", "edge_kernels", "flip_kernels",
}  # fmt: skip
RENDER_TAICHI = {"ggui", "rasterizer"}  # and of render/, beside at most one file that starts it
RENDER_START_LINES = 100  # that file stays small
RENDER_USERS = {"cli"}  # the only files of tipfem/ that may open render/
LINES = 300  # every file stays below

TIPFEM = sorted((ROOT / "tipfem").rglob("*.py"))
RENDER = sorted((ROOT / "render").rglob("*.py"))
DEMOS = sorted((ROOT / "demos").rglob("*.py"))


def name(path: Path) -> str:
    """The path from the root, for messages and the names of the tests."""
    return path.relative_to(ROOT).as_posix()


def imports(source: str, package: str) -> Iterator[tuple[str, int]]:
    """Every module that a file of `package` imports, at any depth, as (absolute dotted name, line).

    `from x import y` gives both x and x.y, for y may be a module; a relative import is made absolute.
    """
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, node.lineno
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield module, node.lineno
            for alias in node.names:
                yield f"{module}.{alias.name}", node.lineno


def wrong_solver_imports(source: str, module: str) -> list[str]:
    """What the file tipfem/<module>.py imports against the order, as messages."""
    wrong = []
    above = ORDER if module in ENTRANCES else ORDER[: ORDER.index(module)]
    for target, line in imports(source, "tipfem"):
        parts = target.split(".")
        if parts[0] == "render" or parts[:2] == ["tipfem", "render"]:
            if module not in RENDER_USERS:
                wrong.append(f"line {line}: {module} imports {target}; only {sorted(RENDER_USERS)} may")
        elif parts[0] == "tipfem" and len(parts) > 1:
            inner = parts[1]
            if inner.startswith("__") and inner not in ENTRANCES:
                continue  # tipfem.__version__ and the like
            if inner not in above:
                wrong.append(f"line {line}: {module} imports {target}, which is not above it in ORDER")
        elif parts[0] == "taichi" and module not in TAICHI:
            wrong.append(f"line {line}: {module} imports taichi; only {sorted(TAICHI)} may")
    return wrong


def wrong_render_imports(source: str) -> list[str]:
    """What a file of render/ imports of the solver, as messages."""
    wrong = []
    for target, line in imports(source, "tipfem.render"):
        parts = target.split(".")
        if parts[0] == "tipfem" and len(parts) > 1 and parts[1] != "render" and not parts[1].startswith("__"):
            wrong.append(f"line {line}: render imports {target}; it reads results and never the solver")
    return wrong


def uses_taichi(path: Path) -> bool:
    """Whether the file imports taichi or a part of it."""
    return any(target.split(".")[0] == "taichi" for target, _ in imports(path.read_text("utf-8"), ""))


def undocumented(source: str) -> list[str]:
    """The public module, functions, classes and methods without a docstring, as `line n: name`."""
    tree = ast.parse(source)
    missing = [] if ast.get_docstring(tree) else ["line 1: the module"]
    definitions = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)

    def visit(body: list[ast.stmt], prefix: str) -> None:
        for node in body:
            if not isinstance(node, definitions) or node.name.startswith("_"):
                continue
            if not ast.get_docstring(node):
                missing.append(f"line {node.lineno}: {prefix}{node.name}")
            if isinstance(node, ast.ClassDef):
                visit(node.body, f"{prefix}{node.name}.")

    visit(tree.body, "")
    return missing


@pytest.mark.parametrize("path", TIPFEM, ids=name)
def test_the_solver_imports_only_from_above(path):
    assert path.parent == ROOT / "tipfem", f"{name(path)}: tipfem/ has no folders; the drawing is in render/"
    module = path.stem
    assert module in ENTRANCES or module in ORDER, (
        f"{name(path)} has no place in the house: add '{module}' to ORDER in tests/test_house.py, "
        "below all it imports, and to the list in CONTRIBUTING.md"
    )
    assert not wrong_solver_imports(path.read_text("utf-8"), module)


@pytest.mark.parametrize("path", RENDER, ids=name)
def test_render_never_imports_the_solver(path):
    assert not wrong_render_imports(path.read_text("utf-8"))


def test_render_starts_taichi_in_one_place():
    others = [path for path in RENDER if path.stem not in RENDER_TAICHI and uses_taichi(path)]
    assert len(others) <= 1, f"more than one file starts Taichi: {[name(path) for path in others]}"
    for path in others:
        assert len(path.read_text("utf-8").splitlines()) <= RENDER_START_LINES, f"{name(path)} is not small"


@pytest.mark.parametrize("path", TIPFEM + RENDER + DEMOS, ids=name)
def test_files_are_short(path):
    count = len(path.read_text("utf-8").splitlines())
    assert count < LINES, f"{name(path)} has {count} lines; divide it along its subjects"


def test_there_is_no_drawer_for_odds_and_ends():
    drawers = {"utils.py", "util.py", "helpers.py", "misc.py", "common.py"}
    assert not [name(path) for path in TIPFEM + RENDER + DEMOS if path.name in drawers]


@pytest.mark.parametrize("path", TIPFEM + RENDER, ids=name)
def test_what_is_public_has_a_docstring(path):
    assert not undocumented(path.read_text("utf-8")), f"{name(path)}: no docstring"


def test_contributing_lists_the_same_order():
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    block = text.split("```text", 1)[1].split("```", 1)[0]
    listed = [line.split()[0].removesuffix(".py") for line in block.splitlines() if line.split()]
    present = {path.stem for path in TIPFEM}
    assert [module for module in ORDER if module in listed] == listed, "the order differs, or a name does"
    assert present - ENTRANCES <= set(listed), "a file is missing from the list in CONTRIBUTING.md"


@pytest.mark.parametrize(
    ("source", "module", "count"),
    [
        ("from tipfem.fluid import Fluid", "particles", 0),
        ("from tipfem.particles import Particles", "fluid", 1 + 1),  # the module, and the name in it
        ("from .krylov import solve", "mesh", 1 + 1),
        ("from . import flow", "newton", 1),
        ("from . import mesh", "newton", 0),
        ("from tipfem import Case", "flow", 1),  # from the package itself: it imports everything
        ("from tipfem import __version__", "cli", 0),
        ("import tipfem.mesh", "mesh", 1),  # itself
        ("def f():\n    import taichi as ti", "mesh", 1),  # an import put off is an import
        ("import taichi as ti", "krylov_kernels", 0),
        ("from tipfem.render import movie", "simulation", 1 + 1),
        ("from tipfem.render import movie", "cli", 0),
        ("from tipfem.simulation import run", "__init__", 0),
    ],
)
def test_the_guard_sees_what_it_should(source, module, count):
    assert len(wrong_solver_imports(source, module)) == count


def test_the_guard_of_render_and_of_docstrings():
    assert wrong_render_imports("from tipfem.output import read") != []
    assert wrong_render_imports("from ..mesh import Mesh") != []
    assert wrong_render_imports("from .frames import Frame\nimport tipfem.render.frames") == []
    source = '"""Module."""\nclass A:\n    """A."""\n    def f(self): ...\n    def _g(self): ...'
    assert undocumented(source) == ["line 4: A.f"]
    assert undocumented("x = 1") == ["line 1: the module"]
