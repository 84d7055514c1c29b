"""A results folder as one HTML file that any browser shows, without a server and without anything from elsewhere.

The file holds the outlines of what is drawn at all stored times, compressed, which the browser smooths and draws; and
pictures of fields, see `tipfem.render.viewer.films`.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any
from urllib.parse import quote, urljoin

import numpy as np
from tipfem.render import Results, Scene, render_frame
from tipfem.render.colours import LIGHT
from tipfem.render.openings import COLOURS, Gap, kinds_of, rows_of
from tipfem.render.outlines import Loop, background_fluid, picture_loops, thin_solids
from tipfem.render.scales import digits_of
from tipfem.render.viewer.films import Films
from tipfem.render.viewer.packing import FINE, fluid_looks, packed, png
from tipfem.render.viewer.page_files import page_file
from tipfem.render.viewer.series import series_of
from tipfem.render.viewer.solid_share import surface_page
from tipfem.render.viewer.studies import StudyRun, study_runs

from tipfem.results.whole_file import replaced
from tipfem.typing import Array

PLANE = tuple(f"{name}.js" for name in ("numbers outlines motion plots film stage record player share".split()))
SOLID = ("numbers.js", "plots.js", "solid.js", "player.js", "solid_share.js")
PREVIEW = (1200, 630)  # of a picture beside a link [px]
MARGIN = 0.04  # around the domain, of its longer side
STATES_PER_SECOND = 25.0
MOST_STATES = 480  # of all runs of a study
PLOT_SAMPLES = 150  # of a number over time, whose plot is 300 pixels wide

Told = tuple[dict[str, Any], str, bytes]  # see `told_of_states`
State = tuple[float, list[list[Loop]], tuple[Gap, ...]]  # time [s], its `picture_loops`, and its openings


def share(
    out: str | PathLike[str],
    path: str | PathLike[str] | None = None,
    *,
    fields: Sequence[str] = ("speed",),
    beside: str | PathLike[str] | None = None,
    states: int | None = None,
    address: str | None = None,
) -> Path:
    """Write a results folder, or the runs of a study, as one HTML file.

    Args:
        out: results folder of a run, in 3-D for the densest fluid in its tank, without fields; or the folder of a study
            in 2-D, for a slider for each of its values.
        beside: another one that is shown beside it at the same times, with a border to be moved between the two.
        path: of the file; by default share.html in the results folder.
        fields: names of fields that can be looked at besides the fluids; the first of them is shown at first.
        states: largest number of stored times that the file has of each run in 2-D, evenly chosen, two or more; by
            default all, or of the runs of a study 480 together.
        address: of the page on the web, "https://..."; those who show links then find a picture, a PNG beside the file.

    Returns:
        Its path.

    Raises:
        ValueError: the folder cannot be read, there is no such field, or the file cannot be written.
    """
    if address is not None and not re.match(r"https?://[^/]+/", address):
        raise ValueError(f"address {address!r}: expected that of the page, https://example.org/flow.html or alike")
    if states is not None and states < 2:
        raise ValueError(f"{states} states: a page has at least two stored times")
    folder, runs = Path(out), study_runs(Path(out))
    if runs and beside is not None:
        raise ValueError(f"{str(out)!r} is a study, which is shown alone; give one of its runs to compare it")
    folders = [] if runs else [Results(out, solid=True)]
    target = folder / "share.html" if path is None else Path(path)
    if not target.parent.is_dir():
        raise ValueError(f"the file {str(target)!r} cannot be written: there is no folder {str(target.parent)!r}")
    if any(results.dimension == 3 for results in folders):
        if beside is not None or states is not None or tuple(fields) not in ((), ("speed",)):
            what = "run beside it" if beside is not None else "choice of states" if states is not None else "fields"
            raise ValueError(f"{folder}: the page of a flow in 3-D has no {what}; leave it out")
        facts, poster, data = surface_page(folders[0], STATES_PER_SECOND)
        made = assembled([facts], poster, data, SOLID)
    else:
        folders += [] if beside is None else [Results(beside)]
        facts, made = study_page(runs, fields, states) if runs else folder_page(folders, fields, states=states)
    if address is not None:
        image = target.with_suffix(".png")
        picture = _preview((folders or [Results(runs[0].folder)])[0], facts["times"][facts["best"]], fields)
        _write(image, png(picture))
        links = {"url": address, "image": urljoin(address, quote(image.name))}
        told = "".join(f'<meta property="og:{name}" content="{html.escape(text)}">\n' for name, text in links.items())
        made = made.replace('<link rel="icon"', told + '<link rel="icon"', 1)
    page = made.encode("utf-8", "replace")  # names of files need be no UTF-8
    _write(target, page)
    return target


def _write(path: Path, data: bytes) -> None:
    try:
        with replaced(path) as temporary:
            temporary.write_bytes(data)
    except OSError as error:
        raise ValueError(f"the file {str(path)!r} cannot be written ({error.strerror})") from error


def _preview(results: Results, time: float, fields: Sequence[str]) -> Array:
    """The state nearest to a time [s] in the size of previews of links, (H, W, 3) uint8."""
    number = int(np.argmin(np.abs(np.array(results.times) - time)))
    if results.dimension == 3:
        return np.asarray(render_frame(results.volume(number), PREVIEW))
    field = fields[0] if fields else None
    return np.asarray(render_frame(results.scene(number), PREVIEW, field=field, backend="raster"))


def folder_page(
    folders: Sequence[Results], fields: Sequence[str] = (), dark: bool | None = None, states: int | None = None
) -> tuple[dict[str, Any], str]:
    """Facts of the first, and the page, of a results folder, or of two, with the first one's title; see `share`.

    It opens dark or light; None for as the reader's system is.
    """
    made = [_folder(results, fields, dark, states) for results in folders]
    names = [facts["title"] for facts, *_ in made]
    for other in (lambda folder: folder.resolve().name, str):
        if len(set(names)) < len(names):
            names = [other(results.folder) for results in folders]
    for name, (facts, *_) in zip(names, made, strict=True):
        facts["name"] = name
    return made[0][0], assembled([facts for facts, *_ in made], made[0][1], b"".join(data for *_, data in made))


def study_page(
    runs: Sequence[StudyRun], fields: Sequence[str] = (), states: int | None = None
) -> tuple[dict[str, Any], str]:
    """Facts of the first run, and the page, of a study, whose runs have so few states in all that it stays small."""
    opened = [Results(run.folder) for run in runs]
    made, most = [], max(2, MOST_STATES // len(runs)) if states is None else states
    for run, results in zip(runs, opened, strict=True):
        facts, poster, data = _folder(results, fields, None, most)
        made.append(({**facts, "values": run.values, "figures": run.figures}, poster, data))
    return made[0][0], assembled([facts for facts, *_ in made], made[0][1], b"".join(data for *_, data in made))


def _folder(results: Results, fields: Sequence[str], dark: bool | None, most: int | None) -> Told:
    first = results.scene(0)
    behind = background_fluid(first)
    films = Films(results, fields)
    kept = np.linspace(0, len(results) - 1, min(len(results), most or len(results))).round().astype(int).tolist()

    def states() -> Iterator[State]:
        for scene in map(results.scene, kept):  # each is read once
            films.take(scene)
            yield scene.time, picture_loops(scene, behind), scene.openings

    still = not any(scene.tank and scene.tank.moved for scene in (first, results.scene(-1)))
    title = results.title or results.folder.resolve().name
    plots = series_of(results.folder, PLOT_SAMPLES)
    rate = STATES_PER_SECOND * (len(kept) - 1 or 1) / (len(results) - 1 or 1)
    facts, poster, data = told_of_states(first, behind, states(), title, still, plots, dark, rate)
    facts["fields"], pictures = films.told()
    return facts, poster, data + pictures


def told_of_states(
    first: Scene,
    behind: int | None,
    states: Iterable[State],
    title: str,
    still: bool,
    plots: Sequence[Mapping[str, Any]] = (),
    dark: bool | None = None,
    rate: float = STATES_PER_SECOND,
) -> Told:
    """States as a page plays them: facts, the picture of one of them as SVG, and bytes that page/record.js reads.

    Args:
        first: the first of them.
        behind: the fluid that is not among their loops, see `background_fluid`.
        states: in order of time.
        title: above them.
        still: whether the tank does not move.
        plots: values over time, see `series_of`.
        dark: see `folder_page`.
        rate: states played in a second.
    """
    size = first.upper - first.lower
    lower = first.lower - MARGIN * size.max()
    scale = np.maximum((size + 2 * MARGIN * size.max()) / 65_535, FINE * first.spacing)
    stream, times, kinds = bytearray(), list[float](), set[str]()
    # A page opens where most happens: fluids move, along much interface.
    energy = next((plot for plot in plots if plot["name"].startswith("kinetic energy")), None)
    most, best, poster = -1.0, 0, list[list[Loop]]()
    openings, gaps = list[list[list[Any]]](), list[int]()  # as they are at some time, and the number of it at each
    for time, drawn, there in states:
        times.append(float(f"{time:.7g}"))
        kinds |= set(kinds_of(there))
        if (rows := rows_of(there)) not in openings:
            openings.append(rows)
        gaps.append(openings.index(rows))
        for loops in drawn:
            stream += packed(loops, lower, scale)
        moves = np.interp(time, energy["times"], energy["values"]) if energy else 1.0
        if (much := moves**0.25 * _length(drawn[:-2])) > most:
            most, best, poster = much, len(times) - 1, drawn
    fluids = fluid_looks(first.fluid_names, first.fluid_densities)
    lower, scale, box = lower.tolist(), scale.tolist(), [*first.lower.tolist(), *first.upper.tolist()]
    facts: dict[str, Any] = dict(title=title, lower=lower, scale=scale, box=box, times=times)
    facts |= dict(digits=max(3, digits_of(times)), best=best, rate=rate, fluids=fluids, behind=behind)
    facts |= dict(solids=thin_solids(first) if still else [], openings=openings, gaps=gaps)
    marks = {kind: colour for kind, colour in COLOURS.items() if kind in kinds}
    facts |= dict(marks=marks, fields=[], plots=plots, dark=dark)
    facts["outlines"] = len(stream)  # before the pictures of fields
    return facts, _poster(poster, facts), bytes(stream)


def _length(layers: Sequence[Sequence[Loop]]) -> float:
    """Length of the outlines of fluids that are not along walls [m]."""
    loops = [loop for each in layers for loop in each]
    sides = [(at - np.roll(at, 1, axis=0))[~(held & np.roll(held, 1))] for at, held in loops]
    return float(sum(np.linalg.norm(side, axis=1).sum() for side in sides))


def _poster(layers: Sequence[Sequence[Loop]], facts: Mapping[str, Any]) -> str:
    """The picture of a state as SVG, for readers without scripts."""
    x0, y0, x1, y1 = facts["box"]
    scale, behind = 600 / (x1 - x0), facts["behind"]
    means = [fluid["light"][2] for fluid in facts["fluids"]]

    def path(loops: Sequence[Loop], looks: str) -> str:
        places = [np.rint((points - (x0, y1)) * (scale, -scale)).astype(int) for points, _ in loops]
        lines = "".join("M" + " ".join(f"{x} {y}" for x, y in each.tolist()) + "z" for each in places)
        return f'<path {looks} fill-rule="evenodd" d="{lines}"/>'

    ground = "none" if behind is None else means[behind]
    parts = [path(layers[-1], f'fill="{ground}" stroke="{LIGHT.wall}" stroke-width="8"')]
    fills = [*(fill for k, fill in enumerate(means) if k != behind), LIGHT.body]
    parts += [path(loops, f'fill="{fill}"') for fill, loops in zip(fills, layers[:-1], strict=True)]
    shape = f"-9 -9 618 {scale * (y1 - y0) + 18:.0f}"
    return f'<svg viewBox="{shape}" role="img" aria-label="The flow">{"".join(parts)}</svg>'


def assembled(told: Sequence[Mapping[str, Any]], poster: str, data: bytes, modules: Sequence[str] = PLANE) -> str:
    """The page of one run or two, with the policy that allows its own script alone; see `told_of_states`.

    ``poster`` is HTML for readers without scripts; none of the files ``modules`` uses names of later ones before it is
    run.
    """
    page: str = page_file("share.html").decode()
    facts, squeezed = told[0], zlib.compressobj(9, zlib.DEFLATED, -15)
    coded = base64.b64encode(squeezed.compress(data) + squeezed.flush()).decode()
    names, times = ", ".join(fluid["name"] for fluid in facts["fluids"]), facts["times"]
    about = f"{names}: {len(times)} times to t = {times[-1]:g} s. It plays in any browser; made with tipfem."
    values = {"@TITLE@": html.escape(facts["title"]), "@ABOUT@": html.escape(about), "@POSTER@": poster}
    values["@ICON@"] = quote(page_file("icon.svg").decode())
    script = page[page.index("<script>") + 8 : page.index("</script>")]
    code = "\n".join(page_file(each).decode() for each in (*["grid.js"] * ("values" in facts), *modules))
    script = script.replace("@MODULES@", re.sub(r"^export |^import .*", "", code, flags=re.MULTILINE))
    lines = [re.sub(r"(^|(?<=[;,{]) )// .*", "", line.strip()) for line in script.splitlines()]
    script = "\n".join(line for line in lines if line)
    written = json.dumps(told, separators=(",", ":")).replace("<", "\\u003c")
    script = _filled(script, {"@FACTS@": written, "@DATA@": coded})
    values["@HASH@"] = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    around = page[: page.index("<script>") + 8], page[page.index("</script>") :]
    return script.join(_filled(part, values) for part in around)


def _filled(text: str, values: Mapping[str, str]) -> str:
    """A text with values in place of their marks, all at once: a value may hold what looks like a mark."""
    return re.sub("|".join(values), lambda found: values[found.group()], text)
