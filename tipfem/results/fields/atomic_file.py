"""A file that is changed in one piece: after a crash it has all of a change, or nothing of it.

HDF5 changes its bookkeeping in place, so that a process that is killed while it appends leaves a file that no program
opens. Here all its changes are held in memory while HDF5 works, which survives no error of the disk either. Then what
it has appended is written behind the old end of the file, where nothing refers to it yet; what it has changed is put in
a journal beside the file, and last in the file. A file whose journal is complete is put right by `recover`, which makes
the same changes again.
"""

from __future__ import annotations

import hashlib
import io
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PAGE = 4096
_MAGIC = b"tipfem journal 1\n"
_HEAD = struct.Struct("<QQ")  # size of the file, number of changes
_ENTRY = struct.Struct("<QQ")  # offset, length


def journal_of(path: Path) -> Path:
    """Path of a file's journal."""
    return path.with_name(path.name + ".journal")


def recover(path: Path) -> None:
    """Finish a change that a crash interrupted, or undo one not completed; `OSError` if it cannot be written."""
    journal = journal_of(path)
    journal.with_name(journal.name + ".part").unlink(missing_ok=True)
    change = _read_journal(journal)
    if change is not None and path.exists():
        _apply(path, *change)
    journal.unlink(missing_ok=True)


class AtomicFile(io.RawIOBase):
    """A file for `h5py.File` whose changes come into force together, when `commit` is called.

    The file must be there; it is for changing if ``write``, otherwise for reading, the change of a complete journal
    included. `OSError` if it cannot be opened.
    """

    def __init__(self, path: Path, *, write: bool = False) -> None:
        super().__init__()
        self.path = path
        if write:
            recover(path)
        self._file: Any = open(path, "r+b" if write else "rb", buffering=0)
        self._write = write
        self._old = self._size = os.fstat(self._file.fileno()).st_size
        self._place = 0
        self._pages: dict[int, bytearray] = {}  # that have changed, or are new, by number
        change = None if write else _read_journal(journal_of(path))
        if change is not None:
            self._size = change[0]
            for offset, data in change[1]:
                self._hold(offset, data)

    def readable(self) -> bool:
        """True."""
        return True

    def writable(self) -> bool:
        """Whether it was opened to be changed."""
        return self._write

    def seekable(self) -> bool:
        """True."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """Move to a place, as files do."""
        self._place = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._place, os.SEEK_END: self._size}[whence]
        return self._place

    def tell(self) -> int:
        """The present place."""
        return self._place

    def readinto(self, buffer: Any, /) -> int:
        """Fill a buffer from the present place; returns the number of bytes."""
        view = memoryview(buffer).cast("B")
        count = max(0, min(len(view), self._size - self._place))
        view[:count] = os.pread(self._file.fileno(), count, self._place).ljust(count, b"\0")
        for number, low, high in _pages_of(self._place, self._place + count):
            if (page := self._pages.get(number)) is not None:
                view[low - self._place : high - self._place] = page[low - number * PAGE : high - number * PAGE]
        self._place += count
        return count

    def write(self, buffer: Any, /) -> int:
        """Write at the present place; returns the number of bytes."""
        data = bytes(buffer)
        self._hold(self._place, data)
        self._place += len(data)
        self._size = max(self._size, self._place)
        return len(data)

    def truncate(self, size: int | None = None, /) -> int:
        """Set the size."""
        self._size = self._place if size is None else size
        for number in [number for number in self._pages if (number + 1) * PAGE > max(self._size, self._old)]:
            kept = max(0, max(self._size, self._old) - number * PAGE)
            self._pages[number][kept:] = bytes(PAGE - kept)
        return self._size

    def commit(self, *, durable: bool = True) -> None:
        """Commit all changes, with a journal if ``durable``; without one, a crash leaves a part of them.

        `OSError` leaves the file as it was, or with a journal from which it is put right.
        """
        changes = []
        for number, page in sorted(self._pages.items()):
            start, inside = number * PAGE, max(0, min(PAGE, self._old - number * PAGE))
            if inside:
                changes.append((start, bytes(page[:inside])))
            _write_at(self._file.fileno(), bytes(page[inside : max(0, self._size - start)]), start + inside)
        if durable:
            os.fsync(self._file.fileno())
            _write_journal(journal_of(self.path), self._size, changes)
        self._pages, self._old = {}, self._size  # from here on the change is made, now or by `recover`
        _apply(self.path, self._size, changes, durable)
        journal_of(self.path).unlink(missing_ok=True)

    def close(self) -> None:
        """Close the file; changes that have not come into force are gone."""
        if not self.closed:
            try:
                if self._write and os.fstat(self._file.fileno()).st_size > self._old:
                    os.ftruncate(self._file.fileno(), self._old)
            finally:
                self._file.close()
                super().close()

    def _hold(self, place: int, data: bytes) -> None:
        """Hold changes in memory."""
        for number, low, high in _pages_of(place, place + len(data)):
            start = number * PAGE
            if number not in self._pages:
                self._pages[number] = bytearray(os.pread(self._file.fileno(), PAGE, start).ljust(PAGE, b"\0"))
            self._pages[number][low - start : high - start] = data[low - place : high - place]


def _pages_of(start: int, end: int) -> Iterator[tuple[int, int, int]]:
    """The pages between two places: number, and the first and last place in them."""
    for number in range(start // PAGE, -(-end // PAGE)):
        yield number, max(start, number * PAGE), min(end, (number + 1) * PAGE)


def _write_journal(journal: Path, size: int, changes: list[tuple[int, bytes]]) -> None:
    entries = [_ENTRY.pack(at, len(data)) + data for at, data in changes]
    content = b"".join([_MAGIC, _HEAD.pack(size, len(changes)), *entries])
    temporary = journal.with_name(journal.name + ".part")
    try:
        with open(temporary, "wb") as file:
            file.write(content + hashlib.sha256(content).digest())
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, journal)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _read_journal(journal: Path) -> tuple[int, list[tuple[int, bytes]]] | None:
    """Size and changes of a complete journal; None where there is none."""
    try:
        content = journal.read_bytes()
    except FileNotFoundError:
        return None
    content, checksum = content[:-32], content[-32:]
    if not content.startswith(_MAGIC) or hashlib.sha256(content).digest() != checksum:
        return None
    place = len(_MAGIC)
    size, count = _HEAD.unpack_from(content, place)
    place += _HEAD.size
    changes = []
    for _ in range(count):
        offset, length = _ENTRY.unpack_from(content, place)
        place += _ENTRY.size
        changes.append((offset, content[place : place + length]))
        place += length
    return size, changes


def _apply(path: Path, size: int, changes: list[tuple[int, bytes]], durable: bool = True) -> None:
    with open(path, "r+b", buffering=0) as file:
        for offset, data in changes:
            _write_at(file.fileno(), data, offset)
        os.ftruncate(file.fileno(), size)
        if durable:
            os.fsync(file.fileno())


def _write_at(file: int, data: bytes, offset: int) -> None:
    written = 0
    while written < len(data):
        written += os.pwrite(file, data[written:], offset + written)
