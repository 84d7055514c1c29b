"""A flow in 3-D as one HTML file, opened in headless Chromium without a server."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image
from render_volumes import SIZE, volume, write_volumes
from tipfem.render.surface import fluid_surface
from tipfem.render.viewer.share import share
from tipfem.render.viewer.solid_share import packed_surface
from tipfem.render.viewer.source import ResultsSource

from tipfem.app.commands import main


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """The file, of water that sinks in three times."""
    return share(write_volumes(tmp_path_factory.mktemp("solid") / "run", levels=(0.6, 0.4, 0.2)))


@pytest.fixture
def page(browser, file):
    """The file at its second time, at rest."""
    context = browser.new_context(viewport={"width": 900, "height": 600}, color_scheme="light", reduced_motion="reduce")
    opened = context.new_page()
    opened.said, opened.asked = [], []
    opened.on("console", lambda message: "GL Driver" in message.text or opened.said.append(message.text))
    opened.on("pageerror", lambda error: opened.said.append(str(error)))
    opened.on("request", lambda request: opened.asked.append(request.url))
    opened.goto(file.as_uri())
    opened.wait_for_selector("html[data-ready]")
    yield opened
    assert opened.said == []
    assert opened.asked == [file.as_uri()]
    context.close()


def picture(page):
    page.wait_for_timeout(300)
    return np.asarray(Image.open(io.BytesIO(page.locator("main").screenshot())).convert("RGB")).astype(int)


def blue(image):
    return int((image[..., 2] - image[..., 0] > 60).sum())


def unpacked(data, points, faces):
    """Twin of readStates in page/solid.js."""
    found, at = [], 0
    for count in (points, points, points, faces, faces, faces):
        turned = (
            np.frombuffer(data, np.uint8, 4 * count, at).reshape(4, count).T.copy().view("<u4")[:, 0].astype(np.int64)
        )
        found.append(np.where(turned & 1, -(turned + 1) // 2, turned // 2))
        at += 4 * count
    assert at == len(data)
    first = np.cumsum(found[3])
    return np.stack([np.cumsum(move) for move in found[:3]], axis=1), np.stack(
        [first, first + found[4], first + found[5]], axis=1
    )


def test_bytes_hold_the_surface_to_a_part_in_sixty_thousand():
    made = fluid_surface(volume(level=0.5), 0)
    places, faces = unpacked(packed_surface(made, np.zeros(3), SIZE), len(made.points), len(made.faces))
    assert np.abs(places / 65_535 * SIZE - made.points).max() < 1e-5
    assert (faces >= 0).all()
    flat = int(made.flat.sum())

    def told(some):
        return {tuple(np.roll(face, -int(face.argmin()))) for face in some}

    assert told(faces[:flat]) == told(made.faces[made.flat])
    assert told(faces[flat:]) == told(made.faces[~made.flat])


def test_the_page_shows_water_that_time_lowers(page, file):
    assert file.stat().st_size < 100_000
    assert page.locator("#clock").inner_text() == "t = 0.100 s"
    assert page.locator("#legend").inner_text() == "water"
    found = [blue(picture(page))]
    for key in ("ArrowLeft", "End"):
        page.keyboard.press(key)
        found.append(blue(picture(page)))
    assert page.locator("#clock").inner_text() == "t = 0.200 s"
    assert found[1] > 1.03 * found[0] > 1.03 * 1.03 * found[2] > 2000


def test_it_turns_zooms_and_has_a_dark_side(page):
    before = picture(page)
    box = page.locator("canvas").bounding_box()
    page.mouse.move(box["x"] + 450, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 300, box["y"] + 260, steps=3)
    page.mouse.up()
    turned = picture(page)
    assert np.abs(turned - before).mean() > 5
    page.locator("#all").click()
    assert np.abs(picture(page) - before).mean() < 0.5
    page.keyboard.press("-")
    assert blue(picture(page)) < 0.8 * blue(before)
    page.keyboard.press("h")
    assert picture(page)[5, 5].max() < 60 < before[5, 5].min()


def test_it_plays_at_a_pace_that_is_chosen(page):
    page.keyboard.press("Home")
    for _ in range(2):
        page.keyboard.press("<")
    assert page.locator("#lapse").inner_text() == "1.6 times slower"
    page.locator("#play").click()
    seen = set()
    for _ in range(200):
        seen.add(page.locator("#clock").inner_text())
        page.wait_for_timeout(20)
        if len(seen) == 3:
            break
    assert seen == {"t = 0.000 s", "t = 0.100 s", "t = 0.200 s"}
    page.locator("#play").click()
    assert page.locator("#play").inner_text() == "Play"


def test_what_the_page_has_not_is_refused(tmp_path, capsys):
    out = write_volumes(tmp_path / "out", levels=(0.5,))
    assert main(["share", str(out), "--field", "pressure"]) == 2
    assert "the page of a flow in 3-D has no fields; leave it out" in capsys.readouterr().err
    assert main(["share", str(out), str(out)]) == 2
    assert "has no another run" not in (said := capsys.readouterr().err)
    assert "the page of a flow in 3-D has no run beside it" in said
    assert main(["share", str(out), "--field", "none"]) == 0
    assert "share.html" in capsys.readouterr().out
    with pytest.raises(ValueError, match="the viewer shows flows in 2-D only; tipfem render and tipfem share draw"):
        ResultsSource(out)
