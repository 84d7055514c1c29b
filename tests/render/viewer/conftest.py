"""A viewer that the tests of this folder share, and a page that steers it."""

from __future__ import annotations

import os
import shutil

import pytest
from render_results import write_results
from view_client import PATIENCE, TIMES, Page, start

BROWSERS = ("chromium", "chromium-browser", "google-chrome")


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium."""
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        found = None
    if found is None:
        if os.environ.get("TIPFEM_REQUIRE_BROWSER") == "1":
            pytest.fail("TIPFEM_REQUIRE_BROWSER=1, but there is no Chromium or no Playwright")
        pytest.skip("no Chromium or no Playwright")
    with sync_playwright() as driver:
        # Without a user of its own, as in containers, Chromium cannot make its sandbox.
        opened = driver.chromium.launch(executable_path=found, args=["--no-sandbox"] if os.getuid() == 0 else [])
        yield opened
        opened.close()


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    """A viewer of twelve stored times: water below a wave, velocity (y, -x)."""
    running = start(write_results(tmp_path_factory.mktemp("view") / "wave", TIMES, sharp=True))
    yield running
    running.process.terminate()
    assert running.process.wait(PATIENCE) == 0


@pytest.fixture
def page(server):
    """A page that steers, at the first time with nothing chosen."""
    opened = Page(server)
    opened.hello = opened.until("hello")[0]
    if not opened.hello["steers"]:  # the page before is still on its way out
        opened.until("role")
    opened.send("size", width=480, height=320)
    for kind, content in (
        ("show", {"time": 0}),
        ("field", {"name": None}),
        ("range", {"mode": "fixed"}),
        ("window", {"window": None}),
        ("follow", {"what": None}),
        ("layers", {"mesh": False, "tracers": 0, "fill": True, "arrows": False, "colour_all": False}),
    ):
        opened.send(kind, **content)
    opened.until("frame", lambda frame: frame["field"] is None and "fade" not in frame["panes"][0])
    opened.until_status(lambda now: now["size"] == [480, 320] and now["window"] is None and now["time"] == 0)
    yield opened
    opened.close()
