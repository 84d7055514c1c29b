"""Write the generated parts of pages: measured tables, maps of the folders, tables of declared values.

    python docs/write_generated.py

A page has markers ``<!-- generated: WHAT -->``, each ended by ``<!-- end -->``; what stands between is replaced.
WHAT is ``folders``, ``folder table``, ``fields``, ``case keys`` (of case files, by case_keys.py), ``accuracy`` (a
few figures of tables), ``table NAME``, ``rows NAME: BEGINNING; ...`` (some rows of one) or ``numbers CLASS``. A table
is docs/data/NAME.csv, whose first lines name the commit that was measured and the commands; numbers are the declared
values of a class. docs/images/layers.svg is drawn anew, too. tests/docs/test_site.py holds that all is up to date.
"""

from __future__ import annotations

import csv
import re
import textwrap
from importlib import import_module
from pathlib import Path

from case_keys import page as case_keys
from draw_layers import PICTURE, layers, picture, summary

from tipfem.case.declaration import table as declared_table
from tipfem.results.fields.catalogue import FIELDS

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "docs" / "data"
MARKED = re.compile(r"(<!-- generated: (?P<what>[^>]*?) -->\n).*?(<!-- end -->)", re.DOTALL)
# Folders at the top of the repository that have no docstring of their own.
BESIDE = {
    "render/": "pictures and movies of results; imported as tipfem.render, never imports the solver",
    "demos/": "a case with a check each, as a function or a case file; validation/: comparisons; benchmarks/: speed",
    "tests/": "mirrors the folders; tests/docs runs the documentation's code",
    "docs/": "the documentation; theory/method.md maps the equations to functions",
}


def folders(package: Path = ROOT / "tipfem") -> dict[str, str]:
    """The folders of a package by their paths in it, with their summaries; in the order of the layers, top first."""
    order = [name for row in layers((ROOT / "pyproject.toml").read_text("utf-8")) for name in row]
    found = {path.parent.relative_to(package).as_posix(): path for path in package.glob("*/**/__init__.py")}
    ranked = sorted(found, key=lambda path: (order.index(path.split("/")[0]), path))
    return {path: summary(found[path]) for path in ranked}


def folder_tree() -> str:
    """The map of CONTRIBUTING.md."""
    rows = [("tipfem/", "")]
    for path, text in folders().items():
        depth = path.count("/")
        rows.append(("  " * (depth + 1) + path.rsplit("/", 1)[-1] + "/", text))
    rows += list(BESIDE.items())
    width = max(len(name) for name, _ in rows) + 2
    lines = []
    for name, text in rows:
        wrapped = textwrap.wrap(text, 118 - width) or [""]
        lines.append(f"{name:{width}}{wrapped[0]}".rstrip())
        lines += [" " * width + line for line in wrapped[1:]]
    return "\n".join(["```text", *lines, "```"])


def folder_table() -> str:
    """The map of docs/api/modules.md, with links to the pages of the folders."""
    pages = {path.stem for path in (ROOT / "docs" / "api").glob("*.md")}
    rows = ["| folder | content |", "|---|---|"]
    for path, text in folders().items():
        page = path if path in pages else path.removeprefix("run/")
        name = f"[{path}]({page}.md)" if page in pages else f"`{path}`"
        rows.append(f"| {name} | {text} |")
    return "\n".join(rows)


def field_table() -> str:
    """The fields of docs/howto/results.md."""
    rows = ["| name | | unit | |", "|---|---|---|---|"]
    for field in FIELDS.values():
        where = "stored" if field.stored else "computed; jumps between cells" if field.of_cells else "computed"
        law = f"; of fluids that have a {field.law}" if field.law else ""
        law += "; in 3-D" if field.dimension == 3 else ""
        symbol = f"${field.symbol}$" if field.symbol else ""
        rows.append(f"| `{field.name}` | {symbol} | {field.unit} | {where}{law} |")
    return "\n".join(rows)


def read_data(name: str) -> tuple[dict[str, list[str]], list[list[str]]]:
    """The notes of a results file, such as commit and command; and its rows, the first with the titles."""
    lines = (DATA / f"{name}.csv").read_text("utf-8").splitlines()
    notes: dict[str, list[str]] = {}
    for line in lines:
        if match := re.match(r"# (\w+): (.*)", line):
            notes.setdefault(match[1], []).append(match[2])
    return notes, list(csv.reader(line for line in lines if not line.startswith("#")))


def markdown(rows: list[list[str]]) -> list[str]:
    """Lines of a table, whose first row has the titles."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return [lines[0], "|" + "---|" * len(rows[0]), *lines[1:]]


def some_rows(which: str) -> str:
    """The rows of a results file that begin with one of some texts."""
    name, _, begins = which.partition(": ")
    title, *rows = read_data(name)[1]
    return "\n".join(
        markdown([title, *(next(row for row in rows if row[0].startswith(b)) for b in begins.split("; "))])
    )


def table(name: str) -> str:
    """A results file as a table in Markdown, with its commit and its commands below."""
    notes, rows = read_data(name)
    lines = markdown(rows)
    commands = ", ".join(f"`{command}`" for command in notes.get("command", []))
    source = " ".join(
        [*notes.get("note", []), f"Measured at {notes['commit'][0]}" + (f" by {commands}." if commands else ".")]
    )
    return "\n".join([*lines, "", *textwrap.wrap(source, 118, break_long_words=False, break_on_hyphens=False)])


# The rows of README: what they say, and the table, the beginning of the row and the column that have the figure.
ACCURACY = (
    ("dam break, 5 mm: front against Martin & Moyce (1952)", "dam_break_starts", "front against", 2, "{} RMS"),
    (
        "glycerin under water, at rest for 1 s: error of the pressure",
        "layers_at_rest",
        "glycerin and water,sharp",
        3,
        "{}",
    ),
    ("capillary wave, 16 and 32 spacings per wavelength, against Prosperetti", "drops", "capillary wave", 1, "{} RMS"),
    ("Taylor-Green vortex, from 32 to 64 cells: order of the velocity", "walls", "order of convergence", 1, "{}"),
)


def accuracy() -> str:
    """A few figures of other tables, for README."""
    lines = ["| | measured |", "|---|---|"]
    for text, name, begins, column, form in ACCURACY:
        row = next(row for row in read_data(name)[1] if ",".join(row).startswith(begins))
        lines.append(f"| {text} | {form.format(row[column])} |")
    return "\n".join(lines)


def generated(what: str) -> str:
    """The text between the markers of ``what``.

    Raises:
        ValueError: nothing of that name can be generated.
    """
    if what == "folders":
        return folder_tree()
    if what == "folder table":
        return folder_table()
    if what == "case keys":
        return case_keys()
    if what == "accuracy":
        return accuracy()
    if what == "fields":
        return field_table()
    if what.startswith("table "):
        return table(what.removeprefix("table "))
    if what.startswith("rows "):
        return some_rows(what.removeprefix("rows "))
    if what.startswith("numbers "):
        module, _, name = what.removeprefix("numbers ").rpartition(".")
        return declared_table(getattr(import_module(module), name)).strip()
    raise ValueError(
        f"'{what}' is nothing that can be generated: folders, folder table, fields, case keys, accuracy, "
        "table NAME, rows NAME: BEGINNING; ... or numbers CLASS"
    )


def renewed(text: str) -> str:
    """A page with its generated parts written anew."""
    return MARKED.sub(lambda match: f"{match[1]}\n{generated(match['what'])}\n\n{match[3]}", text)


def pages() -> list[Path]:
    """The pages that may have generated parts."""
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


if __name__ == "__main__":
    PICTURE.write_text(picture(layers((ROOT / "pyproject.toml").read_text("utf-8"))), encoding="utf-8")
    for page in pages():
        old = page.read_text("utf-8")
        if (new := renewed(old)) != old:
            page.write_text(new, encoding="utf-8")
            print(page.relative_to(ROOT))
