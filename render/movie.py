"""Encode frames as a movie: .mp4 (H.264), .gif or .webp, with the ffmpeg that imageio-ffmpeg brings."""

import contextlib
from os import PathLike
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
from PIL import Image

from .arrays import Array

# Players take untagged colours for one of two standards, by size: convert to BT.709 and say so.
_TO_BT709 = "scale=out_color_matrix=bt709:out_range=tv"
_TAGS = "-colorspace bt709 -color_primaries bt709 -color_trc bt709 -color_range tv"
_CODECS: dict[str, dict[str, Any]] = {
    ".mp4": dict(
        codec="libx264",
        pix_fmt_out="yuv420p",
        output_params=f"-preset veryfast -crf 17 -movflags +faststart -vf {_TO_BT709} {_TAGS}".split(),
    ),
    ".gif": dict(
        codec="gif",
        pix_fmt_out="pal8",
        # A palette a frame: one for the whole movie would hold every frame in memory.
        output_params=[
            "-filter_complex",
            "split[a][b];[a]palettegen=stats_mode=single[p];[b][p]paletteuse=new=1:dither=bayer:bayer_scale=5",
        ],
    ),
    ".webp": dict(
        codec="libwebp_anim", pix_fmt_out="yuv420p", output_params="-loop 0 -compression_level 2 -quality 88".split()
    ),
}
SUFFIXES = tuple(_CODECS)


class MovieError(OSError):
    """A movie that could not be written whole."""


def check_movie_name(name: str | PathLike[str]) -> str:
    """The name of a movie file; `ValueError` if it has folders or an unknown suffix."""
    name = str(name)
    if Path(name).name != name:
        raise ValueError(f"movie {name!r}: expected a file name without folders")
    if Path(name).suffix.lower() not in _CODECS:
        raise ValueError(f"movie {name!r}: expected a name that ends in {', '.join(SUFFIXES)}")
    return name


class MovieWriter:
    """Writes frames of a size [px] to a temporary file beside a path, whose suffix is the format; see `finish`."""

    def __init__(self, path: str | PathLike[str], size: tuple[int, int], frame_rate: float) -> None:
        self.path = Path(path)
        suffix = self.path.suffix.lower()
        self.part = self.path.with_name(f".{self.path.stem}.part{suffix}")
        self.count = 0
        self.size = size
        # quality=None: the parameters above set it.
        self._pipe = imageio_ffmpeg.write_frames(
            str(self.part),
            self.size,
            fps=float(frame_rate),
            quality=None,
            macro_block_size=2,
            ffmpeg_log_level="fatal",
            **_CODECS[suffix],
        )
        self._pipe.send(None)

    def append(self, image: Array) -> None:
        """Add a frame (H, W, 3) uint8; `MovieError` if it cannot be written."""
        try:
            self._pipe.send(np.ascontiguousarray(image))
        except OSError as error:
            self.discard()
            raise MovieError(
                f"{self.path}: writing the movie stopped at frame {self.count}; "
                f"is the disk full? ({str(error).splitlines()[0]})"
            ) from None
        self.count += 1

    def finish(self) -> Path:
        """Close the file, check that it has every frame, else `MovieError`, and give it its name."""
        self._pipe.close()
        try:
            # The encoder reports no error when the disk is full: count the frames that can be read back.
            found = _count_frames(self.part)
            if found != self.count:
                raise MovieError(f"{self.path}: {found} of {self.count} frames can be read back; is the disk full?")
            self.part.replace(self.path)
        except BaseException:
            self.discard()
            raise
        return self.path

    def discard(self) -> None:
        """Stop and remove the unfinished file."""
        with contextlib.suppress(OSError, RuntimeError):
            self._pipe.close()
        self.part.unlink(missing_ok=True)


def _count_frames(path: Path) -> int:
    if not path.is_file() or path.stat().st_size == 0:
        return 0
    try:
        if path.suffix.lower() == ".mp4":
            return imageio_ffmpeg.count_frames_and_secs(str(path))[0] or 0
        with Image.open(path) as image:
            image.seek(getattr(image, "n_frames", 1) - 1)
            image.load()
            return int(getattr(image, "n_frames", 1))
    except (RuntimeError, OSError, EOFError, ValueError):
        return 0
