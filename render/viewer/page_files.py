"""The files of the viewer's page."""

from importlib import resources

SCRIPTS = tuple("main viewer numbers outlines motion cells lines stage solid solid_stage steering plots".split())
# The page's files and their types; nothing else is served.
FILES = {
    "index.html": "text/html; charset=utf-8",
    "viewer.css": "text/css; charset=utf-8",
    "icon.svg": "image/svg+xml",
    **{f"{name}.js": "text/javascript; charset=utf-8" for name in SCRIPTS},
}


def page_file(name: str) -> bytes:
    """A file of the page, one of `FILES`."""
    return (resources.files(__package__) / "page" / name).read_bytes()
