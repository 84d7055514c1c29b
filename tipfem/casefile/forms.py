"""Named forms: the functions of time and the shapes that a case file can give without Python.

Each is a model of the schema and, once loaded, the function itself: what `tipfem.Wall`, `tipfem.Motion`,
`tipfem.Case` and `Tank.fill` take. `describe` recognises them and writes them back.
"""

from __future__ import annotations

import collections.abc
import csv
import dataclasses
import re
import types
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, reduce
from inspect import cleandoc
from operator import or_
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, PlainValidator, Tag, WithJsonSchema, create_model
from pydantic_core import PydanticCustomError

from tipfem.arguments import is_number
from tipfem.case.declaration import Declared, declared
from tipfem.case.walls import Motion
from tipfem.case.waves import WAVE_MAKERS, IrregularWaves, WaveMaker, WavePiston
from tipfem.typing import Array


class Model(BaseModel):
    """A table of a case file: unknown keys are mistakes, and no value is converted to another type."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False, protected_namespaces=())

    kind: ClassVar[type | None] = None  # the class that it becomes, of a table within one

    if TYPE_CHECKING:  # fields that `declares` brings

        def __getattr__(self, name: str) -> Any: ...

    def given(self) -> dict[str, Any]:
        """The values that the file has, by their keys."""
        return {key: getattr(self, key) for key in type(self).model_fields if key in self.model_fields_set}


M = TypeVar("M", bound=Model)


def declares(kind: type, *names: str, **keys: str) -> Callable[[type[M]], type[M]]:
    """Add the fields of a dataclass to a table, as they are declared there; see `tipfem.case.declaration`.

    ``names`` are those of the fields, without names and keys all that the table has not itself; ``keys`` has names by
    the table's keys.
    """

    def extended(table: type[M]) -> type[M]:
        fields = declared(kind)
        chosen = {**dict.fromkeys(names), **keys} if names or keys else dict.fromkeys(fields)
        content: dict[str, Any] = {
            key: _field(fields[name or key]) for key, name in chosen.items() if key not in table.model_fields
        }
        made = create_model(table.__name__, __base__=table, __doc__=table.__doc__, __module__=__name__, **content)
        made.kind = kind
        return made

    return extended


def table_of(kind: type) -> type[Model]:
    """The table of a dataclass, with all of its fields."""
    text = cleandoc(kind.__doc__ or "").partition("\n\n")[0]
    return declares(kind)(create_model(kind.__name__, __base__=Model, __doc__=" ".join(text.split())))


def _field(field: Declared) -> tuple[Any, Any]:
    text = re.sub(r"^\([\w, ]*\) ", "", field.sentence).partition("; in Python ")[0]  # without the shape of an array
    text += f" [{field.unit}]" if field.unit and f"[{field.unit}]" not in text else ""
    if isinstance(field.kind, type) and dataclasses.is_dataclass(field.kind):
        table = table_of(field.kind)
        return table, Field(default_factory=table, description=text)
    default = ... if field.default is dataclasses.MISSING else field.default
    return _in_toml(field.annotation), Field(default, description=text)


def _in_toml(annotation: Any) -> Any:
    """A type as a case file has it: functions of time by their forms, fluids by their names, no others of Python's."""
    origin, items = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        content: Any = (_in_toml(items[0]), *annotation.__metadata__)
        return Annotated[content]
    if origin not in (Union, types.UnionType):
        return annotation
    kept = [
        one for one in items if get_origin(one) is not collections.abc.Callable and not dataclasses.is_dataclass(one)
    ]
    if any(get_origin(one) is collections.abc.Callable and get_args(one)[0] == [float] for one in items):
        kept = [one for one in kept if one in (str, type(None))] + [NumberOrFunction if float in kept else TimeFunction]
    return reduce(or_, kept)


def quantity(description: str, unit: str = "", default: Any = ..., **limits: Any) -> Any:
    """A field with its unit, in its description for readers and by itself for messages."""
    extra: dict[str, Any] | None = {"unit": unit} if unit else None
    text = f"{description} [{unit}]" if unit else description
    return Field(default, description=text, json_schema_extra=extra, **limits)


def _number_or_list(value: Any) -> float | tuple[float, ...]:
    if is_number(value):
        return float(value)
    if isinstance(value, Sequence) and len(value) in (2, 3) and all(is_number(item) for item in value):
        return tuple(float(item) for item in value)
    raise PydanticCustomError("value", "a number, or a list of 2 or 3 numbers")


Value = Annotated[
    float | tuple[float, ...],
    PlainValidator(_number_or_list),
    WithJsonSchema(
        {"anyOf": [{"type": "number"}, {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 3}]}
    ),
]
VALUE = "in the SI unit of what the function is for; a list has one number for each coordinate"
VECTORS = ("body_force", "translation", "velocity")  # functions whose values have as many coordinates as positions
VALUES = ("value", "amplitude", "mean", "end_value", "start_value")
Vector = Annotated[list[float], Field(min_length=2, max_length=3)]
Point = Annotated[list[float], Field(min_length=2, max_length=2)]


def size_of(value: Any) -> int:
    """Number of components of a value; 0 for a number alone."""
    return len(value) if isinstance(value, Sequence) else 0


def _result(value: Any) -> Any:
    """A float for a number alone, as `tipfem.Motion` wants it, and else an array."""
    return float(value) if np.ndim(value) == 0 else value


def smooth_step(part: float) -> float:
    """0 up to 0 and 1 from 1 on, with continuous first and second derivatives: 6 t^5 - 15 t^4 + 10 t^3."""
    t = min(max(part, 0.0), 1.0)
    return t * t * t * (10.0 + t * (6.0 * t - 15.0))


class TimeForm(Model):
    """A function of time."""

    def sizes(self) -> Iterator[tuple[str, int]]:
        """Keys that hold values, and how many numbers each has."""
        yield from ((key, size_of(value)) for key, value in self.given().items() if key in VALUES)


class Constant(TimeForm):
    """The same value at all times."""

    form: Literal["constant"] = Field(description="the kind of function")
    value: Value = quantity(f"the value, {VALUE}")

    def __call__(self, time: float) -> Any:
        """The value at a time [s]."""
        return _result(np.asarray(self.value))


class Sine(TimeForm):
    """soft(t) (mean + amplitude sin(2 pi frequency t + phase))."""

    form: Literal["sine"] = Field(description="the kind of function")
    amplitude: Value = quantity(f"the amplitude, {VALUE}")
    frequency: float = quantity("the frequency", "Hz", gt=0)
    phase: Value = quantity("the phase at t = 0; a list has one for each coordinate", "rad", default=0.0)
    mean: Value = quantity(f"the mean value, {VALUE}", default=0.0)
    soft_start: float = quantity(
        "time over which the function grows smoothly from zero; 0 for none: a motion then begins with a jump of its "
        "velocity",
        "s",
        0.0,
        ge=0,
    )

    def __call__(self, time: float) -> Any:
        """The value at a time [s]."""
        wave = np.asarray(self.amplitude) * np.sin(2 * np.pi * self.frequency * time + np.asarray(self.phase))
        value = np.asarray(self.mean) + wave
        return _result(value * smooth_step(time / self.soft_start) if self.soft_start else value)

    def sizes(self) -> Iterator[tuple[str, int]]:
        """See `TimeForm.sizes`; one phase may be that of all coordinates."""
        yield from super().sizes()
        if size_of(self.phase):
            yield "phase", size_of(self.phase)


class Ramp(TimeForm):
    """From one value to another between two times, by a polynomial of fifth order whose ends are smooth."""

    form: Literal["ramp"] = Field(description="the kind of function")
    start_value: Value = quantity(f"the value before, {VALUE}", default=0.0)
    end_value: Value = quantity(f"the value after, {VALUE}")
    start_time: float = quantity("when it begins to change", "s", 0.0, ge=0)
    end_time: float = quantity("when it has reached the end value; later than start_time", "s", gt=0)

    def __call__(self, time: float) -> Any:
        """The value at a time [s]."""
        part = smooth_step((time - self.start_time) / (self.end_time - self.start_time))
        start, end = np.asarray(self.start_value), np.asarray(self.end_value)
        return _result(start + part * (end - start))


class Table(TimeForm):
    """Values at given times, and what lies between them; from a CSV file or from lists in the case file."""

    form: Literal["table"] = Field(description="the kind of function")
    file: str | None = quantity(
        "a CSV file, its path relative to the case file: the first column is the time [s], the others are the value's "
        "coordinates; lines that begin with # are comments, and a line of column names may come first",
        default=None,
        min_length=1,
    )
    columns: list[str] | None = quantity(
        "names of the columns to read in place of all, the first one for the time", default=None, min_length=2
    )
    start_time: float = quantity("time of the table at which the run begins", "s", 0.0)
    degrees: bool = quantity("whether the values are angles in degrees; they are in rad otherwise", default=False)
    times: list[float] | None = quantity("the times, ascending, in place of a file", "s", None, min_length=2)
    values: list[Value] | None = quantity(f"the values at these times, {VALUE}", default=None, min_length=2)
    interpolation: Literal["cubic", "linear"] = quantity(
        "cubic: a spline with continuous second derivatives, which motions need; linear: straight lines",
        default="cubic",
    )

    def sizes(self) -> Iterator[tuple[str, int]]:
        """See `TimeForm.sizes`."""
        for value in self.values or ():
            yield "values" if self.file is None else "file", size_of(value)

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """By which checkpoints tell functions apart: the values count, not the file that they were read from."""
        for key, value in super().__repr_args__():
            yield key, None if key in ("file", "columns") and self.times is not None else value

    def read(self, folder: Path) -> Table:
        """The same table with the times and values of its file, those of the run in its units.

        Raises:
            ValueError: the file cannot be read; the message says what it must be, for the key ``file``.
        """
        times, values = self.times or [], self.values or []
        if self.file is not None:
            times, values = read_table(folder / self.file, self.columns)
        elif not (self.start_time or self.degrees):
            return self
        if self.start_time:
            times = [time - self.start_time for time in times]
        if self.degrees:
            values = [np.radians(value).tolist() for value in values]
        return self.model_copy(update={"times": times, "values": values, "start_time": 0.0, "degrees": False})

    def __call__(self, time: float) -> Any:
        """The value at a time [s]; before and after the table by its first and last piece."""
        return _result(self._function(time))

    @cached_property
    def _function(self) -> Any:
        from scipy.interpolate import CubicSpline  # here, for its import takes a while

        times, values = np.array(self.times), np.array(self.values)
        if self.interpolation == "cubic" and len(times) > 2:
            return CubicSpline(times, values)
        slopes = np.diff(values, axis=0) / np.diff(times).reshape(-1, *[1] * (values.ndim - 1))

        def linear(time: float) -> Array:
            k = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2))
            return np.asarray(values[k] + (time - times[k]) * slopes[k])

        return linear


def read_table(path: Path, columns: Sequence[str] | None) -> tuple[list[float], list[Any]]:
    """Times [s] and values of a CSV file, see `Table`; `ValueError` if it cannot be read or holds no such table."""
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            rows = [(number, row) for number, row in enumerate(csv.reader(file), 1) if row and row[0][:1] != "#"]
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text in UTF-8"
        raise ValueError(f"{str(path)!r} cannot be read ({reason}); give a CSV file") from None
    names: list[str] = []
    if rows and not _is_float(rows[0][1][0]):
        names = [name.strip() for name in rows.pop(0)[1]]
    chosen: list[int] | None = None
    if columns is not None:
        missing = [name for name in columns if name not in names]
        if missing:
            raise ValueError(f"{str(path)!r} has no column {missing[0]!r}; it has {names or 'no names of columns'}")
        chosen = [names.index(name) for name in columns]
    table: list[list[float]] = []
    for number, row in rows:
        width = len(rows[0][1])
        cells = row if chosen is None else [row[k] if k < len(row) else "" for k in chosen]
        hint = ", with commas between them and a point in decimals" if width == 1 else ""
        if len(row) != width or not all(_is_float(cell) for cell in cells) or len(cells) < 2:
            text = f"{str(path)!r}, line {number} is {','.join(row)!r}; it must be finite numbers, a time and 1 to 3 "
            raise ValueError(f"{text}values, as many as in the first row ({width}){hint}")
        table.append([float(cell) for cell in cells])
    if len(table) < 2 or len(table[0]) > 4:
        raise ValueError(f"{str(path)!r} has {len(table)} rows of numbers; a table has at least 2, of 2 to 4 columns")
    return [row[0] for row in table], [row[1] if len(row) == 2 else tuple(row[1:]) for row in table]


def _is_float(text: str) -> bool:
    try:
        return is_number(float(text))
    except ValueError:
        return False


class WaveForm(TimeForm):
    """Displacement of a wall that makes waves."""

    def made(self) -> WaveMaker:
        """The wave maker of that form; `ValueError` if values do not fit."""
        return WAVE_MAKERS[self.form](**{key: value for key, value in self.given().items() if key != "form"})


@declares(WavePiston)
class Waves(WaveForm):
    """The motion of a piston that makes waves of a height and a period."""

    form: Literal["waves"] = Field(description="the kind of function")


@declares(IrregularWaves)
class Irregular(WaveForm):
    """The motion of a piston that makes irregular waves of a spectrum."""

    form: Literal["irregular_waves"] = Field(description="the kind of function")


WallMotion = Annotated[Constant | Sine | Ramp | Table | Waves | Irregular, Field(discriminator="form")]
"""A function of time for the displacement of a wall, or waves, told apart by ``form``."""

FORMS: dict[str, type[Model]] = {"constant": Constant, "sine": Sine, "ramp": Ramp, "table": Table}
TimeFunction = Annotated[Constant | Sine | Ramp | Table, Field(discriminator="form")]
"""A function of time, told apart by ``form``."""


def or_function(
    kind: Any, of: type | tuple[type, ...], functions: dict[str, type[Model]] = FORMS, key: str = "form"
) -> Any:
    """A value of a kind, by the types ``of`` that it has in TOML, or a table, of a function of time, by a ``key``."""
    forms = [Annotated[model, Tag(form)] for form, model in functions.items()]

    def tag(value: Any) -> str | None:
        if isinstance(value, of):
            return "value"
        return value.get(key) if isinstance(value, dict) else getattr(value, key, None)

    return Annotated[reduce(or_, forms, Annotated[kind, Tag("value")]), Discriminator(tag)]


VectorOrFunction = Any if TYPE_CHECKING else or_function(Vector, list)
"""A constant vector, or a function of time to one."""

NumberOrFunction = Any if TYPE_CHECKING else or_function(float, (int, float))
"""A number, or a function of time to one."""


@declares(Motion)
class MotionTable(Model):
    """Rigid motion of the whole tank, or of a body in 2-D."""


class SineCurve(Model):
    """y = height + amplitude sin(2 pi (x - origin) / wavelength), or cos with form = "cosine"."""

    form: Literal["sine", "cosine"] = Field(description="the kind of curve")
    height: float = quantity("the mean height", "m")
    amplitude: float = quantity("the amplitude", "m")
    wavelength: float = quantity("the length of a wave", "m", gt=0)
    origin: float = quantity("where the argument of the sine or cosine is zero", "m", 0.0)

    def __call__(self, x: Array) -> Array:
        """Heights (K,) [m] at places x (K,) [m]."""
        angle = 2 * np.pi * (x - self.origin) / self.wavelength
        return np.asarray(self.height + self.amplitude * (np.sin(angle) if self.form == "sine" else np.cos(angle)))


class Polyline(Model):
    """Straight lines between points; level before the first and after the last."""

    form: Literal["polyline"] = Field(description="the kind of curve")
    points: list[Point] = quantity("points (x, y), x ascending", "m", min_length=2)

    def __call__(self, x: Array) -> Array:
        """Heights (K,) [m] at places x (K,) [m]."""
        points = np.array(self.points)
        return np.asarray(np.interp(x, points[:, 0], points[:, 1]))


Curve = Annotated[SineCurve | Polyline, Field(discriminator="form")]
"""A height over x, told apart by ``form``."""


class Disc(Model):
    """A disc; a ball in 3-D."""

    centre: Vector = quantity("the centre", "m")
    radius: float = quantity("the radius", "m", gt=0)


class HalfSpace(Model):
    """The side of a straight line (a plane in 3-D) from which the normal points away."""

    point: Vector = quantity("a point of the line or plane", "m")
    normal: Vector = quantity("the direction across it, out of the half-space; of any length")

    def __call__(self, x: Array) -> Array:
        """Mask (K,) of the positions (K, d) [m] that are inside."""
        return np.asarray((x - np.array(self.point)) @ np.array(self.normal) < 0)


class Polygon(Model):
    """The inside of a closed polyline in 2-D, by the even-odd rule."""

    points: list[Point] = quantity("corners (x, y) in order; the last is joined to the first", "m", min_length=3)

    def __call__(self, x: Array) -> Array:
        """Mask (K,) of the positions (K, 2) [m] that are inside."""
        inside = np.zeros(len(x), dtype=bool)
        corners = np.array(self.points)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            crosses = (a[1] > x[:, 1]) != (b[1] > x[:, 1])
            if a[1] != b[1]:
                inside ^= crosses & (x[:, 0] < a[0] + (x[:, 1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
        return inside


class Side(Model):
    """Region below or above a curve."""

    curve: Curve
    above: bool

    def __call__(self, x: Array) -> Array:
        """Mask (K,) of the positions (K, d) [m] on this side of the curve; its height is along y."""
        height = self.curve(x[:, 0])
        return np.asarray(x[:, 1] > height if self.above else x[:, 1] < height)


class Limit(Model):
    """A box in which particles stand closer than elsewhere."""

    box: list[Vector] = quantity("lower and upper corner", "m", min_length=2, max_length=2)
    largest: float = quantity("the largest target in the box", "m", gt=0)


class Limits(Model):
    """Argument ``where`` of `tipfem.Grading`: the smallest of the limits of the boxes that a position is in."""

    limits: list[Limit]

    def __call__(self, x: Array) -> Array:
        """Largest targets (K,) [m] at positions (K, d) [m]; inf in no box."""
        target = np.full(len(x), np.inf)
        for limit in self.limits:
            lower, upper = np.array(limit.box)
            inside = ((x >= lower) & (x <= upper)).all(axis=1)
            target[inside] = np.minimum(target[inside], limit.largest)
        return target


@dataclasses.dataclass(frozen=True)
class Uniform:
    """A function that is the same at all positions: a body force, or the pressure at an outlet."""

    function: Constant | Sine | Ramp | Table  # of time [s]

    def __call__(self, position: Array, time: float) -> Array:
        """Values at positions (N, d) [m] and a time [s]: (N, d) of vectors, one number of numbers."""
        value = np.asarray(self.function(time))
        return np.broadcast_to(value, position.shape) if value.ndim else value
