"""Orbits along two parameters, a number of theirs held: the start, brought to that number, and both ways from it."""

from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from jaxtyping import Float

from continuation import driver, event_search
from continuation.arclength import Control
from continuation.driver import Met, Task
from continuation.points import start_point
from continuation.stretch import Mark, backwards, glued

from ..orbits.orbit import OrbitError
from ..output.units import scales_in
from ..problem.end import End, ended
from ..problem.equations import problem
from ..problem.first_touch import OrbitWatch, to_touch
from ..problem.orbit_on_branch import OrbitPoint, place_orbit
from ..problem.orbit_rows import OrbitRows, row_of, spot_of
from ..problem.touches import scales
from ..scene import check
from ..scene.parameters import bounds_of, domain, marked
from ..scene.scale import scene_length
from ..scene.scene import Scene
from .assemble import about, columns_of
from .branch import Branch, Special
from .held_equations import HELD, HeldOrbits
from .largest_position import largest_of

SMALLEST = 1e-8  # step


@dataclass(frozen=True, eq=False)
class HeldBranch(OrbitRows[Special]):
    """Orbits along two parameters that share a number.

    names: of the parameters; held, value: the number and what it is; bounds: of each; scene: at the start; data: an
    xarray.Dataset with a row a point, in order, the columns as of a `Branch`, both parameters among them; reasons: why
    it ends, at its first and at its last point; special: none is looked for.
    """

    names: tuple[str, str]
    held: str
    value: float
    bounds: dict[str, tuple[float, float]]
    scene: Scene = field(repr=False)
    data: xr.Dataset = field(repr=False)
    reasons: tuple[str, str]
    special: tuple[Special, ...] = ()

    NOUN = "branch"

    def __repr__(self):
        one, two = self.names
        return f"HeldBranch({self.held} {self.value:g} along {one} and {two}, {len(self)} points)"

    @property
    def values(self) -> Float[np.ndarray, "points 2"]:
        """The two parameters at each point, (points, 2)."""
        return np.stack([self.data[name].values for name in self.names], axis=1)

    def located(self, place: int) -> tuple[Scene, OrbitPoint]:
        """(the scene at a point, its `OrbitPoint`)."""
        row = row_of(self.data, place)
        values = {name: float(row[name]) for name in self.names}
        return self.scene.replace(**values), spot_of(row, self.names[0])


class HeldWatch(OrbitWatch):
    """Orbits along two parameters, up to a touch."""

    def touch(self, task, points, view, bad):
        points, residual = to_touch(task, points, view, bad, self.length)
        return None if residual is None else Met(points, Mark(0, "GR", residual), End.GRAZE)

    def events(self, task, points, view, known, end):
        return []


def asked(scene, names, bounds, hold):
    """(the two names, {name: (low, high)}, the name of the number, its value). Raises ArgumentError."""
    pair = tuple(names) if isinstance(names, tuple | list) else ()
    for name in pair:
        check.require_known(name, scene.names, name)
    if len(pair) != 2 or pair[0] == pair[1]:
        raise check.ArgumentError("name", "must be two different parameters where one number is held", names)
    check.require_apart(*pair)
    if not isinstance(bounds, dict) or set(bounds) != set(pair):
        raise check.ArgumentError("bounds", f"must give (low, high) for {pair[0]} and for {pair[1]}, by name", bounds)
    given = list(hold.items()) if isinstance(hold, dict) else []
    if len(given) != 1 or given[0][0] not in HELD or not np.isscalar(given[0][1]) or not np.isfinite(given[0][1]):
        raise check.ArgumentError("hold", f"must be one number by its name, {' or '.join(HELD)}", hold)
    return pair, {name: bounds_of(scene, name, bounds[name]) for name in pair}, given[0][0], float(given[0][1])


def start(scene, names, held, value, along, z):
    """(`HeldOrbits`, z, the tangent towards greater values of the second parameter) of a near orbit with that number,
    the second parameter as it is; None where Newton's method comes to none. along, z: `OrbitEquations` of an orbit
    along the first parameter."""
    numbered, which = marked(scene, *names)
    pick = np.array([float(name == held) for name in HELD])
    curve = HeldOrbits(numbered, which, along.cycle, pick, np.asarray(value))
    z = np.append(z, float(scene.parameter(names[1])))
    numbers = (np.float64(each) for each in (0.0, 1.0, 1.0, -np.inf, np.inf))
    control = Control(scales(curve, scene_length(scene)), *numbers)
    found = event_search.pinned(problem(curve), z, -1, z[-1], control, curve)
    watch = HeldWatch(curve, scene_length(scene))
    if not found.met or not watch.good(found.z[None], watch.view(found.z[None]))[0]:
        return None
    return curve, found.z, found.tangent


def near(branch, held, value):
    """(`OrbitEquations`, z) of the points of a `Branch` along the first parameter between which the number comes to a
    value, the nearest to its start first."""
    numbers = largest_of(branch) if held == "peak" else branch.data["least_speed"].values
    first = int(np.argmin(abs(branch.values - float(branch.scene.parameter(branch.name)))))
    crossed = np.flatnonzero((numbers[:-1] - value) * (numbers[1:] - value) <= 0)
    for k in sorted(crossed.tolist(), key=lambda k: abs(k - first)):
        place = k + int(abs(numbers[k + 1] - value) < abs(numbers[k] - value))
        yield place_orbit(branch.scene, branch.name, spot_of(row_of(branch.data, place), branch.name))


def nowhere(branch: Branch, held: str, value: float) -> OrbitError:
    """The error where a number comes to a value nowhere."""
    rule = f"{held} is nowhere {value:.12g} along {branch.name}"
    return OrbitError(rule, float(np.max(branch.data["residual"].values)), "give another orbit, or wider bounds")


def both(scene, names, bounds, held, value, begun, direction, settings):
    """The `HeldBranch` from `start`s both ways, or one."""
    curve, z, ahead = begun
    own, given = [domain(scene, name) for name in names], [bounds[name] for name in names]
    box = tuple((max(low, least), min(high, most)) for (low, high), (least, most) in zip(given, own, strict=True))
    only = tuple(tuple(each for each in pair if each not in ends) for pair, ends in zip(own, given, strict=True))
    first, largest, tolerance = (settings[key] for key in ("first_step", "largest_step", "tolerance"))
    numbers = (np.float64(each) for each in (min(SMALLEST, first), largest, tolerance, *box[1]))
    length = scene_length(scene)
    control = Control(scales(curve, length), *numbers)
    watch = HeldWatch(curve, length)
    task = Task(problem(curve), curve, control, min(first, largest), box, only, watch, starts=())
    on = driver.run(task, start_point(z, ahead)) if direction != "backward" else None
    back = driver.run(task, start_point(z, -ahead)) if direction != "forward" else None
    whole = on if back is None else backwards(back) if on is None else glued([backwards(back), on])
    reasons = tuple("the start" if one is None else _reason(one, names) for one in (back, on))
    return HeldBranch(names, held, value, bounds, scene, _data(scene, ended(whole), names), reasons)


def _data(scene, one, names):
    count = int(np.sum(one.args.cycle.sides != 0))
    found = columns_of(one, names[1], count, 0) | {names[0]: one.points.z[:, -2]}
    meant = about(names[0]) | about(names[1])
    order = [*names, *(key for key in found if key not in names)]
    data = {key: xr.Variable(meant[key][0], found[key], meant[key][1]) for key in order}
    return xr.Dataset(data, attrs=scales_in(scene))


def _reason(one, names):
    text = End[one.end.name].reason(one.value).text
    return text.replace("the parameter", names[one.which], 1)
