"""TOML text with the line of every key and list item, which the standard parser does not tell."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Key = str | int
Path = tuple[Key, ...]

DEPTH = 20  # of tables and lists in each other
TOO_DEEP = f"tables or lists are nested more than {DEPTH} deep; no case file is"
BARE = re.compile(r"[A-Za-z0-9_-]+")
SPACE = re.compile(r"[ \t]*")
BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
SCALAR = re.compile(r"[^,\]}#\n]+")
STRINGS = (
    re.compile(r'"""(?:\\.|[^\\])*?"{3,5}', re.DOTALL),
    re.compile(r"'''.*?'{3,5}", re.DOTALL),
    re.compile(r'"(?:\\.|[^"\\])*"'),
    re.compile(r"'[^']*'"),
)


class SyntaxProblem(ValueError):
    """Text that is not TOML; ``line`` counts from 1, 0 if the parser does not tell, and ``reason`` is what is wrong."""

    def __init__(self, line: int, reason: str) -> None:
        super().__init__(reason)
        self.line, self.reason = line, reason


@dataclass
class Source:
    """Content of a TOML text, with its line numbers."""

    data: dict[str, Any]  # the content
    # the line of every table, key and list item by its path, counted from 1
    lines: dict[Path, int] = field(default_factory=dict)

    def line(self, path: Path) -> int:
        """The line of a path, or of the nearest table around it that is in the text; 1 at the top."""
        while path and path not in self.lines:
            path = path[:-1]
        return self.lines.get(path, 1)


def parse(text: str) -> Source:
    """Read a TOML text; `SyntaxProblem` if it is not valid."""
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise SyntaxProblem(0, TOO_DEEP) from None
    except tomllib.TOMLDecodeError as error:
        message = str(error)
        found = re.search(r"\s*\(at line (\d+), column \d+\)$", message)
        if found:
            reason = message[: found.start()]
            if reason == "Invalid value" and re.search(r"=\s*[A-Za-z]", text.splitlines()[int(found[1]) - 1]):
                reason = "a text needs quotes, as 'water'"
            raise SyntaxProblem(int(found[1]), reason) from None
        line = text.rstrip().count("\n") + 1 if "end of document" in message else 0
        raise SyntaxProblem(line, re.sub(r"\s*\(at end of document\)$", " at the end of the file", message)) from None
    except ValueError:  # Python's limit for the digits of a whole number
        line = next((k for k, each in enumerate(text.splitlines(), 1) if re.search(r"\d{4000}", each)), 0)
        raise SyntaxProblem(line, "a number has thousands of digits") from None
    if _depth(data) > DEPTH:
        raise SyntaxProblem(0, TOO_DEEP)
    return Source(data, _Scanner(text.replace("\r\n", "\n")).scan())


def _depth(data: Any) -> int:
    """Depth of nested tables and lists."""
    level, found = [data], 0
    while level:
        found += 1
        tables = [list(item.values()) if isinstance(item, Mapping) else item for item in level]
        level = [item for table in tables for item in table if isinstance(item, Mapping | list)]
    return found


def value_of(text: str) -> Any:
    """A TOML value, or the text itself where it is none: a word without quotes."""
    try:
        found = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return found["value"] if set(found) == {"value"} and _depth(found) <= DEPTH else text


def keys_of(text: str) -> list[str]:
    """The keys of a dotted key such as ``fluids."heavy oil".density``; `ValueError` if it is none."""
    scanner = _Scanner(text)
    try:
        keys = scanner.dotted_key()
    except (AttributeError, IndexError, AssertionError):
        raise ValueError(text) from None
    if scanner.at != len(text) or len(keys) > DEPTH:
        raise ValueError(text)
    return keys


class _Scanner:
    """Walks over a valid TOML text and notes where keys and list items stand; values are passed over."""

    def __init__(self, text: str) -> None:
        self.text, self.at = text, 0
        self.lines: dict[Path, int] = {}
        self._tables: dict[Path, int] = {}  # how many elements of each array of tables have begun
        self._counted = (0, 1)

    def scan(self) -> dict[Path, int]:
        """The line of every path of the whole text."""
        table: Path = ()
        self._skip(BLANK)
        while self.at < len(self.text):
            if self.text.startswith("[[", self.at):
                self.at += 2
                named = self._header()
                index = self._tables[named] = self._tables.get(named, -1) + 1
                self.lines.setdefault(named, self._line())
                table = (*named, index)
                self.lines[table] = self._line()
                self.at += 2
            elif self.text[self.at] == "[":
                self.at += 1
                table = self._header()
                self.lines[table] = self._line()
                self.at += 1
            else:
                self._pair(table)
            self._skip(BLANK)
        return self.lines

    def dotted_key(self) -> list[str]:
        """The keys of a dotted key, up to what follows it."""
        keys = []
        while True:
            self._skip(SPACE)
            if self.text[self.at : self.at + 1] in ('"', "'"):
                text = self._string()
                keys.append(str(tomllib.loads(f"value = {text}")["value"]))
            else:
                found = BARE.match(self.text, self.at)
                assert found is not None
                keys.append(found[0])
                self.at = found.end()
            self._skip(SPACE)
            if self.text[self.at : self.at + 1] != ".":
                return keys
            self.at += 1

    def _header(self) -> Path:
        """The path of a table by the keys in its header; those of arrays of tables continue in their last element."""
        path: Path = ()
        keys = self.dotted_key()
        for key in keys[:-1]:
            path = (*path, key)
            self.lines.setdefault(path, self._line())
            if path in self._tables:
                path = (*path, self._tables[path])
        return (*path, keys[-1])

    def _pair(self, table: Path) -> None:
        """A key and its value within a table."""
        line, path = self._line(), table
        for key in self.dotted_key():
            path = (*path, key)
            self.lines.setdefault(path, line)
        assert self.text[self.at] == "="
        self.at += 1
        self._skip(SPACE)
        self._value(path)

    def _value(self, path: Path) -> None:
        start = self.text[self.at]
        if start == "[":
            self._list(path)
        elif start == "{":
            self._inline_table(path)
        elif start in "\"'":
            self._string()
        else:
            self._skip(SCALAR)

    def _list(self, path: Path) -> None:
        self.at += 1
        index = 0
        while True:
            self._skip(BLANK)
            if self.text[self.at] == "]":
                break
            item = (*path, index)
            self.lines[item] = self._line()
            self._value(item)
            self._skip(BLANK)
            if self.text[self.at] == ",":
                self.at += 1
            index += 1
        self.at += 1

    def _inline_table(self, path: Path) -> None:
        self.at += 1
        while True:
            self._skip(BLANK)
            if self.text[self.at] == "}":
                break
            self._pair(path)
            self._skip(BLANK)
            if self.text[self.at] == ",":
                self.at += 1
        self.at += 1

    def _string(self) -> str:
        for pattern in STRINGS:
            if found := pattern.match(self.text, self.at):
                self.at = found.end()
                return found[0]
        raise AssertionError(f"no string at {self.at}")

    def _skip(self, pattern: re.Pattern[str]) -> None:
        found = pattern.match(self.text, self.at)
        if found:
            self.at = found.end()

    def _line(self) -> int:
        at, line = self._counted
        if self.at < at:
            at, line = 0, 1
        line += self.text.count("\n", at, self.at)
        self._counted = (self.at, line)
        return line
