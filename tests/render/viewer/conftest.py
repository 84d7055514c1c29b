"""A viewer that the tests of this folder share, and a page that steers it."""

from __future__ import annotations

import pytest
from render_results import write_results
from view_client import PATIENCE, TIMES, Page, start


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
