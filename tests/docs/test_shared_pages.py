"""The pages of docs/shared, as files in headless Chromium: colours of fields, seeking, and fluids that stand out."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tipfem.render.colours import contrast

SHARED = Path(__file__).resolve().parents[2] / "docs" / "shared"
NAMES = sorted(path.stem for path in SHARED.glob("*.html"))
IN_SPACE = {name for name in NAMES if name.endswith("_3d")} | {"dam_break_container"}
FLAT = [name for name in NAMES if name not in IN_SPACE]
# What colours of linear light become for those without the first, second or third kind of cones: Machado et al. (2009).
BLIND = {
    "none": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
SEEK = """async (share) => {
    const number = Math.round(share * (facts.times.length - 1)), begun = performance.now();
    go(number);
    while (!record.film.between(number, 0, () => {})) await new Promise((done) => setTimeout(done));
    draw();
    await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
    return performance.now() - begun;
}"""
# Of the pixels of the fluids, every third across and up: what lies outside has the value of the nearest within.
BEYOND = """async () => {
    const { film } = record, shares = [], [x0, y0, x1, y1] = film.box;
    for (const [k, part] of film.parts.entries()) {
        if (!part.bytes.length) continue;
        await film.read(k);
        let seen = 0, beyond = 0;
        for (let row = 1; row < part.tall; row += 3) for (let column = 1; column < part.wide; column += 3) {
            const at = [x0 + ((column + 0.5) / part.wide) * (x1 - x0), y1 - ((row + 0.5) / part.tall) * (y1 - y0)];
            const fluid = fluidAt(record.states[k], record.facts.behind, at), value = film.value(at, k, 0);
            if (fluid === null || film.plain.includes(fluid)) continue;
            seen++;
            beyond += value < film.low || value > film.high;
        }
        shares.push(beyond / seen);
    }
    return shares;
}"""


def opened(browser, name, scheme="light", width=900):
    """A page at rest."""
    page = browser.new_context(
        viewport={"width": width, "height": 640}, color_scheme=scheme, reduced_motion="reduce"
    ).new_page()
    page.goto((SHARED / name.replace("#", ".html#")).as_uri().replace("%23", "#"))
    page.wait_for_selector("html[data-ready]")
    return page


@pytest.mark.slow(but=("layer_inversion",))
@pytest.mark.parametrize("name", FLAT)
def test_fields_are_sought_at_once_and_hardly_leave_the_range_of_their_colours(browser, name):
    """A tenth of a second from a time to another far away; of no time more than 1 % of the pixels beyond the ends."""
    page = opened(browser, f"{name}#")
    if page.evaluate("record.films.length"):
        waits = [page.evaluate(SEEK, share) for share in (0.9, 0.1, 0.5, 0.3, 0.7, 0.05, 0.95, 0.6, 0.2)]
        assert np.median(waits) < 100, waits  # [ms]
        shares = page.evaluate(BEYOND)
        assert len(shares) > 40
        assert max(shares) <= 0.01
    page.context.close()


def pixels(page):
    """The canvas as it is, (H, W, 3) of 0 to 1."""
    shot = page.locator("#picture canvas").first.screenshot()
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")) / 255


def as_seen(colour, matrix):
    """A colour as it is seen without a kind of cones."""
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ np.transpose(matrix), 0, 1)
    return np.where(seen <= 0.0031308, 12.92 * seen, 1.055 * seen ** (1 / 2.4) - 0.055)


@pytest.mark.slow(but=("oil_on_water-light",))
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", ["splash", "oil_on_water"])
def test_fluids_stand_out_whatever_the_theme_and_the_eye(browser, name, scheme):
    """Their outlines have a contrast of 3:1 to every fluid, at the top and at the bottom; in dark no tank is bright."""
    page = opened(browser, f"{name}#fluids", scheme)
    picture = pixels(page)
    line, *fluids = page.evaluate("""() => {
        const at = (colour) => [1, 3, 5].map((k) => parseInt(colour.trim().slice(k, k + 2), 16) / 255);
        const edge = getComputedStyle(document.documentElement).getPropertyValue("--edge");
        const { theme } = document.documentElement.dataset;
        return [at(edge), ...facts.fluids.flatMap((fluid) => fluid[theme].slice(0, 2).map(at))];
    }""")
    if scheme == "dark":
        assert (picture @ [0.2126, 0.7152, 0.0722] > 0.6).mean() < 0.03  # but lines and words
    for name, matrix in BLIND.items():
        found = [float(contrast(as_seen(np.array(line), matrix), as_seen(np.array(fluid), matrix))) for fluid in fluids]
        assert min(found) >= 3, (name, found)
    page.context.close()
