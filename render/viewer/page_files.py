"""The files of the viewer's page."""

from importlib import resources

# The page's files and their types; nothing else is served.
FILES = {
    "index.html": "text/html; charset=utf-8",
    "viewer.css": "text/css; charset=utf-8",
    "main.js": "text/javascript; charset=utf-8",
    "viewer.js": "text/javascript; charset=utf-8",
    "outlines.js": "text/javascript; charset=utf-8",
    "motion.js": "text/javascript; charset=utf-8",
    "cells.js": "text/javascript; charset=utf-8",
    "lines.js": "text/javascript; charset=utf-8",
    "stage.js": "text/javascript; charset=utf-8",
    "steering.js": "text/javascript; charset=utf-8",
    "plots.js": "text/javascript; charset=utf-8",
    "icon.svg": "image/svg+xml",
}


def page_file(name: str) -> bytes:
    """A file of the page.

    Args:
        name: one of `FILES`.
    """
    return (resources.files(__package__) / "page" / name).read_bytes()
