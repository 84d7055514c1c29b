"""Case files that can be run: `tipfem.casefile.loading`, with the simulation of what they describe."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tipfem.case.case import Case
from tipfem.casefile import loading

if TYPE_CHECKING:
    from tipfem.run.simulation import Simulation


class CaseFile(loading.CaseFile):
    """A case file, free of all mistakes that show without making its particles; see `load_case`.

    Attributes:
        name: the file, as it was given.
        data: its content with the overrides.
        table: the same, checked and with all defaults.
        parts: the fluids, the tank, walls and rules that it describes.
    """

    def simulation(
        self,
        out: str | Path | None = None,
        columns: Mapping[str, Callable[[Simulation], float]] | None = None,
        case: Case | None = None,
        steering: str | Path | None = None,
        overwrite: bool | None = None,
    ) -> Simulation:
        """The simulation, at its start; `CaseFile.end` is where it is to run to.

        Args:
            out: folder for the results, or None to write none; `CaseFile.folder` is that of the file.
            columns: further columns of the history, see `Simulation`.
            case: from `case`, if it has been made already.
            steering: a file of commands to repeat, see `Simulation`.
            overwrite: whether an earlier run in ``out`` is replaced, see `Simulation`.

        Raises:
            ValueError: ``steering`` cannot be read, or has a mistake.
            CaseFileError: see `case`; or the particles cannot be meshed, or ``out`` cannot be written to.
        """
        from tipfem.run.simulation import Simulation  # here, for it starts Taichi
        from tipfem.run.steering import read_records

        commands = None if steering is None else read_records(steering)  # its mistakes are none of the case file
        made, options = case or self.case(), self.options()
        simulation: Simulation = self.placed(
            lambda: Simulation(made, out, columns=columns, steering=commands, overwrite=overwrite, **options)
        )
        return simulation


def load_case(path: str | Path, overrides: Sequence[str] = ()) -> CaseFile:
    """Read a case file and check all that can be checked without particles.

    Args:
        path: a case file in TOML.
        overrides: values that replace those of the file, each a dotted key and a TOML value:
            ``fluids.water.viscosity=2e-3``. List items are counted from 0: ``fill.1.fluid=air``.

    Returns:
        The case file, from which `CaseFile.case` makes the case.

    Raises:
        CaseFileError: there are mistakes; it has all of them.
    """
    return CaseFile(**vars(loading.load_case(path, overrides)))
