"""What all tests share: one Taichi runtime, in f64, on the CPU or where TIPFEM_TEST_ARCH says."""

from __future__ import annotations

import os
import shutil
import signal
from typing import Any

import pytest

import tipfem as tp

# Files that take longest. With them first, no worker waits for another at the end: run
# `pytest -n 2 --dist loadfile --no-loadscope-reorder`.
LONGEST_FIRST = (
    "test_outlines.py",
    "test_gauges_in_space.py",
    "test_drains.py",
    "test_levels_of_polygons.py",
    "test_probes.py",
    "test_axisymmetric.py",
    "test_viewer_live_page.py",  # after others have compiled the kernels, for which its run would wait
)
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_browsers: list[Any] = []  # that are open


def pytest_configure() -> None:
    """Let commands that tests start be interrupted where the shell has put the tests into the background."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The files that take longest first; otherwise in the order of their names. `slow` may name variants."""
    for item in items:
        variant = item.name.removesuffix("]").partition("[")[2]
        for mark in [mark for mark in item.own_markers if mark.name == "slow"]:
            if variant in mark.kwargs.get("but", ()) or variant not in mark.kwargs.get("only", (variant,)):
                item.own_markers.remove(mark)
    rank = {name: number for number, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: rank.get(item.path.name, len(rank)))


@pytest.fixture(scope="session", autouse=True)
def taichi_runtime():
    """Start Taichi once; a second start would break what the first one compiled."""
    tp.init(arch=os.environ.get("TIPFEM_TEST_ARCH", "cpu"))


@pytest.fixture
def water():
    """Water at 20 degrees Celsius."""
    return tp.Fluid("water", density=998.2, viscosity=1.002e-3)


@pytest.fixture
def air():
    """Air at 20 degrees Celsius and one atmosphere."""
    return tp.Fluid("air", density=1.204, viscosity=1.825e-5)


@pytest.fixture
def glycerin():
    """Glycerin at 20 degrees Celsius."""
    return tp.Fluid("glycerin", density=1261.0, viscosity=1.412)


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
        _browsers.append(opened)
        yield opened
        _browsers.remove(opened)
        opened.close()


@pytest.fixture(autouse=True)
def pages_are_closed():
    """Close the pages that a test opens, which would play on beside the next; those of wider fixtures stay."""
    before = [context for browser in _browsers for context in browser.contexts]
    yield
    for context in [context for browser in _browsers for context in browser.contexts]:
        if context not in before:
            context.close()
