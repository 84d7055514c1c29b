"""A study as one HTML file: a slider for each value, all runs at the same time, figures that choose runs."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from render_results import write_results
from test_viewer_share import SharedPage
from tipfem.render.viewer import share as sharing
from tipfem.render.viewer.share import share

from tipfem.app.commands import main
from tipfem.app.study.table import figures_of, write_table

TIMES = tuple(np.linspace(0, 0.3, 7).round(3).tolist())
# By viscosity and law of the walls; the last was listed one by one, and has no law.
RUNS = {("thin", 0.001, "slip"): False, ("thick", 0.1, "slip"): True, ("fixed", 0.001, "none"): True}
RUNS[("alone", 10.0, None)] = False


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A folder with four runs and one that has not begun."""
    folder = tmp_path_factory.mktemp("study")
    rows = []
    for k, ((name, viscosity, law), sharp) in enumerate(RUNS.items()):
        out = write_results(folder / name, times=TIMES, sharp=sharp, count=24 - 2 * k)
        lines = "".join(f"{time},{(k + 1) * (1 + time)},{30 - k}\n" for time in TIMES)
        (out / "history.csv").write_text("time,kinetic_energy,particles\n" + lines)
        values = {"fluids.water.viscosity": viscosity, "walls.law": law}
        rows.append({"run": name, "status": "complete", **values, "steps": 10 * k, **figures_of(out)})
    write_table(folder, [*rows, {"run": "late", "status": "not started", "fluids.water.viscosity": 1.0}])
    return folder


@pytest.fixture(scope="module")
def file(study):
    return share(study, fields=["velocity_y"])


@pytest.mark.slow
def test_sliders_change_the_run_and_keep_time_window_and_field(browser, file):
    """By keys; what is said, what is drawn, where there is no run of these values, and none that was not begun."""
    shown = SharedPage(browser, file.as_uri())
    page, rows = shown.page, shown.page.locator("#values label")
    assert [row.split("\n")[0] for row in rows.all_inner_texts()] == ["viscosity", "law"]
    seen = lambda: page.evaluate("[record.facts.title, record.facts.values['fluids.water.viscosity'], record.time]")  # noqa: E731
    page.evaluate("colour(-1), go(3)")
    page.locator("#picture canvas:visible").focus()
    page.keyboard.press("+")
    before, window = shown.picture(), page.evaluate("stage.shown")
    thickness = page.get_by_role("slider", name="viscosity")
    assert thickness.get_attribute("max") == "2"
    assert thickness.get_attribute("aria-valuetext") == "0.001"
    thickness.focus()
    page.keyboard.press("ArrowRight")
    assert seen()[1:] == [0.1, 0.15]
    assert thickness.get_attribute("aria-valuetext") == "0.1"
    assert page.evaluate("stage.shown") == window
    assert (abs(shown.picture() - before) > 20).any(axis=2).mean() > 0.002
    assert page.locator("#picture .pane:visible").count() == 1
    page.keyboard.press("ArrowLeft")
    assert (shown.picture() == before).all()
    page.keyboard.press("End")  # of no law: the other slider goes along
    assert seen()[1:] == [10, 0.15]
    assert rows.nth(1).inner_text().split("\n")[1] == "as in the case"
    page.get_by_role("slider", name="law").focus()
    page.keyboard.press("ArrowLeft")
    assert page.evaluate("Object.values(record.facts.values)") == [0.001, "none"]
    page.evaluate("colour(0)")
    page.keyboard.press("ArrowLeft")
    assert page.evaluate("Object.values(record.facts.values)") == [0.001, "slip"]
    assert page.evaluate("record.film.name") == "velocity y [m/s]"
    assert page.evaluate("records.map(({ films }) => films[0].high)") == [0.5] * 4
    assert shown.asked == [file.as_uri()]
    shown.close()


@pytest.mark.slow(but=("-1",))
@pytest.mark.parametrize("field", [-1, 0])
def test_a_slider_leads_to_a_picture_at_once(browser, file, field):
    shown = SharedPage(browser, file.as_uri())
    waits = shown.page.evaluate(
        """async (field) => {
            colour(field);
            const slider = document.querySelector("#values input"), waits = [];
            for (let k = 0; k < 12; k++) {
                const begun = performance.now();
                slider.value = k % 2;
                slider.dispatchEvent(new Event("input", { bubbles: true }));
                while (record.film && !record.film.image) await new Promise((done) => setTimeout(done));
                await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
                waits.push(performance.now() - begun);
            }
            return waits;
        }""",
        field,
    )
    assert shown.page.evaluate("record.facts.values['fluids.water.viscosity']") == 0.1
    assert np.median(waits) < 50, waits  # [ms]
    shown.close()


@pytest.mark.slow
def test_figures_of_the_table_are_plotted_and_choose_runs(browser, file):
    shown = SharedPage(browser, file.as_uri())
    page = shown.page
    assert page.locator("figcaption").all_inner_texts() == [
        "kinetic energy [J/m], of all runs",
        "steps, of all runs",
        "kinetic energy [J/m]",
    ]
    drawn = page.evaluate("grid.points('kinetic energy [J/m]')")
    assert [point["y"] for point in drawn["points"]] == pytest.approx([1.3, 2.6, 3.9, 5.2])
    assert [tick["text"] for tick in drawn["ticks"]] == ["0.001", "0.1", "10"]
    assert np.diff([tick["x"] for tick in drawn["ticks"]]) == pytest.approx(np.log(100))  # of equal ratios
    assert [point["line"] for point in drawn["points"]] == [True, True, False, False]
    plot = page.locator("#plots canvas").first
    box = plot.bounding_box()
    plot.click(position={"x": 48 + (box["width"] - 62) / 2, "y": box["height"] / 2})
    assert page.evaluate("record.facts.values['fluids.water.viscosity']") == 0.1
    assert page.get_by_label("viscosity").input_value() == "1"
    shown.close()


@pytest.mark.slow
def test_it_plays_on_when_the_run_changes(browser, file):
    shown = SharedPage(browser, file.as_uri(), moves=True)
    shown.page.wait_for_function("() => playing && record.shown > 1 && record.shown < record.last - 1")
    before, after = shown.page.evaluate("""() => {
        const before = record.time;
        setPace(0.25);
        grid.show(records[1]);
        return [before, record.time];
    }""")
    assert after == pytest.approx(before, abs=1e-6)
    shown.page.wait_for_function(f"() => playing && record === records[1] && record.time !== {after}")
    shown.close()


def test_a_phone_has_picture_sliders_and_no_room_too_little(browser, file):
    shown = SharedPage(browser, file.as_uri(), (390, 844), touch=True)
    page = shown.page
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    picture, first = page.locator("#picture").bounding_box(), page.locator("#values input").first.bounding_box()
    assert picture["height"] > 300
    assert first["y"] >= picture["y"] + picture["height"]
    assert first["y"] + first["height"] < 780
    shown.close()


def test_many_states_are_thinned_out_evenly_and_play_as_long(study, tmp_path, browser, monkeypatch):
    monkeypatch.setattr(sharing, "MOST_STATES", 16)
    shown = SharedPage(browser, share(study, tmp_path / "small.html", fields=[]).as_uri())
    assert shown.page.evaluate("facts.times") == [0, 0.1, 0.2, 0.3]
    assert shown.page.evaluate("facts.rate") == pytest.approx(25 / 2)
    shown.close()


def test_a_study_is_shared_by_its_file_or_folder_alone(study, tmp_path, capsys):
    """Refused: another one beside it, one without results, more runs than a page holds."""
    case = tmp_path / "case.toml"
    case.write_text(
        "gravity = [0, -9.81]\n[fluids.water]\ndensity = 1000.0\nviscosity = 1e-3\n[tank]\nsize = [1, 1]\n"
        'spacing = 0.1\n[[fill]]\nfluid = "water"\n[time]\nend = 0.1\n[output]\ninterval = 0.1\n'
    )
    (tmp_path / "study.toml").write_text(
        f'case = "case.toml"\nfolder = "{study}"\n[grid]\nfluids.water.viscosity = [1e-3, 0.1]\n'
    )
    (study / "share.html").unlink(missing_ok=True)
    assert main(["share", str(tmp_path / "study.toml"), "--field", "none"]) == 0, capsys.readouterr().err
    assert str(study / "share.html") in capsys.readouterr().out
    empty = tmp_path / "empty"
    empty.mkdir()
    shutil.copy(study / "study.csv", empty)
    many = tmp_path / "many"
    shutil.copytree(study / "thin", many / "run")
    write_table(many, [{"run": "run", "status": "complete", "steps": k} for k in range(51)])
    for words, message in (
        ([str(study), str(study / "thin")], "is a study, which is shown alone"),
        ([str(empty)], "none of its 5 runs has results yet"),
        ([str(many)], "51 runs have results; a page holds at most 50"),
    ):
        assert main(["share", *words]) == 2
        assert message in capsys.readouterr().err
