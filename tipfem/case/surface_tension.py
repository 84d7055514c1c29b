"""Surface tension as a case gives it, and the time and acceleration of the shortest capillary waves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tipfem.arguments import is_number, meant
from tipfem.case.fluid import Fluid
from tipfem.errors import Invalid
from tipfem.typing import Array

Pair = str | tuple[str, str]
LARGEST = 3.0  # of any liquid, a molten metal [N/m]
USUAL = 0.07  # of water under air [N/m]
GAS, EARTH = 0.02, 9.81  # density of a gas over that of a liquid, at most; gravity [m/s^2]
RADIANS = 3.2  # a contact angle above 0 and below this may be one in radians


class TensionTable:
    """The tension of each interface of a case, ``given`` [N/m] by the names of two fluids, or of one at a free surface.

    It is ``sigma`` (F + 1, F + 1) between each two of the F fluids, symmetric; the last one is empty space [N/m], where
    fluids may end if ``empty``.

    Raises:
        Invalid: a fluid is unknown, a pair never meets or is given twice, a value is no number >= 0, or a fluid would
            spread without end, see `spreading`.
    """

    def __init__(self, given: Mapping[Pair, float] | None, fluids: Sequence[Fluid], *, empty: bool) -> None:
        self.given: dict[Pair, float] = {}
        self._names = names = [fluid.name for fluid in fluids]
        self.sigma = np.zeros((len(names) + 1, len(names) + 1))
        self._density = np.append([fluid.density for fluid in fluids], 0.0)
        if given is None:
            return
        if not isinstance(given, Mapping):
            text = f"is {given!r}; it must be a dict from two fluids to a tension, as {{('water', 'air'): 0.0728}}"
            raise Invalid("surface_tension", text, "Case")
        for pair, value in given.items():
            both = _checked_pair(pair, names, empty=empty)
            if not (is_number(value) and value >= 0):
                raise _invalid(both, f"it is {value!r} N/m; it must be a number >= 0")
            if self.has(both):
                raise _invalid(both, "it is given twice; the order of the two fluids does not matter")
            i, j = ([names.index(name) for name in both] + [len(names)])[:2]
            self.given[pair] = float(value)
            self.sigma[i, j] = self.sigma[j, i] = value
        if text := spreading(self.sigma, names):
            raise Invalid("surface_tension", text, "Case")

    def __bool__(self) -> bool:
        """Whether any interface has tension."""
        return bool(self.sigma.any())

    def has(self, names: Sequence[str]) -> bool:
        """Whether a tension is given between fluids of these names, in any order."""
        return any({pair} == set(names) if isinstance(pair, str) else set(pair) == set(names) for pair in self.given)

    def doubts(self, *, empty: bool) -> list[str]:
        """Lines on tensions that no liquid has, and on those not given where a fluid would spread for it."""
        why = f"no liquid has more than {LARGEST:g}; is it in N/m? 1 mN/m is 1e-3 N/m"
        large = {pair: value for pair, value in self.given.items() if value > LARGEST}
        found = [f"surface tension of {_in_words(pair)} is {value:g} N/m; {why}" for pair, value in large.items()]
        count = len(self._names) + empty
        names = [(name,) for name in self._names] + [()]
        for i, j in np.argwhere(np.triu(self.sigma[:count, :count]) > 0).tolist():
            for film in sorted(set(range(count)) - {i, j}):
                missing = [k for k in (i, j) if not self.has((*names[k], *names[film]))]
                if missing and self.sigma[i, j] > self.sigma[i, film] + self.sigma[film, j]:
                    pairs = " and that ".join(_named((*names[film], *names[k])) for k in missing)
                    film_name, *both = ((*names[k], "empty space")[0] for k in (film, i, j))
                    text = f"surface tension of {pairs} is not given and counts as 0; where all three meet, "
                    found.append(f"{text}{film_name} would spread between {both[0]} and {both[1]} without end")
        return found

    def slips(self, width: float, gravity: float, angles: Sequence[tuple[str, Any]], *, empty: bool) -> list[str]:
        """Lines on tanks of small ``width`` [m] without tension, and on contact angles that may be in radians.

        ``angles`` are pairs of what has contact angles, and these, see `cosines`.
        """
        found, density = [], np.sort(self._density if empty else self._density[:-1])
        length = math.sqrt(USUAL / (density[-1] * (gravity or EARTH)))
        if len(density) > 1 and density[0] < GAS * density[-1] and not self.given and width < length:
            found.append(
                f"the tank is {width:g} m wide or high, less than the {length:.2g} m below which tension as that of "
                "water rules over weight, and surface_tension is not given"
            )
        for name, given in angles:
            angle = max(np.ravel(list((given or {}).values())), default=0.0)
            if 0 < angle < RADIANS:
                text = f"{name} has a contact_angle of {angle:g} degrees; is it in degrees?"
                found.append(f"{text} {angle:g} rad are {math.degrees(angle):.3g}")
        return found

    def cosines(self, wall: Any, kind: str = "walls") -> dict[tuple[int, int], tuple[float, float]]:
        """Cosines of the contact angles of a wall, in the first fluid, by the numbers of the two fluids.

        The first one is the mean of those at which a contact recedes and advances, the second one half their
        difference: 0 where both are one. ``kind`` is where case files have the wall, or what has a name and contact
        angles as one; only walls may have two angles.

        Raises:
            Invalid: an interface has no tension, or an angle is no number from 0 to 180 degrees, nor two of them.
        """
        found: dict[tuple[int, int], tuple[float, float]] = {}
        what = "wall" if kind == "walls" else "body"
        path, subject = (kind, wall.name, "contact_angle"), f"{what} {wall.name!r}"
        if not isinstance(wall.contact_angle or {}, Mapping):
            wanted = "a dict from two fluids to an angle, as {('water', 'air'): 60}"
            text = f"is {wall.contact_angle!r}; it must be {wanted}"
            raise Invalid(path, text, subject)
        for pair, angle in (wall.contact_angle or {}).items():
            both = (pair,) if isinstance(pair, str) else pair
            if not (isinstance(both, tuple) and all(isinstance(name, str) for name in both)):
                text = f"has {pair!r}; it must be two names of fluids, as ('water', 'air'), or one at a free surface"
                raise Invalid(path, text, subject)
            if not self.has(both):
                known = "; ".join(map(_named, self.given)) or "no interface"
                text = f": without surface tension a contact angle has no meaning, and {_named(both)} has none; "
                raise Invalid(
                    (*path, *both), text + f"surface_tension gives it to {known}", f"{subject}: contact_angle"
                )
            angles = list(angle) if isinstance(angle, list | tuple) else [angle, angle]
            if len(angles) != 2 or not all(map(is_number, angles)):
                why = "a number of degrees, or two: those at which the contact recedes and advances"
                raise Invalid((*path, *both), f": it is {angle!r}; it must be {why}", subject)
            if not 0 <= angles[0] <= angles[1] <= 180:
                why = "from 0 to 180 degrees"
                if len(set(angles)) > 1:
                    why = "two angles from 0 to 180 degrees, the one at which contacts recede first"
                raise Invalid((*path, *both), f": it is {angle!r}; it must be {why}", subject)
            if angles[0] < angles[1] and not (kind == "walls" and wall.velocity is None and wall.motion is None):
                why = f"one number of degrees on a {what}{' that moves' * (kind == 'walls')}; "
                why += "only a wall at rest holds contacts"
                raise Invalid((*path, *both), f": it is {angle!r}; it must be {why}", subject)
            one, other = ([self._names.index(name) for name in both] + [len(self._names)])[:2]
            if (one, other) in found or (other, one) in found:
                raise Invalid((*path, *both), ": the angle of this interface is given twice", subject)
            receding, advancing = (math.cos(math.radians(each)) for each in angles)
            found[one, other] = 0.5 * (receding + advancing), 0.5 * (receding - advancing)
        for part in range(2):
            wall_energies(found, self.sigma, wall.name, part, kind)
        return found

    def capillary_time(self, spacing: float) -> float:
        """sqrt((rho_1 + rho_2) h^3 / (4 pi sigma)), the least of all interfaces [s]; infinite without tension.

        In it a wave of length 2 h, the shortest that a mesh of the ``spacing`` h [m] has, advances by a radian or so; a
        time integration that is explicit in the tension needs shorter steps (J. U. Brackbill, D. B. Kothe & C. Zemach,
        A continuum method for modeling surface tension, Journal of Computational Physics 100, 1992).
        """
        times = [math.sqrt(both * spacing**3 / (4 * math.pi * s)) for both, s in self._interfaces()]
        return min(times, default=math.inf)

    def acceleration(self, spacing: float) -> float:
        """2 sigma / ((rho_1 + rho_2) h^2), the largest of all interfaces [m/s^2]: of a particle that is off by h."""
        return max((2 * s / (both * spacing**2) for both, s in self._interfaces()), default=0.0)

    def _interfaces(self) -> list[tuple[float, float]]:
        """Sum of the densities [kg/m^3] and tension [N/m] of each interface that has some."""
        if not self.sigma.any():
            return []
        total = self._density[:, None] + self._density
        return [(float(total[i, j]), float(self.sigma[i, j])) for i, j in np.argwhere(np.triu(self.sigma) > 0)]


def spreading(sigma: Array, names: Sequence[str]) -> str:
    """Fault where one of three tensions is larger than the other two together, in words; "" where there is none.

    A film of the third fluid between the two others then has less energy than their interface, however thin it is. No
    shape has the least energy (L. Ambrosio & A. Braides, Functionals defined on partitions in sets of finite perimeter
    II, Journal de Mathematiques Pures et Appliquees 69, 1990), and each break of a film that no mesh has would give its
    energy anew. In equilibrium the interface is covered, and has the sum of both tensions (Antonow's rule). Three
    tensions of which any is 0 are left alone, as not all of the fluids meet.
    """
    words = [*names, "empty space"]
    for film in range(len(sigma)):
        through = sigma[:, film, None] + sigma[film]
        covered = (sigma > through * (1 + 1e-9)) & (sigma[:, film, None] > 0) & (sigma[film] > 0)
        for i, j in np.argwhere(covered)[:1]:
            first, second = sorted((int(i), int(j)))
            return (
                f"of {words[first]} and {words[second]} is {sigma[i, j]:g} N/m, more than of both with {words[film]}, "
                f"which would spread between them without end; give {through[i, j]:.4g} N/m at most, "
                "that of an interface it covers"
            )
    return ""


def wall_energies(
    cosines: Mapping[tuple[int, int], tuple[float, float]],
    sigma: Array,
    wall: str = "",
    part: int = 0,
    kind: str = "walls",
) -> Array:
    """Energies (F + 1,) per area of a wall that each fluid wets, the last one for a dry wall [N/m].

    By Young's law gamma_j - gamma_i = sigma_ij cos(theta), with the angle theta measured in fluid i; without an angle
    it is 90 degrees. Energies of fluids that no angle connects are relative to 0. ``part`` is 0 for these energies; 1
    for those by which contacts are held, of half the difference of the cosines; see `TensionTable.cosines`.

    Raises:
        Invalid: angles between three fluids contradict each other.
    """
    count = len(sigma)
    steps = np.full((count, count), np.nan)
    for (i, j), cosine in cosines.items():
        steps[i, j] = sigma[i, j] * cosine[part]
        steps[j, i] = -steps[i, j]
    energy = np.full(count, np.nan)
    for first in range(count):
        if np.isnan(energy[first]):
            energy[first], ahead = 0.0, [first]
            while ahead:
                i = ahead.pop()
                for j in np.flatnonzero(~np.isnan(steps[i])).tolist():
                    wanted = energy[i] + steps[i, j]
                    if np.isnan(energy[j]):
                        energy[j] = wanted
                        ahead.append(j)
                    elif abs(energy[j] - wanted) > 1e-6 * sigma.max():
                        text = ": the angles contradict each other; two of three interfaces decide the third (Young)"
                        what = "wall" if kind == "walls" else "body"
                        raise Invalid((kind, wall, "contact_angle"), text, f"{what} {wall!r}")
    return energy


def _in_words(pair: Any) -> str:
    return " and ".join(map(str, pair)) if isinstance(pair, tuple) else str(pair)


def _named(pair: Pair) -> str:
    names = (pair,) if isinstance(pair, str) else pair
    return f"the {'interface' if len(names) > 1 else 'free surface'} of {_in_words(names)}"


def _invalid(names: Sequence[str], text: str) -> Invalid:
    return Invalid(("surface_tension", *names), f": {text}", f"Case: surface_tension of {' and '.join(names)}")


def _checked_pair(pair: Any, names: Sequence[str], *, empty: bool) -> tuple[str, ...]:
    """The names of the one or two fluids of an interface; see `TensionTable` for errors."""
    both = (pair,) if isinstance(pair, str) else pair
    if not (isinstance(both, tuple) and len(both) in (1, 2) and all(isinstance(name, str) for name in both)):
        text = f"has {pair!r}; it must be two names of fluids, as ('water', 'air'), or one at a free surface"
        raise Invalid("surface_tension", text, "Case")
    for name in both:
        if name not in names:
            text = f"there is no fluid {name!r}; the fluids are {', '.join(names)}{meant(name, names)}"
            raise _invalid(both, text)
    if len(both) == 1 and not empty:
        raise _invalid(both, "there is no free surface; name the two fluids of an interface")
    if both[0] == both[-1] and len(both) == 2:
        raise _invalid(both, "the same fluid twice has no interface")
    return both


def tension_contradictions(interface: str, *, pressure: str, pairs: bool) -> list[str]:
    """Contradictions between a case and surface tension, in words; ``pairs``: whether it is given for two fluids."""
    if pairs and interface != "sharp":
        return [f"is given between two fluids with interface = {interface!r}; it needs interface = 'sharp'"]
    if pairs and pressure == "continuous":
        return ["is given with numerics.pressure = 'continuous'; the pressures on both sides differ: say 'auto'"]
    return []
