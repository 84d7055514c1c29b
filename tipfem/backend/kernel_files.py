"""Files of machine code in a folder of the user's own: written at once, and read only if they are whole and trusted."""

import contextlib
import hashlib
import json
import os
import stat
import tempfile
from pathlib import Path
from typing import Any

_MAGIC = b"tipfem kernel 1\n"
MOST_BYTES = 100_000_000  # of all files; the oldest go first


class UntrustedError(Exception):
    """A file is there, but must not be run."""


def own_folder(folder: Path) -> None:
    """Make a folder for files that will be executed, if it is not there; see `Library` for errors."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    _require_own(os.stat(folder, follow_symlinks=False), stat.S_ISDIR)


def _require_own(status: os.stat_result, kind: Any) -> None:
    if not kind(status.st_mode):
        raise UntrustedError("it is not of its kind")
    if hasattr(os, "getuid"):
        if status.st_uid != os.getuid():
            raise UntrustedError("it belongs to another user")
        if status.st_mode & 0o022:
            raise UntrustedError("other users can write to it")


def read(path: Path, environment: str, *, shipped: bool = False) -> tuple[dict[str, Any], bytes] | None:
    """The description and the machine code in a file, None if there is no file.

    ``environment`` is all that the code depends on besides the kernel; whoever installed a file that is ``shipped`` may
    own and link to it. `UntrustedError` if it is not whole, of another environment, or others can write to it.
    """
    try:
        # A pipe under the name of a file would be waited for.
        flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | (0 if shipped else getattr(os, "O_NOFOLLOW", 0))
        descriptor = os.open(path, flags)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise UntrustedError(error.strerror or "it cannot be opened") from error
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise UntrustedError("it is no file")
        if not shipped:
            _require_own(status, stat.S_ISREG)
        with open(descriptor, "rb", closefd=False) as file:
            content = file.read()
    except OSError as error:
        raise UntrustedError(error.strerror or "it cannot be read") from error
    finally:
        os.close(descriptor)
    head, rest = content[: len(_MAGIC)], content[len(_MAGIC) :]
    if head != _MAGIC:
        raise UntrustedError("it is not a kernel")
    if hashlib.sha256(rest[32:]).digest() != rest[:32]:
        raise UntrustedError("its checksum is wrong")
    line, _, code = rest[32:].partition(b"\n")
    try:
        description: dict[str, Any] = json.loads(line)
        fits = description["environment"] == environment and description["file"] == path.name
    except (ValueError, KeyError, TypeError):
        raise UntrustedError("it is not a kernel") from None
    if not fits:
        raise UntrustedError("it was made for another processor, other settings, or another kernel")
    return description, code


def write(path: Path, environment: str, description: dict[str, Any], code: bytes) -> None:
    """Write a file for `read`; other processes see all of it or nothing. `OSError` if it cannot be written."""
    line = json.dumps({**description, "environment": environment, "file": path.name}).encode()
    content = line + b"\n" + code
    descriptor, name = tempfile.mkstemp(dir=path.parent, suffix=".new")
    try:
        with open(descriptor, "wb") as file:
            file.write(_MAGIC + hashlib.sha256(content).digest() + content)
        os.replace(name, path)
    except OSError:
        with contextlib.suppress(OSError):
            os.unlink(name)
        raise


def remove_oldest(folder: Path) -> None:
    """Remove the files of a folder and those below it that were written first, until `MOST_BYTES` are left."""
    with contextlib.suppress(OSError):
        files = [(entry.stat(), entry) for entry in folder.rglob("*") if entry.is_file()]
        files.sort(key=lambda item: item[0].st_mtime)
        total = sum(status.st_size for status, _ in files)
        for status, entry in files:
            if total <= MOST_BYTES:
                break
            entry.unlink(missing_ok=True)
            total -= status.st_size
