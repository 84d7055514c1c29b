"""A results folder as one HTML file that any browser shows, without a server and without anything from elsewhere.

The file holds the outlines of what is drawn at all stored times as 16-bit differences from point to point,
compressed; the browser smooths and draws them.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import html
import json
import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from tipfem.render import Results, Scene, View, colours
from tipfem.render.colours import COLOUR_MAPS, LIGHT, on_transparent
from tipfem.render.layout import Layout
from tipfem.render.openings import COLOURS, Gap, kinds_of, rows_of
from tipfem.render.outlines import Loop, background_fluid, picture_loops, thin_solids
from tipfem.render.picture import draw_scene
from tipfem.render.renderer import make_canvas, settled
from tipfem.render.scales import colour_map_of, digits_of
from tipfem.render.strips import closest
from tipfem.render.viewer.packing import fluid_looks, packed, webp
from tipfem.render.viewer.page_files import page_file
from tipfem.render.viewer.series import series_of

from tipfem.results.fields.catalogue import field_of
from tipfem.results.whole_file import replaced
from tipfem.typing import Array

MODULES = ("outlines.js", "motion.js", "plots.js", "stage.js")  # of which the script is made
MARGIN = 0.04  # around the domain, of its longer side
STATES_PER_SECOND = 25.0
PLOT_SAMPLES = 150  # of a number over time, whose plot is 300 pixels wide
FIELD_WIDTH = 1000  # of the picture of a field [px]

State = tuple[float, list[list[Loop]], tuple[Gap, ...]]  # time [s], its `picture_loops`, and its openings


def share(
    out: str | PathLike[str],
    path: str | PathLike[str] | None = None,
    *,
    field: str | None = None,
    times: Sequence[float] = (),
) -> Path:
    """Write a results folder as one HTML file.

    Args:
        out: results folder of a run in two dimensions.
        path: of the file; by default share.html in the results folder.
        field: name of a field that is shown at some times, as pictures.
        times: these times [s]; the closest stored ones are taken. Each adds some 50 to 200 kB.

    Returns:
        Its path.

    Raises:
        ValueError: the folder cannot be read, there is no such field or time, or the file cannot be written.
    """
    results = Results(out)
    target = results.folder / "share.html" if path is None else Path(path)
    if not target.parent.is_dir():
        raise ValueError(f"the file {str(target)!r} cannot be written: there is no folder {str(target.parent)!r}")
    if (field is None) != (not times):
        raise ValueError("a field is shown at chosen times: name both the field and the times, or neither")
    pictures = None if field is None else _pictures(results, field, closest(results.times, times))
    page = folder_page(results, pictures).encode("utf-8", "replace")  # names of files need be no UTF-8
    try:
        with replaced(target) as temporary:
            temporary.write_bytes(page)
    except OSError as error:
        raise ValueError(f"the file {str(target)!r} cannot be written ({error.strerror})") from error
    return target


def folder_page(results: Results, field: Mapping[str, Any] | None = None) -> str:
    """The page of a results folder.

    Args:
        results: the folder.
        field: pictures of a field at some times, see `share`; None for none.
    """
    first = results.scene(0)
    behind = background_fluid(first)
    scenes = (results.scene(k) for k in range(len(results)))
    states = ((scene.time, picture_loops(scene, behind), scene.openings) for scene in scenes)
    still = not any(scene.tank and scene.tank.moved for scene in (first, results.scene(-1)))
    title = results.title or results.folder.resolve().name
    return page_of(first, behind, states, title, still, field, series_of(results.folder, PLOT_SAMPLES))


def page_of(
    first: Scene,
    behind: int | None,
    states: Iterable[State],
    title: str,
    still: bool,
    field: Mapping[str, Any] | None = None,
    plots: Sequence[Mapping[str, Any]] = (),
    rate: float = STATES_PER_SECOND,
) -> str:
    """The page that plays some states.

    Args:
        first: the first of them.
        behind: the fluid that is not among their loops, see `background_fluid`.
        states: in order of time.
        title: above them.
        still: whether the tank does not move.
        field: pictures of a field.
        plots: values over time, see `series_of`.
        rate: states played in a second.
    """
    assert first.lower is not None, "a Scene fills in what was left out"
    assert first.upper is not None, "a Scene fills in what was left out"
    size = first.upper - first.lower
    lower = first.lower - MARGIN * size.max()
    scale = (size + 2 * MARGIN * size.max()) / 65_535
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
    facts = {
        "title": title,
        "lower": lower.tolist(),
        "scale": scale.tolist(),
        "box": [*first.lower.tolist(), *first.upper.tolist()],
        "times": times,
        "digits": max(3, digits_of(times)),
        "best": best,
        "rate": rate,
        "fluids": fluids,
        "behind": behind,
        "solids": thin_solids(first) if still else [],
        "openings": openings,
        "gaps": gaps,
        "marks": {kind: colour for kind, colour in COLOURS.items() if kind in kinds},
        "field": field,
        "plots": plots,
    }
    squeezed = zlib.compressobj(9, zlib.DEFLATED, -15)
    data = base64.b64encode(squeezed.compress(bytes(stream)) + squeezed.flush()).decode()
    return assembled(facts, _poster(poster, facts), data)


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


def assembled(facts: Mapping[str, Any], poster: str, data: str) -> str:
    """The page of facts, a poster and compressed outlines, with the policy that allows its own script alone."""
    page: str = page_file("share.html").decode()
    names, times = ", ".join(fluid["name"] for fluid in facts["fluids"]), facts["times"]
    about = f"{names}: {len(times)} times to t = {times[-1]:g} s. It plays in any browser; made with tipfem."
    values = {"@TITLE@": html.escape(facts["title"]), "@ABOUT@": html.escape(about), "@POSTER@": poster}
    values["@ICON@"] = quote(page_file("icon.svg").decode())
    script = page[page.index("<script>") + 8 : page.index("</script>")]
    modules = "\n".join(page_file(name).decode() for name in MODULES)
    script = script.replace("@MODULES@", re.sub(r"^export |^import .*", "", modules, flags=re.MULTILINE))
    lines = [line.strip() for line in script.splitlines()]
    script = "\n".join(line for line in lines if line and not line.startswith("//"))
    told = json.dumps(facts, separators=(",", ":")).replace("<", "\\u003c")
    script = _filled(script, {"@FACTS@": told, "@DATA@": data})
    values["@HASH@"] = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    around = page[: page.index("<script>") + 8], page[page.index("</script>") :]
    return script.join(_filled(part, values) for part in around)


def _filled(text: str, values: Mapping[str, str]) -> str:
    """A text with values in place of their marks, all at once: a value may hold what looks like a mark."""
    return re.sub("|".join(values), lambda found: values[found.group()], text)


def _pictures(results: Results, field: str, numbers: Sequence[int]) -> dict[str, Any]:
    """Pictures of a field at some stored times, all in the same colours, and what a colour bar needs."""
    scenes = [results.scene(number) for number in numbers]
    view, ends = settled(View(window=(*results.lower, *results.upper)), results.sampled(), field, None)
    width, height = results.upper - results.lower
    size = FIELD_WIDTH, max(2, round(FIELD_WIDTH * height / width))
    canvas, box = make_canvas(size, "raster", 2), (0.0, 0.0, float(size[0]), float(size[1]))
    layout = Layout(size, 1.0, results.lower, results.upper, size[0] / float(width), box, True, box)
    fills = colours.fluid_colours(results.fluid_names, results.fluid_densities)
    pictures = {}
    for number, scene in zip(numbers, scenes, strict=True):
        # The page draws its background, in either theme, and the openings.

        def drawn(scheme: colours.Scheme, scene: Scene = scene) -> Array:
            looks: dict[str, Any] = {"field": field, "field_range": ends, "view": view, "scheme": scheme}
            bare = dataclasses.replace(scene, openings=())
            drawing, _ = draw_scene(bare, layout, fills, bare=True, **looks)
            painted: Array = canvas.paint(drawing, scheme.background)
            return painted

        image = on_transparent(drawn, LIGHT)
        pictures[number] = base64.b64encode(webp(image, quality=80)).decode()
    canvas.close()
    low, high = ends or (0.0, 1.0)
    return {
        "name": field_of(field).title,
        "low": float(f"{low:.4g}"),
        "high": float(f"{high:.4g}"),
        "stops": COLOUR_MAPS[colour_map_of(field)],
        "pictures": pictures,
    }
