"""A result as one HTML file, opened in headless Chromium without a server."""

from __future__ import annotations

import base64
import hashlib
import html
import io
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from render_results import SIDE, write_results
from render_volumes import write_volumes
from tipfem.render import Scene
from tipfem.render.colours import DARK, LIGHT, at_depth, colour_table, fluid_colours, map_values, shades
from tipfem.render.outlines import Loop
from tipfem.render.viewer.films import Scanner
from tipfem.render.viewer.packing import packed
from tipfem.render.viewer.series import series_of
from tipfem.render.viewer.share import share

from tipfem.app.commands import main

TIMES = (0.0, 0.1, 0.2, 0.3)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """The file, of four times, with a probe."""
    out = write_results(tmp_path_factory.mktemp("share") / "run", times=TIMES)
    (out / "probes").mkdir()
    rows = "".join(f"{time},{1000 * time}\n" for time in np.linspace(0, 0.3, 50))
    (out / "probes" / "wall.csv").write_text("time [s],pressure [Pa]\n" + rows)
    return share(out, fields=[])


@pytest.fixture(scope="module")
def coloured(tmp_path_factory):
    """A file of four times with fields, in which the air keeps its colour over the pressure."""
    out = write_results(tmp_path_factory.mktemp("fields") / "run", times=TIMES, sharp=True)
    return share(out, fields=["velocity_y", "pressure"])


class SharedPage:
    """A page of the file, at rest: who asks for less motion is shown one time.

    Args:
        browser: of Playwright.
        address: of the page.
        size: of the window [px].
        scheme: "light" or "dark".
        moves: whether motion is welcome.
        touch: whether it is a phone.
    """

    def __init__(self, browser, address, size=(1000, 620), scheme="light", moves=False, touch=False):
        motion = "no-preference" if moves else "reduce"
        viewport = {"width": size[0], "height": size[1]}
        self.context = browser.new_context(
            viewport=viewport, color_scheme=scheme, reduced_motion=motion, has_touch=touch, is_mobile=touch
        )
        self.page = self.context.new_page()
        self.complaints, self.asked = [], []
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(address)
        self.page.wait_for_selector("html[data-ready], iframe")

    @property
    def time(self):
        return self.page.locator("#clock").inner_text()

    def picture(self):
        """What is on the canvas, as whole numbers."""
        shot = self.page.locator("#picture").screenshot()
        return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)

    def close(self):
        """Close it; it has nothing to complain of."""
        self.context.close()
        assert self.complaints == [], self.complaints


def shade(fluid, scheme, y):
    """The colour of water or air in a tank of 0.5 m at a height [m]."""
    colours = LIGHT if scheme == "light" else DARK
    return 255 * at_depth(shades(fluid_colours(("water", "air")), colours)[fluid], y, SIDE, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_opens_plays_and_zooms_without_anything_from_elsewhere(browser, file, scheme):
    """Times by keys, the bar and playing; zoom, theme and smoothing; a plot; no request and no complaint."""
    shown = SharedPage(browser, file.as_uri(), scheme=scheme)
    page = shown.page
    page.keyboard.press("Home")
    assert shown.time == "t = 0.000 s"
    first = shown.picture()
    middle = first.shape[1] // 2
    water = (abs(first - shade(0, scheme, 0.1)) < 12).all(axis=2)
    assert water[:, middle].any()
    assert (abs(first - shade(1, scheme, 0.45)) < 8).all(axis=2)[:, middle].any()
    assert (first[2, 2] > 200).all() == (scheme == "light")
    assert scheme == "light" or (first.mean(axis=2) > 140).mean() < 0.03
    page.keyboard.press("ArrowRight")
    assert shown.time == "t = 0.100 s"
    page.keyboard.press("End")
    assert shown.time == "t = 0.300 s"
    bar = page.locator("#time").bounding_box()
    page.mouse.click(bar["x"] + 2, bar["y"] + bar["height"] / 2)
    assert shown.time == "t = 0.000 s"
    page.locator("#speed").select_option("0.25")
    assert page.locator("#lapse").inner_text() == "1.6 times slower"
    page.keyboard.press(">")
    page.keyboard.press(">")
    assert page.locator("#lapse").inner_text() == "2.5 times faster"
    page.locator("#speed").select_option("0.25")
    page.locator("#clock").click()
    page.keyboard.press("Space")
    for _ in range(2):  # it begins anew
        page.locator("#clock", has_text="t = 0.300 s").wait_for()
        page.locator("#clock", has_text="t = 0.000 s").wait_for()
    page.keyboard.press("Space")
    page.keyboard.press("End")
    before = shown.picture()
    box = page.locator("#picture").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] * 0.7)
    page.mouse.wheel(0, -600)
    assert (abs(shown.picture() - before) > 20).any(axis=2).mean() > 0.05
    page.keyboard.press("0")
    assert (shown.picture() == before).all()
    for key, back in zip("wasd", "sdwa", strict=True):
        page.keyboard.press(key)
        assert (shown.picture() != before).any()
        page.keyboard.press(back)
    for _ in range(30):  # the tank never leaves the picture
        page.keyboard.press("d")
    assert page.evaluate("(stage.shown[0] + stage.shown[2]) / 2") == pytest.approx(SIDE)
    page.mouse.dblclick(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert not page.locator("#all").is_visible()
    page.keyboard.press("o")
    assert not page.locator("#smooth").is_checked()
    page.keyboard.press("h")
    assert (shown.picture()[2, 2] > 200).all() == (scheme == "dark")
    assert not page.locator("#seen").is_visible()
    assert page.locator("#legend li").all_inner_texts() == ["water", "air"]
    assert page.locator("figcaption").all_inner_texts() == ["wall: pressure [Pa]"]
    plot = page.locator("#plots canvas").bounding_box()  # the axis is from 48 px to 14 px before the end
    page.mouse.click(plot["x"] + 48 + (plot["width"] - 62) / 3, plot["y"] + 60)
    assert shown.time == "t = 0.100 s"
    assert shown.asked == [file.as_uri()]
    shown.close()


def test_fields_play_with_values_under_the_pointer(browser, coloured):
    """A field that is linear, at all times and between them; another one; the fluids again; no colours change."""
    shown = SharedPage(browser, coloured.as_uri())
    page = shown.page
    page.wait_for_function("() => record.film.parts[record.shown].grey")
    assert page.locator("#field option").all_inner_texts() == ["fluids", "velocity y [m/s]", "pressure [Pa]"]
    assert page.locator("#bar").inner_text().split() == ["−0.5", "0.5"]
    assert not page.locator("#legend li").first.is_visible()
    for share_of_way in (0, 0.5):
        page.evaluate(f"show(0, {share_of_way})")
        page.wait_for_function("() => record.film.parts[0].grey && record.film.parts[1].grey")
        page.evaluate("draw()")
        picture = shown.picture()
        for x, y in [(0.04, 0.05), (0.12, 0.4), (0.25, 0.1), (0.4, 0.45), (0.48, 0.02)]:
            px, py = page.evaluate(f"stage.toPixels([{x}, {y}])")
            box = page.locator("#picture").bounding_box()
            page.mouse.move(box["x"] + px, box["y"] + py)
            assert float(page.locator("#value").inner_text().replace("−", "-")) == pytest.approx(-x, abs=0.015)
            expected = 255 * map_values(-x, -0.5, 0.5, colour_table("blue-red"))
            assert abs(picture[round(py), round(px)] - expected).max() < 25
    page.mouse.move(2, 2)
    assert page.locator("#value").inner_text() == ""
    page.locator("#field").select_option("1")
    page.wait_for_function("() => record.film.parts[record.shown].grey")
    assert page.locator("#bar").inner_text().split() == ["0", "3500"]
    assert page.locator("#legend li:visible").all_inner_texts() == ["air"]
    page.evaluate("draw()")
    x, y = page.evaluate("stage.toPixels([0.1, 0.47])")
    assert abs(shown.picture()[round(y), round(x)] - shade(1, "light", 0.47)).max() < 8
    page.locator("#picture canvas").focus()
    page.keyboard.press("f")
    assert page.locator("#field").input_value() == "-1"
    assert page.locator("#bar").inner_text() == ""
    assert page.locator("#legend li:visible").all_inner_texts() == ["water", "air"]
    page.keyboard.press("f")
    assert page.locator("#field").input_value() == "0"
    assert shown.asked == [coloured.as_uri()]
    shown.close()


@pytest.mark.slow
def test_two_runs_stand_side_by_side_at_the_same_times(browser, tmp_path):
    """The border moves by its bar; left of it is one run, right of it the other; both go on, in the same colours."""
    one = write_results(tmp_path / "one", times=TIMES)
    two = write_results(tmp_path / "two", times=(0.0, 0.15, 0.3))
    path = share(one, tmp_path / "both.html", fields=["velocity_y"], beside=two)
    shown = SharedPage(browser, path.as_uri())
    page = shown.page
    page.evaluate("colour(-1), go(2)")
    assert page.locator("#sides span").all_inner_texts() == ["one", "two"]
    assert page.evaluate("[beside.shown, beside.way]") == pytest.approx([1, 1 / 3])
    border = page.locator("#picture").bounding_box()["width"] / 2
    assert page.evaluate("parseFloat(part('border').style.left)") == pytest.approx(border, abs=2)
    middle = shown.picture()
    page.locator("#wipe").focus()
    page.keyboard.press("End")
    first = shown.picture()
    page.keyboard.press("Home")
    second, half = shown.picture(), round(border)
    room = 12  # [px] for the border and the thumb
    assert (abs(first - second) > 20).any(axis=2).mean() > 0.01
    below = slice(70, None)  # of bar and names
    assert (middle[below, room : half - room] == first[below, room : half - room]).all()
    assert (middle[below, half + room : -room] == second[below, half + room : -room]).all()
    moved = page.evaluate("""() => Array.from({ length: 21 }, (_, k) => {
        const begun = performance.now();
        part("wipe").value = 40 * k;
        wipe();
        draw();
        return performance.now() - begun;
    })""")
    assert np.median(moved) < 1000 / 60
    page.evaluate("colour(0)")
    assert page.evaluate("records.map(({ film }) => [film.low, film.high])") == [[-0.5, 0.5]] * 2
    page.locator("#picture").hover(position={"x": border + 60, "y": 150})
    page.mouse.wheel(0, -600)
    page.wait_for_function("() => stage.window")
    windows = page.evaluate("records.map(({ stage }) => stage.shown)")
    assert windows[0] == windows[1]
    shown.close()


@pytest.mark.slow
def test_a_field_stays_while_time_goes_on(browser, coloured):
    """While it plays no picture is without the field, once the first is there."""
    shown = SharedPage(browser, coloured.as_uri(), moves=True)
    shown.page.wait_for_function("() => record.film.parts.every((part) => part.grey) && playing")
    shown.page.evaluate("""() => {
        window.without = window.painted = 0;
        const fill = stage.field;
        stage.field = (...all) => {
            const found = fill(...all);
            painted += 1;
            without += !found;
            return found;
        };
    }""")
    shown.page.wait_for_function("() => painted > 20")
    assert shown.page.evaluate("without") == 0
    shown.close()


@pytest.mark.slow
def test_a_field_of_quite_another_time_is_not_shown_and_the_first_is_read_before_it_begins_again(browser, coloured):
    """As two films are read by a slow machine one would lag behind the other, and be seen where the next loop is."""
    shown = SharedPage(browser, coloured.as_uri())
    shown.page.wait_for_function("() => record.film.parts.every((part) => part.grey)")
    near, far, asked = shown.page.evaluate("""() => {
        const { film } = record, asked = [], read = film.read.bind(film);
        film.picture(1, 0, () => {});
        film.read = (k) => (asked.push(k), read(k));
        film.between(film.parts.length - 1, 0, () => {});
        film.parts[0].grey = null;
        const near = Boolean(film.picture(0, 0, () => {}));
        film.seen = 40;
        return [near, Boolean(film.picture(0, 0, () => {})), asked.slice(0, 4)];
    }""")
    assert near
    assert not far
    assert asked == [3, 0, 1, 2]
    shown.close()


@pytest.mark.parametrize("wide", [False, True])
def test_outlines_are_read_as_they_were_packed(browser, file, wide):
    """Loops of any size, also between the far ends of the range."""
    random, places = np.random.default_rng(3), 2 ** (32 if wide else 16)
    loops = [
        Loop(random.integers(0, places, (count, 2)).astype(float), random.random(count) < 0.5) for count in (3, 40)
    ]
    data = packed(loops, np.zeros(2), np.ones(2), wide)
    page = browser.new_page()
    page.goto(file.as_uri())
    page.wait_for_selector("html[data-ready]")
    read = page.evaluate(
        """([text, wide]) => {
            const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
            const reader = new OutlineReader(bytes.buffer, { lower: [0, 0], scale: [1, 1] }, wide);
            const loops = Array.from({ length: reader.whole() }, () => reader.loop());
            return loops.map((loop) => [[...loop.points], [...loop.fixed]]);
        }""",
        [base64.b64encode(data).decode(), wide],
    )
    for (points, fixed), loop in zip(read, loops, strict=True):
        assert (np.reshape(points, (-1, 2)) == loop.points).all()
        assert (np.array(fixed, bool) == loop.fixed).all()
    page.close()


def test_pictures_of_fields_hold_their_values_and_go_on_beyond_the_fluids():
    """Of a half-filled box: linear in its cells, above them as in the nearest."""
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.5], [1.0, 0.5]])
    scene = Scene(
        position=points,
        cells=np.array([[0, 1, 2], [1, 3, 2]]),
        fluid=np.zeros(4, int),
        fields={"height": 2 + points[:, 1]},
        fluid_names=("water",),
        spacing=0.05,
        time=0.0,
    )
    scanner = Scanner(np.zeros(2), np.ones(2), 0.05)
    low, high, data = scanner.picture(scene, "height")
    scanner.close()
    image = np.asarray(Image.open(io.BytesIO(data)))[:, :, 0].astype(float)
    assert (low, high) == (2.0, 2.5)
    _, y0, _, y1 = scanner.box
    y = y1 - (np.arange(len(image)) + 0.5) / len(image) * (y1 - y0)
    expected = low + np.clip(y, 0, 0.5)
    assert abs(low + (high - low) / 255 * image - expected[:, None]).max() < 0.03 * (high - low)


@pytest.mark.slow
def test_cards_play_again_and_again_while_they_are_in_view_and_never_go_blank(browser, file, tmp_path):
    """Two pages of a gallery, one of them far below: after three rounds the first still plays, the other rests."""
    frames = "".join(
        f'<iframe src="{file.as_uri()}#card" width="300" height="300"></iframe><p style="height: 3000px"></p>'
        for _ in range(2)
    )
    (tmp_path / "gallery.html").write_text(f"<!doctype html><body>{frames}</body>")
    shown = SharedPage(browser, (tmp_path / "gallery.html").as_uri(), (800, 600), moves=True)
    near, far = shown.page.frames[1:]
    for frame in (near, far):
        frame.wait_for_selector("html[data-ready]")
        frame.evaluate("""() => {
            window.painted = [];
            const paint = stage.paint.bind(stage);
            stage.paint = () => (painted.push([performance.now(), record.shown + record.way]), paint());
        }""")
    near.wait_for_function("() => painted.filter(([, at], k) => k && at < painted[k - 1][1]).length >= 3")
    assert near.evaluate("painted.length") > 12
    assert len(far.evaluate("painted")) <= 2
    apart = np.diff([at for at, _ in near.evaluate("painted")])
    assert np.median(apart) > 28  # [ms]
    image = np.asarray(Image.open(io.BytesIO(shown.page.screenshot())).convert("RGB"))[20:290, 20:290]
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 50
    shown.page.evaluate("scrollTo(0, 3000)")
    far.wait_for_function("() => painted.length > 5")
    shown.close()


@pytest.mark.slow(but=("600",))
@pytest.mark.parametrize("width", [300, 358, 600, 688])
def test_in_a_page_of_others_the_picture_has_the_room_on_phones_too(browser, file, tmp_path, width):
    """With the style sheet of the documentation: 200 px high at least, the tank over 60 % of it."""
    style = (Path(__file__).resolve().parents[3] / "docs" / "tipfem.css").read_text()
    frame = f'<iframe src="{file.as_uri()}"></iframe>'
    head = '<!doctype html><meta name="viewport" content="width=device-width">'
    head += f"<style>{style} body {{ margin: 0 }}</style>"
    (tmp_path / "home.html").write_text(f'{head}<body class="md-typeset">{frame}</body>')
    shown = SharedPage(browser, (tmp_path / "home.html").as_uri(), (width, 844), touch=width < 600)
    inner = shown.page.frames[1]
    inner.wait_for_selector("html[data-ready]")
    seen = inner.evaluate("""() => {
        const [x0, , x1] = stage.shown, { width, height } = stage.box;
        return [width, height, (0.5 * width) / (x1 - x0)];
    }""")
    assert seen[1] > 200
    assert seen[2] > 0.6 * min(width, inner.evaluate("innerHeight"))
    assert inner.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert inner.locator("#play").is_visible()
    shown.close()


@pytest.mark.slow
def test_two_fingers_zoom_on_a_phone(browser, file):
    shown = SharedPage(browser, file.as_uri(), (390, 844), touch=True)
    assert shown.page.evaluate("document.documentElement.scrollWidth") <= 390
    width = "stage.shown[2] - stage.shown[0]"
    before, box = shown.page.evaluate(width), shown.page.locator("#picture").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    touch = shown.context.new_cdp_session(shown.page)

    def fingers(kind, off):
        places = [{"x": x - off, "y": y, "id": 0}, {"x": x + off, "y": y, "id": 1}]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places if off else []})

    fingers("touchStart", 40)
    for off in range(45, 125, 5):
        fingers("touchMove", off)
    fingers("touchEnd", 0)
    assert shown.page.evaluate(width) == pytest.approx(before * 40 / 120, rel=0.1)
    shown.page.locator("#all").click()
    assert shown.page.evaluate(width) == pytest.approx(before)
    shown.close()


@pytest.mark.slow
def test_it_opens_where_most_happens_and_plays_at_once(browser, file):
    """The time at which fluids move along much interface, also without scripts; a title and a picture for links."""
    still = SharedPage(browser, file.as_uri())
    best = still.page.evaluate("facts.best")
    assert still.time == f"t = {TIMES[best]:.3f} s"
    assert still.page.locator("link[rel=icon]").count() == 1
    assert "water, air: 4 times to t = 0.3 s" in still.page.locator("meta[name=description]").get_attribute("content")
    still.close()
    moving = SharedPage(browser, file.as_uri(), moves=True)
    moving.page.wait_for_function("() => playing && record.shown + record.way !== facts.best")
    moving.close()
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(file.as_uri())
    image = np.asarray(Image.open(io.BytesIO(page.locator("#picture").screenshot())).convert("RGB"))
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 3
    assert page.get_by_text("This page plays with JavaScript.").is_visible()
    context.close()


def test_it_is_small_and_its_policy_allows_its_own_script_alone(file):
    """Nothing is loaded, whatever the title says."""
    text = share(file.parent, file.parent / "small.html", fields=[]).read_text(encoding="utf-8")
    assert len(text) < 59_600
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1]
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe-inline" not in policy.split(";")[1]
    assert "http://" not in text.replace("http://www.w3.org/2000/svg", "")
    assert "https://" not in text


@pytest.mark.parametrize("name", ["@HASH@", "@DATA@", "@FACTS@ @TITLE@", "\udcff", "</script><b>", "plain"])
def test_whatever_names_hold_the_policy_fits_the_script(tmp_path, name):
    folder = tmp_path / ("run" if name.isascii() else os.fsdecode(b"r\xff"))
    out = write_results(folder, times=TIMES[:2])
    case = json.loads((out / "case.json").read_text())
    case["title"] = case["fluids"][0]["name"] = name if name.isascii() else ""
    (out / "case.json").write_text(json.dumps(case))
    text = share(out).read_text(encoding="utf-8")
    script = text[text.index("<script>") + 8 : text.rindex("</script>")]
    assert base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() in text[: text.index("<script>")]
    if name.isascii():
        assert f'"fluids":[{{"name":"{json.dumps(name)[1:-1]}'.replace("<", "\\u003c") in script
        assert f"<title>{html.escape(name)}" in text


def test_a_page_that_cannot_be_written_leaves_the_one_before(tmp_path, monkeypatch):
    out = write_results(tmp_path / "run", times=TIMES[:2])
    before = share(out).read_bytes()

    def full(path, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    with pytest.raises(ValueError, match="No space left on device"):
        share(out)
    assert (out / "share.html").read_bytes() == before
    assert not list(out.glob("share.html.*"))


@pytest.mark.slow
def test_fewer_states_play_as_long_and_a_single_one_is_refused(browser, file, tmp_path, capsys):
    shown = SharedPage(browser, file.as_uri())
    lapse, size = shown.page.locator("#lapse").inner_text(), file.stat().st_size
    shown.close()
    path = tmp_path / "few.html"
    assert main(["share", str(file.parent), "--to", str(path), "--field", "none", "--states", "2"]) == 0
    assert path.stat().st_size < size
    shown = SharedPage(browser, path.as_uri())
    assert shown.page.evaluate("facts.times") == [TIMES[0], TIMES[-1]]
    assert shown.page.locator("#lapse").inner_text() == lapse
    shown.close()
    assert main(["share", str(file.parent), "--states", "1"]) == 2
    assert "1 states: a page has at least two stored times" in capsys.readouterr().err


@pytest.mark.slow
def test_it_opens_on_the_fluids_where_its_address_asks_for_them(browser, coloured):
    for words, film in (("", True), ("#fluids", False), ("#card&fluids", False), ("#card", True)):
        shown = SharedPage(browser, coloured.as_uri() + words)
        assert shown.page.evaluate("record.film !== null") == film
        assert (shown.page.locator("html").get_attribute("data-card") == "") == ("card" in words)
        shown.close()


def test_histories_that_are_no_text_are_left_out(tmp_path):
    out = write_results(tmp_path / "run", times=TIMES[:2])
    (out / "probes").mkdir()
    (out / "probes" / "wall.csv").write_bytes(b"time,p\n0,1\n1,\xff\n2,3\n")
    (out / "history.csv").write_bytes(b"\xfe\xff")
    assert series_of(out) == []


def test_what_cannot_be_shared_is_said_before_it_is_drawn(file, capsys):
    """A folder that is not there, a field that the results do not have, alone and after another one."""
    out = str(file.parent)
    for words, message in (
        (["--to", "/nodir/x.html"], "there is no folder '/nodir'"),
        (["--field", "heat"], "heat"),
        (["--field", "speed", "heat"], "heat"),
        (["/nodir"], "there is no such folder"),
    ):
        assert main(["share", out, *words]) == 2
        assert message in capsys.readouterr().err


@pytest.mark.slow(but=("688-430-False",))
@pytest.mark.parametrize(("width", "height", "plots"), [(688, 430, False), (640, 900, True), (1000, 620, True)])
def test_the_picture_has_most_of_the_page_and_plots_are_whole_or_left_out(browser, file, width, height, plots):
    """As in a column of the documentation, on a tablet, and on a screen."""
    page = browser.new_context(viewport={"width": width, "height": height}, reduced_motion="reduce").new_page()
    page.goto(file.as_uri())
    page.wait_for_selector("html[data-ready]")
    assert page.locator("#picture").bounding_box()["height"] > 0.55 * height
    assert page.locator("#plots").is_visible() == plots
    if plots:
        whole, first = page.locator("#plots").bounding_box(), page.locator("#plots figure").first.bounding_box()
        assert first["y"] + first["height"] <= whole["y"] + whole["height"]
    assert not page.locator("#all").is_visible()
    page.locator("#picture canvas").focus()
    page.keyboard.press("+")
    page.locator("#all").click()
    assert not page.locator("#all").is_visible()
    page.context.close()


# An outline of twenty points from wall to wall rises and gains a point; a drop goes down, another comes; a box turns.
MOTION = """() => {
    const loop = (at, held) => ({ points: Float64Array.from(at.flat()), fixed: Uint8Array.from(at, held) });
    const along = (count, place) => Array.from({ length: count }, (_, k) => place(k));
    const pool = (count, level) => loop([[1, 0], ...along(count, (k) => [1 - k / (count - 1), level]), [0, 0]],
        (_, k) => k < 2 || k > count - 1);
    const on = (x, y, radius, angle) => [x + radius * Math.cos(angle), y + radius * Math.sin(angle)];
    const ring = (x, y, radius, angle, held) => loop(along(4, (k) => on(x, y, radius, angle + 1.5708 * k)), () => held);
    const drop = (x, y) => ring(x, y, 0.02, 0, false), box = (x, angle) => ring(x, 0.3, 0.1, angle, true);
    const walls = [loop([[0, 0], [1, 0], [1, 1], [0, 1]], () => true)];
    const one = [[pool(20, 0.20), drop(0.3, 0.8)], [box(0.4, 0)], walls];
    const two = [[pool(21, 0.24), drop(0.3, 0.76), drop(0.9, 0.5)], [box(0.5, 1)], walls];
    const seen = (share) => between(one, two, share, false, 1.4), all = [0.25, 0.75].map(seen);
    const highest = ({ points }) => Math.max(...points.filter((_, k) => k % 2));
    const boxes = all.map((state) => state[1][0].points);
    return {
        ends: [seen(0) === one, seen(1) === two],
        counts: all.map(([fluid]) => fluid.length),
        levels: all.map(([fluid]) => highest(fluid[0])),
        drops: all.map(([fluid]) => highest(fluid[1])),
        turns: boxes.map((p) => Math.atan2(p[1] - 0.3, p[0] - (p[0] + p[4]) / 2)),
        sizes: boxes.map((p) => Math.hypot(p[4] - p[0], p[5] - p[1])),
    };
}"""
PACE = """() => {
    const motion = new Motion(), state = [[], []], times = [];
    for (let n = 0, now = 0; now < 2000; now += 10) {
        if (now >= 100 * n + (n % 3) * 20) motion.take(state, 0.01 * n++, true, now); // ten a second, not quite even
        motion.at(now, true, 1);
        if (now > 800) times.push(motion.time - 0.0001 * now);
    }
    const moved = times.map((time, k) => time - times[k - 1] + 0.001).slice(1);
    const jumped = (motion.take(state, 5, true, 2000), motion.time);
    const still = (motion.take(state, 5.01, false, 2010), motion.time);
    return [Math.min(...moved), Math.max(...moved), Math.min(...times), Math.max(...times), jumped, still];
}"""


def test_pictures_between_states_move_evenly(browser, file):
    """Outlines by points that belong together, bodies by their pose; what has come appears half-way."""
    page = browser.new_page()
    page.goto(file.as_uri())
    page.wait_for_selector("html[data-ready]")
    seen = page.evaluate(MOTION)
    assert seen["ends"] == [True, True]
    assert seen["counts"] == [2, 3]
    assert seen["levels"] == pytest.approx([0.21, 0.23])
    assert seen["drops"] == pytest.approx([0.81, 0.79])
    assert seen["turns"] == pytest.approx([0.25, 0.75], abs=1e-3)
    assert seen["sizes"] == pytest.approx([0.2, 0.2], abs=1e-3)
    slowest, fastest, latest, earliest, jumped, still = page.evaluate(PACE)
    assert 0.0004 < slowest < 0.001 < fastest < 0.0016  # [s] in 10 ms, in which it is a millisecond at an even pace
    assert -0.025 < latest < earliest < 0  # never ahead of what is known, and not three states behind
    assert [jumped, still] == [5, 5.01]
    page.close()


@pytest.mark.parametrize("solid", [False, True])
def test_a_page_with_an_address_has_a_picture_for_those_who_show_links(tmp_path, solid, capsys):
    out = write_volumes(tmp_path / "run") if solid else write_results(tmp_path / "run", times=(0.0, 0.1))
    words = ["share", str(out), "--to", str(tmp_path / "my flow.html"), "--address"]
    assert main([*words, "https://example.org/runs/flow.html?a=1&b=2"]) == 0
    text = (tmp_path / "my flow.html").read_text()
    told = dict(re.findall(r'<meta property="og:(\w+)" content="([^"]+)">', text[: text.index("<body")]))
    assert told["image"] == "https://example.org/runs/my%20flow.png"
    assert html.unescape(told["url"]) == "https://example.org/runs/flow.html?a=1&b=2"
    picture = np.asarray(Image.open(tmp_path / "my flow.png").convert("RGB"))
    assert picture.shape == (630, 1200, 3)
    assert picture.std() > 10
    assert main([*words, "example.org"]) == 2
    assert "address 'example.org': expected that of the page" in capsys.readouterr().err
