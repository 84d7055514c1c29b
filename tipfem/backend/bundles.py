"""Bundles: named tuples of arrays and numbers that a kernel takes as one parameter.

Taichi is given their fields one by one, so machine code and its start are those of a kernel with as many parameters.
Annotations of the fields are texts, since Python 3.10 refuses types of Taichi in a named tuple:

    class Rows(NamedTuple):
        offsets: "Ints1"
        columns: "Ints1"

    @kernel
    def count(rows: Rows, counts: Ints1):
        for i in range(counts.shape[0]):
            counts[i] = rows.offsets[i + 1] - rows.offsets[i]

In a kernel a bundle exists at compile time only; functions take one as a template.
"""

import inspect
import sys
from collections.abc import Callable, Collection
from typing import Any


def fields(bundle: Any) -> dict[str, Any]:
    """Types of a bundle's fields by their names."""
    known = vars(sys.modules[bundle.__module__])
    texts = {name: getattr(kind, "__forward_arg__", kind) for name, kind in bundle.__annotations__.items()}
    return {name: eval(text, known) if isinstance(text, str) else text for name, text in texts.items()}


def unbundle(function: Any, filled_in: Collection[str]) -> Callable[..., tuple[Any, ...]] | None:
    """Set the signature of a kernel's function that Taichi is to see, with the fields of bundles one by one.

    Returns the function that makes the fields of passed arguments single ones, None where no parameter is a bundle. The
    caller does not pass ``filled_in``; bundles are noted in ``__bundles__``, for `taichi_patches`.
    """
    signature = inspect.signature(function)
    parameters = signature.parameters
    bundles = {name: each.annotation for name, each in parameters.items() if hasattr(each.annotation, "_fields")}
    if not bundles:
        return None
    single: list[inspect.Parameter] = []
    for name, each in parameters.items():
        of = fields(bundles[name]).items() if name in bundles else ()
        single += [each.replace(name=f"{name}__{field}", annotation=kind) for field, kind in of] or [each]
    function.__signature__, function.__bundles__ = signature.replace(parameters=single), bundles
    passed = [name for name in parameters if name not in filled_in]
    values = "".join(f"*{name}, " if name in bundles else f"{name}, " for name in passed)
    return eval(f"lambda {', '.join(passed)}: ({values})")  # type: ignore[no-any-return]
