"""The house: who may import Taichi, what the drawing may import, and how long files are. Read from the sources.

The direction of imports between the folders of tipfem/ is a contract of import-linter in pyproject.toml, and docstrings
are ruff's; `make lint` checks both.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]

# The only files of tipfem/ that import Taichi, as globs from there: those with kernels, and the backend.
TAICHI = (
    "backend/*",
    "fem/condensation_kernels.py",
    "fem/element.py",
    "fem/jacobian.py",
    "fem/mass.py",
    "fem/matrix_free.py",
    "fem/rates.py",
    "fem/residual.py",
    "fem/rheology.py",
    "fem/schur.py",
    "fem/step_limits.py",
    "fem/work.py",
    "linalg/low_rank.py",
    "linalg/parts.py",
    "linalg/queued_fgmres.py",
    "linalg/sparsity.py",
    "linalg/vector_kernels.py",
    "linalg/multigrid/deflation.py",
    "linalg/multigrid/fused_cycle.py",
    "linalg/multigrid/grid_assembly.py",
    "linalg/multigrid/grid_hierarchy.py",
    "linalg/multigrid/grid_transfer.py",
    "linalg/multigrid/mesh_transfer.py",
    "linalg/multigrid/v_cycle.py",
    "mesh/cut.py",
    "physics/*/kernels.py",
    "physics/bodies/layout.py",
    "physics/linear_rows.py",
    "remesh/carry_kernels.py",
    "remesh/energy_kernels.py",
    "remesh/cavity/arrays.py",
    "remesh/cavity/collapses.py",
    "remesh/cavity/films.py",
    "remesh/cavity/rounds.py",
    "remesh/cavity/smoothing.py",
    "remesh/cavity/splits.py",
    "remesh/cavity/passes.py",
    "remesh/cavity/stars.py",
    "remesh/cavity/swaps.py",
    "remesh/claims.py",
    "remesh/triangles/coarsen_refine.py",
    "remesh/triangles/edge_operations.py",
    "remesh/triangles/films_contacts.py",
    "remesh/triangles/flips.py",
    "remesh/triangles/insertion_kernels.py",
    "remesh/triangles/long_edges.py",
    "remesh/triangles/queue.py",
    "remesh/triangles/refining.py",
    "remesh/triangles/removing.py",
    "remesh/gradation.py",
    "remesh/volume_kernels.py",
    "step/block_preconditioner.py",
    "step/momentum_polynomial.py",
    "step/fused_iteration.py",
    "step/pressure_system.py",
    "step/staged_iteration.py",
    "step/roughness.py",
)
RENDER_TAICHI = ("ggui.py", "rasterizer.py", "runtime.py", "shapes.py", "water.py")
RENDER_READS = [[name] for name in ("render", "results", "arguments", "errors", "notebook", "typing")]
# What stands above the pictures, and the one file of results that draws what it has read, when asked to.
ABOVE_RENDER = ("app/", "run/", "__init__.py", "results/reader.py")
# For each physics: what names it, and how many files of tipfem/ may do so, beside its own folder or file in physics/
# and the list of all. The numbers only fall: a physics that is threaded through other files makes the next one cost
# more than the last.
PHYSICS = {
    "bodies": (r"\b(Body\w*|bodies|body_(?!force)\w+|\w+_bodies|FloatingBodies|MovedBodies)\b", 17),
    "free_surface": (r"\b(free_surface|FreeSurface\w*|surface_volumes|SurfaceMesher|SurfaceRule)\b|\.surface\b", 30),
    "layers": (r"\b(Layers|LayerFaces|LAYER|layers)\b", 15),
    "walls": (r"\b(Wall[A-Z]\w*|Walls?(?=[\[\](,.:])|set_off)\b", 18),
    "beaches": (r"\b(Beach\w*|beach\w*)\b", 3),
    "sliding_liquids": (r"\b(InterfaceSlip|find_slip|may_slide|SlidingLiquids|sliding_liquids)\b|\.slip\b(?!\()", 5),
    "surface_tension": (r"\b(TensionEdges|TensionTable|SurfaceTension|surface_tension|find_edges)\b|\.tension\b", 10),
    "openings": (r"\b(Inlet|Outlet|Vent|Opening\w*|openings|passages|Passages)\b", 19),
    "side_pressures": (r"\b(pressure_jump|SidePressures|two_sided|side_pressures|pressures_on_sides)\b", 4),
}
# Files of each of these rooms that name an object, beside the one where it declares what is read, written, measured and
# steered of it, and the list of all. In casefile/ these are of bodies the words for what is not in tipfem, and lines on
# walls; of walls the forms of their motions.
ROOMS = ("casefile", "probes", "results", "run")
DECLARED = {
    "bodies": {"casefile": 2},
    "walls": {"casefile": 1, "probes": 1, "run": 1},
    "openings": {},
    "beaches": {},
}
NO_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
LINES = 700  # a longer file usually has two subjects
# Lines of docstrings per line of code, which only falls: a docstring has what a reader cannot guess. Blank lines are
# neither, wherever they are, nor are lines of comments alone.
DOCSTRINGS = {"tipfem": 0.2, "render": 0.19}
PARAMETERS = 12  # kernels of more are hard to read: what belongs together is a bundle

TIPFEM = sorted((ROOT / "tipfem").rglob("*.py"))
RENDER = sorted((ROOT / "render").rglob("*.py"))
DEMOS = sorted((ROOT / "demos").rglob("*.py"))


def name(path: Path) -> str:
    """The path from the root, for messages and the names of the tests."""
    return path.relative_to(ROOT).as_posix()


def imports(source: str, package: str) -> Iterator[tuple[str, int]]:
    """Every module that a file of `package` imports, at any depth, as (absolute dotted name, line)."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, node.lineno
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            yield ".".join([*base, *([node.module] if node.module else [])]), node.lineno


def uses_taichi(path: Path) -> bool:
    """Whether the file imports taichi or a part of it."""
    return any(target.split(".")[0] == "taichi" for target, _ in imports(path.read_text("utf-8"), ""))


def solver_imports(source: str, package: str) -> list[str]:
    """Imports of the solver in a file: all of tipfem but its results, the ground, and tipfem.render."""
    found = []
    for target, line in imports(source, package):
        parts = target.split(".")
        if parts[0] == "tipfem" and parts[1:2] not in RENDER_READS:
            found.append(f"line {line}: {target}")
    return found


@pytest.mark.parametrize("path", TIPFEM, ids=name)
def test_only_kernels_and_the_backend_import_taichi(path):
    allowed = any(path.relative_to(ROOT / "tipfem").match(pattern) for pattern in TAICHI)
    assert allowed or not uses_taichi(path), f"{name(path)} imports taichi and is not listed in TAICHI"


def test_all_files_listed_for_taichi_are_there():
    assert all(list((ROOT / "tipfem").glob(pattern)) for pattern in TAICHI)


@pytest.mark.parametrize("path", TIPFEM, ids=name)
def test_kernels_have_functions_that_all_devices_have_in_64_bits(path):
    """GPUs have sines and powers in 32 bits: kernels with others of 64 bits do not compile there."""
    found = re.findall(r"\bti\.(?:sin|cos|tan|tanh|asin|acos|atan2|exp|log|pow)\(", path.read_text("utf-8"))
    assert not found or path.name == "real_functions.py", f"{name(path)} has {found}; see backend/real_functions.py"


@pytest.mark.parametrize("path", RENDER, ids=name)
def test_render_never_imports_the_solver(path):
    assert not solver_imports(path.read_text("utf-8"), "tipfem.render")
    assert path.name in RENDER_TAICHI or not uses_taichi(path), f"{name(path)} imports taichi"


def test_only_commands_and_runs_draw():
    drawing = [p for p in TIPFEM if any(m.startswith("tipfem.render") for m, _ in imports(p.read_text("utf-8"), ""))]
    above = [p for p in TIPFEM if p.relative_to(ROOT / "tipfem").as_posix().startswith(ABOVE_RENDER)]
    assert set(drawing) <= set(above), f"these import tipfem.render: {sorted(map(name, set(drawing) - set(above)))}"


@pytest.mark.parametrize("path", TIPFEM + RENDER + DEMOS, ids=name)
def test_files_are_short(path):
    count = len(path.read_text("utf-8").splitlines())
    assert count <= LINES, f"{name(path)} has {count} lines; divide it along its subjects"


@pytest.mark.parametrize("physics", PHYSICS)
def test_few_files_name_a_physics(physics):
    pattern, most = PHYSICS[physics]
    own = [path for path in TIPFEM if path.match(f"tipfem/physics/{physics}/*") or path.stem == "registry"]
    own += [path for path in TIPFEM if path.match(f"tipfem/physics/{physics}.py") or path.match(f"walls/{physics}.py")]
    found = [name(path) for path in TIPFEM if path not in own and re.search(pattern, path.read_text("utf-8"))]
    assert len(found) <= most, f"{len(found)} files name {physics}, more than {most}: {', '.join(found)}"
    assert len(own) > 1
    assert len(found) > most - 4, f"only {len(found)} files name {physics}: lower its ceiling of {most}"


@pytest.mark.parametrize("room", ROOMS)
@pytest.mark.parametrize("what", DECLARED)
def test_objects_declare_their_own_input_and_output(what, room):
    own = (what, "registry", "__init__")
    files = [path for path in (ROOT / "tipfem" / room).rglob("*.py") if path.stem not in own]
    found = [name(path) for path in files if re.search(PHYSICS[what][0], path.read_text("utf-8"))]
    most = DECLARED[what].get(room, 0)
    assert len(found) == most, f"these name {what}, which their own file is to declare: {', '.join(found)}"


def lines_of(path: Path) -> tuple[int, int]:
    """Lines of a file that are code, and those of its docstrings; blank ones are neither."""
    source, code, words = path.read_text("utf-8"), set[int](), set[int]()
    blank = {number for number, line in enumerate(source.splitlines(), 1) if not line.strip()}
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            words.update(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in NO_CODE:
            code.update(range(token.start[0], token.end[0] + 1))
    return len(code - words - blank), len(words - blank)


@pytest.mark.parametrize("folder", DOCSTRINGS)
def test_docstrings_are_short(folder):
    code, words = np.sum([lines_of(path) for path in (TIPFEM if folder == "tipfem" else RENDER)], axis=0)
    most = DOCSTRINGS[folder]
    assert words <= most * code, f"{folder} has {words / code:.3f} lines of docstrings per line of code, above {most}"
    assert words > (most - 0.01) * code, f"{folder} has {words / code:.3f}: lower its ceiling of {most}"


def parameters_of(source: str) -> dict[str, int]:
    """Number of parameters of each kernel; a bundle is one, and those that `launch` fills in count, too."""
    functions = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)]
    kernels = [node for node in functions if {"kernel", "ti.kernel"} & {*map(ast.unparse, node.decorator_list)}]
    return {each.name: len(each.args.posonlyargs + each.args.args + each.args.kwonlyargs) for each in kernels}


def test_kernels_have_few_parameters():
    found = {(name(path), *each) for path in TIPFEM + RENDER for each in parameters_of(path.read_text("utf-8")).items()}
    assert len(found) > 150
    assert not [each for each in sorted(found) if each[2] > PARAMETERS], f"kernels of more than {PARAMETERS} parameters"


def test_no_files_import_each_other_in_a_circle():
    """Imports for types count, too: a circle means that no part can be read before the others."""
    files = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in TIPFEM}
    needed = {}
    for module, path in files.items():
        package = module if path.name == "__init__.py" else module.rpartition(".")[0]
        source, names = path.read_text("utf-8"), set[str]()
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.ImportFrom):  # a file of a folder, or a name in a file
                base = next(imports(ast.unparse(node), package))[0]
                names |= {inner if (inner := f"{base}.{alias.name}") in files else base for alias in node.names}
        needed[module] = (names & files.keys()) - {module, "tipfem"}
    while needed:
        below = set().union(*needed.values())
        free = [module for module, others in needed.items() if module not in below or not others & needed.keys()]
        assert free, f"these import each other in a circle: {', '.join(sorted(needed))}"
        for module in free:
            del needed[module]


def test_files_of_tests_have_names_of_their_own():
    names = [path.name for path in (ROOT / "tests").rglob("test_*.py")]
    assert [name for name in set(names) if names.count(name) > 1] == []


def test_there_is_no_drawer_for_odds_and_ends():
    drawers = {"utils.py", "util.py", "helpers.py", "misc.py", "common.py"}
    assert not [name(path) for path in TIPFEM + RENDER + DEMOS if path.name in drawers]


def test_the_guards_see_what_they_should(tmp_path):
    assert solver_imports("from tipfem.step.stepper import Stepper", "tipfem.render") != []
    assert solver_imports("from ..mesh import Mesh", "tipfem.render") != []
    assert solver_imports("from .frames import Frame\nimport tipfem.render.frames", "tipfem.render") == []
    assert parameters_of("@kernel\ndef one(a, b): ...\n@ti.kernel\ndef two(a): ...\ndef f(): ...") == {
        "one": 2,
        "two": 1,
    }
    late = tmp_path / "late.py"
    late.write_text('"""One.\n\nTwo.\n"""\n\n\ndef f():\n    import taichi as ti  # late\n    # nothing')
    assert uses_taichi(late)
    assert lines_of(late) == (2, 3)
