"""A flow in 3-D in headless Chromium: as one HTML file without a server, and in the viewer."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image
from render_results import write_results
from render_volumes import SIZE, volume, write_volumes
from shown_page import PATIENCE, ShownPage
from tipfem.render.surface import fluid_surface
from tipfem.render.viewer.session import Session
from tipfem.render.viewer.share import share
from tipfem.render.viewer.solid_share import packed_surface
from tipfem.render.viewer.source import ResultsSource
from view_client import Page, start

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
    assert opened.locator("#clock").inner_text() == "t = 0.200 s"  # with most drops, so with the largest surface
    opened.keyboard.press("ArrowLeft")
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_it_comes_back_when_the_graphics_card_was_taken_away(page):
    """As phones do to pages in the background; the picture is drawn anew without a touch."""
    before = picture(page)
    page.evaluate(
        "window.graphics = document.querySelector('canvas').getContext('webgl2').getExtension('WEBGL_lose_context');"
        "graphics.loseContext()"
    )
    assert blue(picture(page)) < 0.1 * blue(before)
    page.evaluate("graphics.restoreContext()")
    assert np.abs(picture(page) - before).mean() < 0.5
    page.said[:] = [text for text in page.said if "CONTEXT_LOST" not in text]


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_cut_shows_as_much_of_the_water_as_stands_there(page):
    """Water of .6 and of .2 m, three to one; from behind the cut is out of sight."""
    cut = page.locator("#cut")
    assert section(picture(page)) == 0
    found = []
    for key in ("Home", "End"):
        page.keyboard.press(key)
        cut.evaluate("(cut) => { cut.value = 0.5; cut.dispatchEvent(new Event('input')); }")
        found.append(depth(picture(page)))
    assert found[1] > 50
    assert abs(found[0] / found[1] - 3) < 0.1
    for _ in range(18):
        page.keyboard.press("d")
    assert section(picture(page)) == 0
    for _ in range(10):
        page.keyboard.press("v")
    assert cut.input_value() == "0"


def depth(image):
    """Pixels from the top of a cut through water to its bottom, below drops; the mean of some columns."""
    columns = (image[:, 300:550:10] == [0x00, 0x72, 0xB2]).all(axis=2).T
    return np.mean([max(map(len, "".join(".#"[here] for here in column.astype(int)).split("."))) for column in columns])


def section(image):
    """Number of pixels of the plain colour of cuts through water."""
    return int((image == [0x00, 0x72, 0xB2]).all(axis=2).sum())


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    """A viewer of water that sinks in three times."""
    running = start(write_volumes(tmp_path_factory.mktemp("viewed") / "run", levels=(0.6, 0.4, 0.2)))
    yield running
    running.process.terminate()
    assert running.process.wait(PATIENCE) == 0


@pytest.mark.slow
def test_the_viewer_shows_turns_cuts_and_keeps_a_flow_in_3d(browser, viewer, tmp_path):
    shown = ShownPage(browser, viewer.address, SIZE[:2])

    def seen():
        return np.asarray(Image.open(io.BytesIO(shown.canvas.screenshot())).convert("RGB")).astype(int)

    shown.wait(lambda: blue(seen()) > 2000, "water")
    first = blue(seen())
    shown.key("End")
    shown.at(3)
    shown.wait(lambda: blue(seen()) < 0.97 * first, "less water")
    shown.key("c", "c", "c")
    shown.wait(lambda: section(seen()) > 2000, "the cut")
    box = shown.canvas.bounding_box()
    shown.page.mouse.move(box["x"] + 300, box["y"] + 200)
    shown.page.mouse.down()
    shown.page.mouse.move(box["x"] + 350, box["y"] + 225, steps=4)
    shown.page.mouse.up()
    shown.wait(lambda: shown.command.endswith("--azimuth -45 --elevation 28"), "the camera of the command")
    for of, there in (("solid", True), ("plane", False)):
        parts = shown.page.locator(f'[data-of="{of}"]')
        assert [parts.nth(k).is_visible() for k in range(parts.count())] == [there] * parts.count()
    with shown.page.expect_download() as kept:
        shown.button("picture").click()
    kept.value.save_as(tmp_path / "kept.png")
    assert blue(np.asarray(Image.open(tmp_path / "kept.png").convert("RGB")).astype(int)) > 2000
    with shown.page.expect_download() as kept:
        shown.button("share").click()
    kept.value.save_as(tmp_path / "kept.html")
    assert "readStates" in (tmp_path / "kept.html").read_text()
    shown.button("reset").click()
    shown.wait(lambda: shown.command.endswith("--azimuth -25 --elevation 18"), "the view from the front")
    shown.close()


@pytest.mark.slow
def test_two_flows_are_turned_together(browser, viewer, tmp_path):
    running = start(viewer.out, write_volumes(tmp_path / "other", levels=(0.5, 0.3)))
    shown = ShownPage(browser, running.address, SIZE[:2])
    assert shown.canvas.count() == 2
    for key in ("a", "w", "-"):
        shown.key(key)
    views = shown.page.locator(".pane").evaluate_all("(panes) => panes.map((pane) => pane.textContent)")
    assert views == ["run", "other"]
    shown.wait(lambda: "azimuth -35" in shown.command, "the view of both")
    shown.close()
    running.process.terminate()
    assert running.process.wait(PATIENCE) == 0


def test_what_a_flow_in_3d_does_not_take_is_refused_in_a_sentence(viewer, tmp_path):
    page = Page(viewer)
    for kind, content in (("field", {"name": "speed"}), ("pick", {"pane": 0, "at": [0.1, 0.1]})):
        page.send(kind, **content)
        text = page.until("error")[0]["text"]
        assert text.startswith(f"{kind}: a flow in 3-D is seen as the surface of its densest fluid")
    page.close()
    flat, solid = write_results(tmp_path / "flat", (0.0, 0.1)), write_volumes(tmp_path / "solid")
    with pytest.raises(ValueError, match="one flow is in 2-D and the other in 3-D"):
        Session([ResultsSource(flat), ResultsSource(solid)])
    session = Session([ResultsSource(flat)])
    said = []
    session.receive(session.attach(said.append), '{"type": "camera", "azimuth": 0, "elevation": 0}')
    assert "camera: the flow is in 2-D" in said[-1]
