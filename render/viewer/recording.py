"""A movie of what is seen in a viewer, as long as it was seen."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
import time
from pathlib import Path

from tipfem.render.movie import MovieWriter

from tipfem.typing import Array

RATE = 25.0  # pictures a second
LONGEST = 600.0  # seconds


class Recording:
    """Pictures (H, W, 3) uint8 at the times at which they were seen, written to a temporary file."""

    def __init__(self, first: Array) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="tipfem-view-"))
        self._writer = MovieWriter(self._folder / "movie.mp4", (first.shape[1], first.shape[0]), RATE)
        self._begin = time.monotonic()  # the encoder takes a while to start
        self._last = first

    def add(self, image: Array) -> None:
        """Add a picture (H, W, 3) uint8 seen from now on; the one before is repeated up to here."""
        self._repeat()
        self._last = image

    @property
    def too_long(self) -> bool:
        """Whether the movie is as long as it may be."""
        return time.monotonic() - self._begin > LONGEST

    def finish(self) -> bytes:
        """End the movie; returns the content of its file. `OSError` if it could not be written."""
        try:
            self._repeat()
            if self._writer.count == 0:
                self._writer.append(self._last)
            path: Path = self._writer.finish()
            return path.read_bytes()
        finally:
            self.discard()

    def discard(self) -> None:
        """Remove the temporary file."""
        with contextlib.suppress(OSError):
            self._writer.discard()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _repeat(self) -> None:
        count = round(min(time.monotonic() - self._begin, LONGEST) * RATE)
        while self._writer.count < count:
            self._writer.append(self._last)
