"""Errors of a run; those of arguments are ValueErrors."""

from __future__ import annotations

from collections.abc import Sequence


class Invalid(ValueError):
    """A value that is refused.

    Args:
        path: the keys that lead to it, from the case as a case file has it, or from the object that refuses it:
            ``"tank.spacing"``, ``("walls", "left", "velocity")``.
        text: what is wrong, as a predicate ("is 0 m; it must be > 0"), or ": " and a sentence about all that the
            keys lead to.
        subject: what has the value, in words of Python; by default the keys before the last.

    Attributes:
        path: the keys.
        text: see above.
    """

    def __init__(self, path: str | Sequence[str | int], text: str, subject: str = "") -> None:
        self.path: tuple[str | int, ...] = tuple(path.split(".")) if isinstance(path, str) else tuple(path)
        self.text = text
        if text.startswith(": "):
            super().__init__((subject or ".".join(map(str, self.path))) + text)
        elif not self.path:
            super().__init__(f"{subject} {text}")
        else:
            subject = subject or ".".join(map(str, self.path[:-1]))
            super().__init__(f"{subject}: {self.path[-1]} {text}")


class Several(ValueError):
    """Values that are refused together, with the ``errors`` on each."""

    def __init__(self, errors: Sequence[Invalid]) -> None:
        self.errors = tuple(errors)
        super().__init__("\n".join(map(str, errors)))


def refuse_all(errors: Sequence[Invalid]) -> None:
    """Raise the error, or `Several` for more than one; nothing for none."""
    if errors:
        raise errors[0] if len(errors) == 1 else Several(errors)


class StartWarning(UserWarning):
    """Doubt about the start of a run, reported once and not again when the run is resumed."""


class CaseDoubt(StartWarning):
    """Doubt about a case: one of `tipfem.Case.doubts`, which the commands print as notes."""


class FolderRefused(ValueError):
    """A folder in which a run is to leave its results, but cannot; no other value of the run is wrong."""


class SimulationError(RuntimeError):
    """A run cannot continue; all results up to that time are kept and written."""


class StepRefused(Exception):
    """A time step failed or was too inaccurate; a shorter one may succeed."""


class CheckpointError(RuntimeError):
    """A checkpoint cannot be read, or is not one of this run."""


class TriangulationError(RuntimeError):
    """The particles could not be triangulated."""
