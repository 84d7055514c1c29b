"""tipfem: immiscible incompressible fluids by the position-based Particle Finite Element Method.

Names are imported when they are first used: reading a case file or a command's help needs no Taichi, whose import
takes most of a second. They are those of ``__init__.pyi``, which type checkers and editors read.
"""

import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

__version__ = "0.2.0"

_STUB = Path(__file__).with_suffix(".pyi").read_text("utf-8")
_LINES = re.findall(r"^from (\S+) import (\([^)]*\)|.*)", _STUB, re.MULTILINE)
_MODULES = {name: module for module, names in _LINES for name in re.findall(r"\bas (\w+)", names)}
__all__ = sorted(_MODULES)

# In a source tree render/ and demos/ stand beside this folder. Where a command is run from the tree of a tipfem that is
# installed elsewhere, Python imports this folder and would not find them.
if find_spec("tipfem.render") is None:
    __path__.append(str(Path(__file__).resolve().parents[1]))


def __getattr__(name: str) -> Any:
    """A public name, imported now and kept."""
    if name not in _MODULES:
        raise AttributeError(f"module 'tipfem' has no attribute {name!r}")
    module = import_module(_MODULES[name])
    value = getattr(module, name, None) or import_module(f"{module.__name__}.{name}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names, imported or not."""
    return sorted({*globals(), *__all__})
