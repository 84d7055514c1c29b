"""The pages against the rules of axe-core (WCAG 2 A and AA, best practices), in both themes: no violation."""

from __future__ import annotations

import pytest
from axe_playwright_python.sync_playwright import Axe
from render_results import write_results
from render_volumes import write_volumes
from shown_page import PATIENCE, ShownPage
from test_viewer_live_page import DOMAIN, start
from tipfem.render.viewer.share import share
from view_client import TIMES
from view_client import start as start_viewer

SCHEMES = pytest.mark.parametrize("scheme", ["light", "dark"])


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    """A viewer of its own: what pages choose stays chosen."""
    running = start_viewer(write_results(tmp_path_factory.mktemp("seen") / "wave", TIMES, sharp=True))
    yield running
    running.process.terminate()
    assert running.process.wait(PATIENCE) == 0


def require_no_violations(page):
    """What axe-core finds on a page as it is now, in its words."""
    found = Axe().run(page)
    assert not found.violations_count, found.generate_report()


@pytest.mark.slow
@SCHEMES
def test_results_with_a_field_a_point_and_its_history(browser, viewer, scheme):
    shown = ShownPage(browser, viewer.address, (1.0, 0.5), scheme=scheme)
    require_no_violations(shown.page)
    shown.wait(shown.part("field").is_enabled, "the page to steer")
    shown.part("field").select_option("pressure")
    shown.part("range").select_option("given")
    shown.page.locator('[data-layer="arrows"]').check()
    shown.canvas.focus()
    shown.key("k")
    shown.wait(shown.part("history").is_visible, "the history of the point")
    require_no_violations(shown.page)
    shown.part("field").select_option("")
    shown.key("?")
    shown.wait(shown.part("keys").is_visible, "the list of keys")
    require_no_violations(shown.page)
    shown.close()


@pytest.mark.slow
@SCHEMES
def test_results_in_3d(browser, tmp_path, scheme):
    running = start_viewer(write_volumes(tmp_path / "run"))
    shown = ShownPage(browser, running.address, (1.0, 0.6), scheme=scheme)
    require_no_violations(shown.page)
    shown.close()
    running.process.terminate()
    assert running.process.wait(PATIENCE) == 0


@pytest.mark.slow
@SCHEMES
def test_a_run_with_all_controls(browser, tmp_path, scheme):
    process, address = start(tmp_path / "play", "--piston")
    shown = ShownPage(browser, address, DOMAIN, scheme=scheme)
    shown.read("state", "running")
    require_no_violations(shown.page)
    shown.button("stop").click()
    shown.read("note", "The run has ended")
    require_no_violations(shown.page)
    shown.close()
    assert process.wait(PATIENCE) == 0


@pytest.mark.slow(but=("False-dark",))
@SCHEMES
@pytest.mark.parametrize("solid", [False, True])
def test_a_page_to_share(browser, tmp_path, scheme, solid):
    out = write_volumes(tmp_path / "run") if solid else write_results(tmp_path / "run", times=(0.0, 0.1))
    page = browser.new_context(color_scheme=scheme).new_page()
    page.goto(share(out).as_uri())
    page.wait_for_selector("html[data-ready]")
    require_no_violations(page)
    page.context.close()
