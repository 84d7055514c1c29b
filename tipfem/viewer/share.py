"""A results folder as one HTML file that any browser shows, without a server and without anything from elsewhere.

The file holds the outlines of what is drawn at all stored times as 16-bit differences from point to point,
compressed; the browser smooths and draws them.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
import zlib
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from tipfem.render import Results, Stage, View, colours
from tipfem.render.colours import COLOUR_MAPS
from tipfem.render.openings import COLOURS, kinds_of
from tipfem.render.outlines import background_fluid, picture_loops, thin_solids
from tipfem.render.renderer import settled
from tipfem.render.scales import colour_map_of, field_label
from tipfem.render.strips import closest
from tipfem.viewer.packing import packed
from tipfem.viewer.pane import webp
from tipfem.viewer.series import series_of
from tipfem.viewer.server import page_file

MARGIN = 0.04  # around the domain, of its longer side
STATES_PER_SECOND = 25.0
FIELD_WIDTH = 1000  # of the picture of a field [px]


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
    ends = results.scene(0), results.scene(-1)
    scenes = (results.scene(k) for k in range(len(results)))
    size = results.upper - results.lower
    lower = results.lower - MARGIN * size.max()
    scale = (size + 2 * MARGIN * size.max()) / 65_535
    fills = colours.fluid_colours(results.fluid_names, results.fluid_densities)
    dropped: int | None = None
    stream = bytearray()
    for number, scene in enumerate(scenes):
        if number == 0:
            dropped = background_fluid(scene)
        for layer in picture_loops(scene, dropped):
            stream += packed(layer, lower, scale)
    facts = {
        "title": results.title or results.folder.resolve().name,
        "lower": lower.tolist(),
        "scale": scale.tolist(),
        "box": [*results.lower.tolist(), *results.upper.tolist()],
        "times": [float(f"{time:.7g}") for time in results.times],
        "rate": STATES_PER_SECOND,
        "fluids": [[name, colours.hex_code(fills[k]), k != dropped] for k, name in enumerate(results.fluid_names)],
        "solids": [] if any(scene.tank and scene.tank.moved for scene in ends) else thin_solids(ends[0]),
        "openings": [[gap.kind, *gap.ends.ravel().tolist(), *gap.inwards.tolist()] for gap in results.openings],
        "marks": {kind: COLOURS[kind] for kind in kinds_of(results.openings)},
        "field": None if field is None else _pictures(results, field, closest(results.times, times)),
        "plots": series_of(results.folder),
    }
    squeezed = zlib.compressobj(9, zlib.DEFLATED, -15)
    data = base64.b64encode(squeezed.compress(bytes(stream)) + squeezed.flush()).decode()
    page = page_file("share.html").decode()
    page = page.replace("@TITLE@", html.escape(facts["title"]))
    script = page[page.index("<script>") + 8 : page.index("</script>")]
    script = script.replace(
        "@OUTLINES@", re.sub(r"^export ", "", page_file("outlines.js").decode(), flags=re.MULTILINE)
    )
    lines = [line.strip() for line in script.splitlines()]
    script = "\n".join(line for line in lines if line and not line.startswith("//"))
    script = script.replace("@FACTS@", json.dumps(facts, separators=(",", ":")).replace("<", "\\u003c"))
    script = script.replace("@DATA@", data)
    hashed = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    page = page[: page.index("<script>") + 8] + script + page[page.index("</script>") :]
    try:
        target.write_text(page.replace("@HASH@", hashed), encoding="utf-8")
    except OSError as error:
        raise ValueError(f"the file {str(target)!r} cannot be written ({error.strerror})") from error
    return target


def _pictures(results: Results, field: str, numbers: Sequence[int]) -> dict[str, Any]:
    """Pictures of a field at some stored times, all in the same colours, and what a colour bar needs."""
    scenes = [results.scene(number) for number in numbers]
    view, ends = settled(View(window=(*results.lower, *results.upper)), results.sampled(), field, None)
    width, height = results.upper - results.lower
    stage = Stage((FIELD_WIDTH, max(2, round(FIELD_WIDTH * height / width))), "raster")
    pictures = {}
    for number, scene in zip(numbers, scenes, strict=True):
        image, _ = stage.draw(scene, view, field, ends, samples=2)
        pictures[number] = base64.b64encode(webp(image, quality=80)).decode()
    stage.close()
    low, high = ends or (0.0, 1.0)
    return {
        "name": field_label(field),
        "low": float(f"{low:.4g}"),
        "high": float(f"{high:.4g}"),
        "stops": COLOUR_MAPS[colour_map_of(field)],
        "pictures": pictures,
    }
