"""A results folder as one HTML file that any browser shows, without a server and without anything from elsewhere.

The file holds the outlines of what is drawn at all stored times as 16-bit differences from point to point,
compressed; the browser smooths and draws them.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import html
import json
import zlib
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.render import Results, colours
from tipfem.render.openings import COLOURS, kinds_of
from tipfem.render.outlines import Loop, background_fluid, picture_loops
from tipfem.typing import Array

MARGIN = 0.04  # around the domain, of its longer side
MOST_SAMPLES = 300  # of a probe
STATES_PER_SECOND = 25.0
MOST_POINTS = 65_535  # of a loop, and of loops of a layer


def share(out: str | PathLike[str], path: str | PathLike[str] | None = None) -> Path:
    """Write a results folder as one HTML file.

    Args:
        out: results folder of a run in two dimensions.
        path: of the file; by default share.html in the results folder.

    Returns:
        Its path.

    Raises:
        ValueError: the folder cannot be read.
        OSError: the file cannot be written.
    """
    results = Results(out)
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
            stream += _packed(layer, lower, scale)
    facts = {
        "title": results.title or results.folder.resolve().name,
        "lower": lower.tolist(),
        "scale": scale.tolist(),
        "box": [*results.lower.tolist(), *results.upper.tolist()],
        "times": [float(f"{time:.7g}") for time in results.times],
        "rate": STATES_PER_SECOND,
        "fluids": [[name, colours.hex_code(fills[k]), k != dropped] for k, name in enumerate(results.fluid_names)],
        "openings": [[gap.kind, *gap.ends.ravel().tolist(), *gap.inwards.tolist()] for gap in results.openings],
        "marks": {kind: COLOURS[kind] for kind in kinds_of(results.openings)},
        "plots": _plots(results.folder / "probes"),
    }
    squeezed = zlib.compressobj(9, zlib.DEFLATED, -15)
    data = base64.b64encode(squeezed.compress(bytes(stream)) + squeezed.flush()).decode()
    page = (resources.files(__package__) / "page" / "share.html").read_text(encoding="utf-8")
    page = page.replace("@TITLE@", html.escape(facts["title"]))
    script = page[page.index("<script>") + 8 : page.index("</script>")]
    script = script.replace("@FACTS@", json.dumps(facts, separators=(",", ":")).replace("<", "\\u003c"))
    script = script.replace("@DATA@", data)
    hashed = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    page = page[: page.index("<script>") + 8] + script + page[page.index("</script>") :]
    target = results.folder / "share.html" if path is None else Path(path)
    target.write_text(page.replace("@HASH@", hashed), encoding="utf-8")
    return target


def _packed(loops: list[Loop], lower: Array, scale: Array) -> bytes:
    """Number of loops; of each the number of points, x and y as differences, and whether points are fixed, in bits."""
    parts = [np.uint16(len(loops)).tobytes()]
    for points, fixed in loops:
        if len(points) > MOST_POINTS:
            raise ValueError(f"an outline has {len(points)} points; at most {MOST_POINTS} can be shared")
        places = np.clip(np.rint((points - lower) / scale), 0, 65_535).astype(np.int64)
        steps = np.diff(places, axis=0, prepend=0).astype(np.uint16)  # differences are taken modulo 65536
        parts += [np.uint16(len(points)).tobytes(), steps.T.astype("<u2").tobytes(), np.packbits(fixed).tobytes()]
    return b"".join(parts)


def _plots(folder: Path) -> list[dict[str, Any]]:
    """The numbers that probes have recorded over time, thinned out: name, times and values of each."""
    found = []
    for path in sorted(folder.glob("*.csv")):
        with open(path, encoding="utf-8", newline="") as file:
            rows = list(csv.reader(file))
        if len(rows) < 3 or "time" not in rows[0]:
            continue
        header, body = rows[0], [row for row in rows[1:] if len(row) == len(rows[0])]
        kept = np.unique(np.linspace(0, len(body) - 1, min(len(body), MOST_SAMPLES)).round().astype(int))
        at = header.index("time")
        for column, name in enumerate(header):
            if name in ("time", "step"):
                continue
            try:
                series = [(float(body[k][at]), float(body[k][column])) for k in kept]
            except ValueError:
                continue
            values = [float(f"{value:.4g}") if np.isfinite(value) else None for _, value in series]
            times = [float(f"{time:.5g}") for time, _ in series]
            found.append({"name": f"{path.stem}: {name}", "times": times, "values": values})
    return found
