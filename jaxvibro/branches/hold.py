"""Orbits along two parameters, a number of theirs held: the start, brought to that number, and both ways from it."""

import numpy as np
import xarray as xr

from continuation import driver, event_search
from continuation.arclength import Control
from continuation.driver import Met, Task
from continuation.points import start_point
from continuation.stretch import Mark, backwards, glued

from ..orbits.orbit import OrbitError
from ..output.units import scales_in
from ..problem.end import End, ended
from ..problem.end_in_plane import told
from ..problem.equations import problem
from ..problem.first_touch import OrbitWatch, to_touch
from ..problem.orbit_on_branch import place_orbit
from ..problem.orbit_rows import row_of, spot_of
from ..problem.touches import scales
from ..scene import check
from ..scene.parameters import bounds_of, domain, marked
from ..scene.scale import scene_length
from .assemble import about, columns_of
from .branch import Branch
from .held_branch import HeldBranch
from .held_equations import HELD, HeldOrbits
from .largest_position import largest_of

SMALLEST = 1e-8  # step


class HeldWatch(OrbitWatch):
    """Orbits along two parameters, up to a touch."""

    def touch(self, task, points, view, bad):
        points, residual = to_touch(task, points, view, bad, self.length)
        return None if residual is None else Met(points, Mark(0, "GR", residual), End.GRAZE)

    def events(self, task, points, view, known, end):
        return []


def asked(scene, names, bounds, hold):
    """(the two names, {name: (low, high)}, the name of the number, its value). Raises ArgumentError."""
    given = list(hold.items()) if isinstance(hold, dict) else []
    if len(given) != 1 or given[0][0] not in HELD or not np.isscalar(given[0][1]) or not np.isfinite(given[0][1]):
        raise check.ArgumentError("hold", f"must be one number by its name, {' or '.join(HELD)}", hold)
    pair = tuple(names) if isinstance(names, tuple | list) else ()
    for name in pair:
        check.require_known(name, scene.names, name)
    if len(pair) != 2 or pair[0] == pair[1]:
        raise check.ArgumentError("name", "must be two different parameters where one number is held", names)
    check.require_apart(*pair)
    if not isinstance(bounds, dict) or set(bounds) != set(pair):
        raise check.ArgumentError("bounds", f"must give (low, high) for {pair[0]} and for {pair[1]}, by name", bounds)
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
    numbers = _numbers(branch, held)
    first = int(np.argmin(abs(branch.values - float(branch.scene.parameter(branch.name)))))
    crossed = np.flatnonzero((numbers[:-1] - value) * (numbers[1:] - value) <= 0)
    for k in sorted(crossed.tolist(), key=lambda k: abs(k - first)):
        place = k + int(abs(numbers[k + 1] - value) < abs(numbers[k] - value))
        yield place_orbit(branch.scene, branch.name, spot_of(row_of(branch.data, place), branch.name))


def _numbers(branch, held):
    return largest_of(branch) if held == "peak" else branch.data["least_speed"].values


def nowhere(branch: Branch, held: str, value: float) -> OrbitError:
    """The error where a number comes to a value nowhere."""
    numbers = _numbers(branch, held)
    rule = f"{held} is nowhere {value:.12g} along {branch.name}, but from {min(numbers):.4g} to {max(numbers):.4g}"
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
    limits = settings["limits"]
    task = Task(problem(curve), curve, control, min(first, largest), box, only, watch, starts=(), limits=limits)
    some = task._replace(limits=limits.halved() if direction == "both" else limits)
    on = driver.run(some, start_point(z, ahead)) if direction != "backward" else None
    task = task._replace(limits=limits.after(0 if on is None else len(on.points.z) - 1))
    back = driver.run(task, start_point(z, -ahead)) if direction != "forward" else None
    whole = on if back is None else backwards(back) if on is None else glued([backwards(back), on])
    reasons = tuple("the start" if one is None else _why(ended(one), names) for one in (back, on))
    return HeldBranch(names, held, value, bounds, scene, _data(scene, ended(whole), names), reasons)


def _why(one, names):
    return told(one.end, names[one.which], one.value)


def _data(scene, one, names):
    count = int(np.sum(one.args.cycle.sides != 0))
    found = columns_of(one, names[1], count, 0) | {names[0]: one.points.z[:, -2]}
    meant = about(names[0]) | about(names[1])
    order = [*names, *(key for key in found if key not in names)]
    data = {key: xr.Variable(meant[key][0], found[key], meant[key][1]) for key in order}
    return xr.Dataset(data, attrs=scales_in(scene))
