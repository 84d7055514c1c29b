"""Options that several studies have in common."""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path


class ShowDefaults(argparse.ArgumentDefaultsHelpFormatter):
    """Help that states defaults, where there are any: None, False and nothing are not stated."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        stated = action.default is not None and action.default is not False and action.default != []
        return super()._get_help_string(action) if stated else action.help


def study_parser(
    document: str | None, name: str, flows: Iterable[str], across: Sequence[int] | None, what: str
) -> argparse.ArgumentParser:
    """The parser of a study of several flows at several resolutions, with --flow, --across and --out.

    Args:
        document: the study's docstring, whose first paragraph is the description.
        name: of the study, and of its folder in out/validation.
        flows: their names, all of which are run by default.
        across: default resolutions; None where each flow has its own.
        what: a resolution is.
    """
    parser = argparse.ArgumentParser(description=(document or "").split("\n\n")[0], formatter_class=ShowDefaults)
    names, out = list(flows), Path("out/validation") / name
    parser.add_argument("--flow", choices=names, nargs="+", default=names, help="which flows")
    parser.add_argument("--across", type=int, nargs="+", default=across, metavar="N", help=what)
    parser.add_argument("--out", type=Path, default=out, metavar="FOLDER", help="folder for the results")
    return parser
