"""Scenes, or volumes, of the stored times of a results folder, as they are drawn."""

import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.results.fields.catalogue import Flow
from tipfem.results.fields.field_state import StoredState
from tipfem.results.reader import RunResults
from tipfem.results.steered import Laws, commands_in

from .arrays import Array
from .bodies import Tracks
from .flow import velocity
from .scales import digits_of
from .scene import Scene
from .setting import Setting
from .slices import Plane, sliced
from .volume import Volume

FRAMES = ("room", "tank")
HALVED = 6  # times that the way of particles is halved where cells would turn over, before they stay
MOST_SAMPLED = 24  # stored times that are read to find the range of a field


class ResultsError(ValueError):
    """A results folder that cannot be read; the message names the file and what is wrong."""


class Results(Setting):
    """The stored times of a results folder, in order of time.

    `len(results)` is the number of stored times, and `results.scene(i)` reads one of them. fields.pvd, or without
    one fields.vtkhdf, is read when the object is made; a run that is still under way may add more times, which
    `refresh` finds.

    Args:
        out: results folder.
        keep: number of scenes that are kept with their geometry, the latest used. 64 suit a viewer that goes back
            and forth in time.
        frame: "tank" draws what moves with the tank as if the tank rested: places are turned and shifted back to where
            the tank was at t = 0. Velocities stay those in the room, given along the tank's axes.
        slice: plane that scenes of a flow in 3-D lie in, such as "y=0.5".
        solid: whether a flow in 3-D is taken without a slice; it has `volume` then, and no scenes.

    Attributes:
        dimension: of the flow.
        folder: its path.
        times: stored times [s].
        files: their VTU files; or as often fields.vtkhdf.
        fluid_names: names of the F fluids.
        fluid_densities: (F,) [kg/m^3].
        lower: (d,) lower corner of the domain [m].
        upper: (d,) upper corner of the domain [m].
        spacing: of the particles [m].
        period: (2,) width of the domain along the axes that are periodic, 0 for others [m]; None if none is.
        axial: whether the flow is axisymmetric; pictures show it on both sides of the axis.
        openings: in the walls of the tank.
        title: of the case.

    Raises:
        ValueError: ``keep`` or ``frame`` is not possible; a tank that does not move has no frame of its own.
        ResultsError: the folder cannot be read.
    """

    def __init__(
        self,
        out: str | PathLike[str],
        keep: int = 1,
        frame: str = "room",
        slice: str | None = None,
        solid: bool = False,
    ) -> None:
        if frame not in FRAMES:
            raise ValueError(f"frame {frame!r}: expected one of {', '.join(FRAMES)}")
        if keep < 1:
            raise ValueError(f"keep {keep}: expected a number of scenes, 1 or more")
        self._keep = keep
        self._kept: dict[tuple[Path, int, int], Scene] = {}
        self.folder, self._frame, self._solid = Path(out), frame, solid
        self._plane = None if slice is None else Plane.of(slice)
        self.refresh()
        if frame == "tank" and not self._tracks.moves("tank"):
            raise ValueError(f"frame 'tank': the tank of {self.folder} does not move, or its history is not there")

    def refresh(self) -> None:
        """Read case.json and the list of stored times again; scenes of files that are unchanged are kept.

        Raises:
            ResultsError: the folder cannot be read.
        """
        try:
            self._run = RunResults(self.folder)
            self.times, self.files = self._run.times.tolist(), self._run.files
        except ValueError as error:
            raise ResultsError(str(error)) from None
        if not self.times:
            raise ResultsError(f"{self.folder}: no fields have been written yet")
        case = self._run.case
        try:
            super().__init__(case)
            if self.dimension == 3 or self._plane is not None:
                self._check_plane()
            if self.axial:
                self.lower[0] = -self.upper[0]
            if self._frame == "tank" and self._tank is not None:  # the box of the case is that of all its places
                walls = self._tank.at_start().points
                self.lower, self.upper = walls.min(axis=0), walls.max(axis=0)
            self._tracks = Tracks(_moving(case), self.folder / "history.csv")
            valves = commands_in(self.folder, "valve") if self.openings else []
            self._valves = [(time, str(told["opening"]), bool(told["open"])) for time, told in valves]
            self._laws = Laws(case, self.folder)
        except KeyError as error:
            raise ResultsError(f"{self.folder / 'case.json'}: the entry {error} is missing") from None
        except (TypeError, ValueError) as error:
            if isinstance(error, ResultsError):
                raise
            raise ResultsError(f"{self.folder / 'case.json'}: {error}") from None

    def _check_plane(self) -> None:
        """Refuse a plane that does not fit the flow, or a flow in 3-D without one."""
        if self.dimension == 2:
            raise ResultsError(f"slice {self._plane}: the results in {self.folder} are in 2-D; leave out the slice")
        if self._frame != "room":
            raise ResultsError("frame 'tank': it is for results in 2-D; leave it out")
        if self._plane is not None:
            try:
                self._plane.within(self.lower, self.upper)
            except ValueError as error:
                raise ResultsError(str(error)) from None
        elif not self._solid:
            axis = min((k for k in range(3) if k != self._up), key=lambda k: self.upper[k] - self.lower[k])
            middle = Plane(axis, float(self.lower[axis] + self.upper[axis]) / 2)
            raise ResultsError(f"{self.folder}: the results are in 3-D; choose a plane, for example slice {middle}")

    def __len__(self) -> int:
        return len(self.times)

    def forget(self) -> None:
        """Begin to keep scenes anew, so that a copy of this object may read in another thread."""
        self._kept = {}

    def sampled(self) -> Iterable[Scene]:
        """Up to 24 scenes over the run, read at each passage, from which all its pictures take their colours."""
        return _Sampled(self)

    def scene(self, i: int) -> Scene:
        """Read one of the stored times.

        Args:
            i: its number; negative numbers count from the last.

        Raises:
            IndexError: there is no such time.
            ResultsError: its file cannot be read.
        """
        if not -len(self) <= i < len(self):
            raise IndexError(f"stored time {i}: there are {len(self)}, numbered from 0")
        path = self.files[i]
        # A run that starts again writes the same names anew.
        key = path, i % len(self), path.stat().st_mtime_ns if path.is_file() else 0
        scene = self._kept.pop(key, None)
        if scene is None:
            scene = self._read(path, i % len(self))
        self._kept[key] = scene
        while len(self._kept) > self._keep:
            self._kept.pop(next(iter(self._kept)))
        return scene

    def scene_at(self, time: float) -> Scene:
        """The flow at a time [s]: the nearest stored one, its particles carried on by their velocities.

        Where that would turn cells over, particles are carried less far.

        Raises:
            ResultsError: see `scene`; or the flow is in 3-D, periodic, axisymmetric, or seen from the tank.
        """
        if self.dimension == 3 or self._frame != "room" or self.period is not None or self.axial:
            kinds = "flows in 2-D, not axisymmetric or periodic, and in the room"
            raise ResultsError(f"{self.folder}: pictures between stored times are of {kinds}; leave out the frame rate")
        scene = self.scene(int(np.argmin(np.abs(np.array(self.times) - time))))
        if time == scene.time:
            return scene
        way, position, turned = (time - scene.time) * velocity(scene), scene.position, scene.cells[:0]
        for attempt in itertools.count():
            way[turned] *= 0.5 if attempt < HALVED else 0.0
            position = np.clip(scene.position + way, self.lower, self.upper)
            turned = scene.cells[_flat_or_turned(position[scene.cells], scene.position[scene.cells])]
            if not len(turned):
                break
        poses = self._tracks.at(time)
        return replace(
            scene,
            position=position,
            time=time,
            bodies=tuple(body.placed(*pose) for body, pose in zip(self._outlines, poses, strict=False)),
            tank=None if self._tank is None else self._tank.placed(*poses[-1]),
        )

    def volume(self, i: int) -> Volume:
        """Read one of the stored times of a flow in 3-D; see `scene`."""
        if not -len(self) <= i < len(self):
            raise IndexError(f"stored time {i}: there are {len(self)}, numbered from 0")
        i %= len(self)
        stored = self._stored(i)
        position = stored.points.astype(np.float64)
        wall = np.ravel(stored.data["wall"]) != 0 if "wall" in stored.data else np.zeros(len(position), bool)
        pose = np.array(next(iter(self._tracks.at(self.times[i])), np.zeros(6)))
        return self.volume_of(self._flow(i, stored, stored.data, position), self.times[i], wall, pose, **self._scale())

    def _flow(self, i: int, stored: StoredState, data: Mapping[str, Array], position: Array) -> Flow:
        """A stored time with data and positions (N, d) as they are drawn."""
        place, laws = (position, stored.cells, stored.cell_fluid), self._laws.at(self.times[i])
        return Flow(data, *place, self.fluid_densities, laws, self.period, self.spacing, self.axial)

    def _scale(self) -> dict[str, Any]:
        """Attributes by which clocks are written."""
        return {"digits": max(3, digits_of(self.times)), "span": float(np.ptp(self.times))}

    def _stored(self, i: int) -> StoredState:
        """A stored time as its file has it."""
        try:
            stored = self._run.stored(i)
        except ValueError as error:
            raise ResultsError(str(error)) from None
        if "fluid" not in stored.data:
            there = ", ".join(sorted(stored.data))
            raise ResultsError(f"{stored.file}: point data 'fluid' is missing; there are: {there}")
        return stored

    def _read(self, path: Path, i: int) -> Scene:
        if self._plane is not None:
            try:
                return sliced(self.volume(i), self._plane)
            except ValueError as error:
                raise ResultsError(f"{path}: {error}") from None
        stored = self._stored(i)
        data, poses, points = stored.data, self._tracks.at(self.times[i]), stored.points[:, :2]
        if self._frame == "tank" and self._tank is not None:
            x, y, angle = poses[-1]
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])  # rows are turned back
            points = (points - (x, y)) @ turn + self._tank.reference
            places = (np.array([pose[:2] for pose in poses]) - (x, y)) @ turn + self._tank.reference
            poses = [(float(at[0]), float(at[1]), pose[2] - angle) for at, pose in zip(places, poses, strict=True)]
            if "velocity" in data:
                data = {**data, "velocity": data["velocity"][:, :2] @ turn}
        flow, wall = self._flow(i, stored, data, points), np.ravel(data["wall"]) if "wall" in data else None
        try:
            time = self.times[i]
            return self.scene_of(flow, time, wall, poses, self._shut(time), **self._scale())
        except ValueError as error:
            raise ResultsError(f"{path}: {error}") from None

    def _shut(self, time: float) -> set[str]:
        """Names of the openings that are closed at a time [s], by the case or by commands until then."""
        told = {name: opened for at, name, opened in self._valves if at <= time}
        return {gap.name for gap in self.openings if not told.get(gap.name, gap.is_open(time))}


def _flat_or_turned(corners: Array, before: Array) -> Array:
    """Cells (M,), of corners (M, 3, 2), that have less than 10 % of the area that they had."""
    (a, b), (c, d) = (np.moveaxis(at[:, 1:] - at[:, :1], 1, 0) for at in (corners, before))
    was = c[:, 0] * d[:, 1] - c[:, 1] * d[:, 0]
    return np.asarray((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) * np.sign(was) < 0.1 * abs(was))


class _Sampled:
    """Scenes at evenly spaced stored times."""

    def __init__(self, results: Results) -> None:
        self._results, self._count = results, min(len(results), MOST_SAMPLED)

    def __iter__(self) -> Iterator[Scene]:
        numbers = np.linspace(0, len(self._results) - 1, self._count).round()
        return (self._results.scene(int(i)) for i in numbers)


def _moving(case: Mapping[str, Any]) -> dict[str, Array]:
    """Reference points at t = 0 of the bodies and of the tank, the last, by their names [m]."""
    found = {str(body["name"]): np.asarray(body["reference"], float) for body in case.get("bodies", ())}
    tank = case.get("tank", case.get("blocks"))
    return found if tank is None else found | {"tank": np.asarray(tank["reference"], float)}
