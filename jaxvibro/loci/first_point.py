"""Where a locus begins: a special point in plain numbers, the equations of its curve, and what is asked of it."""

from typing import NamedTuple

import numpy as np

from continuation.arclength import Control
from continuation.event_search import step, tangent
from continuation.limits import UNLIMITED
from continuation.points import start_point

from ..branches.branch import Special
from ..branches.follow import SMALLEST, check_settings
from ..orbits.impact_equations import Cycle
from ..problem import resting, soft_grazing
from ..problem.equations import are_impacts, are_releases, codes, problem
from ..problem.grazing import padded
from ..problem.orbit_on_branch import OrbitPoint, is_own_image, place_orbit
from ..problem.touches import TOUCH, Touch, scales, touches
from ..scene import check
from ..scene.parameters import bounds_of, domain, flat, marked, tied
from ..scene.scale import scene_length
from ..scene.scene import Scene
from ..scene.symmetry import stays_symmetric
from .completing import Completing
from .extended_system import Grazing, Singular
from .track import LocusSettings, LocusWay

KINDS = "SN", "PD", "SB", "GR"  # that `loci` follows
RESTS = "CH", "RL"  # an orbit rests there: a CH that ends a branch has no locus


class LocusStart(NamedTuple):
    """A special point in plain numbers. kind; name: of the parameter of `spot.value`; scene: at the point; spot: its
    orbit."""

    kind: str
    name: str
    scene: Scene
    spot: OrbitPoint

    @property
    def touches(self) -> list[Touch]:
        """The `Touch`es of a GR."""
        along, z = place_orbit(self.scene, self.name, self.spot)
        return touches(along, z, scene_length(self.scene))


def start_of(special, kinds=KINDS):
    """The `LocusStart` of a `Special` of one of these kinds. Raises ArgumentError for points of others."""
    if not isinstance(special, Special) or special.kind not in kinds:
        given = special.kind if isinstance(special, Special) else special
        raise check.ArgumentError("special", f"must be a special point of kind {', '.join(kinds)}", given)
    if special.kind in RESTS and not are_releases(special.spot.sides).any():
        rule = "must have a rest: of a chatter that ends its branch nothing is known beyond"
        raise check.ArgumentError("special", rule, f"{special.kind} at {special.value:.12g}")
    return LocusStart(special.kind, special.name, special.scene, special.spot)


def ways(start, names, bounds, first_step, largest_step, tolerance, limits=UNLIMITED):
    """The `track.LocusWay`s from a `LocusStart`, in two parameters: one, or at a GR one for each touch. Raises
    ArgumentError for arguments that cannot be."""
    asked = settings(start.scene, names, bounds, first_step, largest_step, tolerance, limits)
    return [_way(curve, z, asked) for curve, z in equations(start, asked.names)]


def settings(scene, names, bounds, first_step, largest_step, tolerance, limits=UNLIMITED):
    """The `track.LocusSettings` of these arguments, lengths not weighed yet. Raises ArgumentError."""
    names = named(scene, names)
    if not isinstance(bounds, dict) or set(bounds) != set(names):
        raise check.ArgumentError("bounds", f"must give (low, high) for {names[0]} and for {names[1]}, by name", bounds)
    bounds = {name: bounds_of(scene, name, bounds[name]) for name in names}
    given = check_settings(first_step, largest_step, tolerance, (), ())
    own = [domain(scene, name) for name in names]
    box = [(max(low, least), min(high, most)) for (low, high), (least, most) in zip(bounds.values(), own, strict=True)]
    only = tuple(
        tuple(each for each in pair if each not in bounds[name]) for pair, name in zip(own, names, strict=True)
    )
    numbers = [np.float64(each) for each in (min(SMALLEST, first_step), largest_step, given["tolerance"], *box[1])]
    control, first = Control(np.ones(1), *numbers), min(first_step, largest_step)
    return LocusSettings(control, first, names, bounds, tuple(box), only, scene_length(scene), limits)


def weighed(curve, z, asked):
    """The `track.LocusSettings` with the weights of a curve's lengths at z."""
    weights = scales(curve, asked.length)
    for k, name in enumerate(asked.names, -2):
        if name.endswith(".stiffness"):  # it goes through orders of magnitude
            weights[k] = 1.0 / (1.0 + abs(z[k]))
    return asked._replace(control=asked.control._replace(scale=weights))


def _way(curve, z, asked):
    """The `track.LocusWay` from z, towards greater values of the second parameter."""
    asked = weighed(curve, z, asked)
    ahead = tangent(problem(curve), z, asked.control.scale, curve)
    return LocusWay(curve, start_point(_settled_at(curve, z, ahead, asked.control), ahead), asked)


def backward(way):
    """The `track.LocusWay` in the other direction."""
    return way._replace(start=start_point(way.start.z, -way.start.tangent))


def named(scene, names):
    """Two parameters of a scene by name. Raises ArgumentError."""
    pair = tuple(names) if isinstance(names, tuple | list) else ()
    for name in pair:
        check.require_known(name, scene.names, name)
    if len(pair) != 2 or pair[0] == pair[1]:
        raise check.ArgumentError("names", "must be two different parameters of the scene", names)
    check.require_apart(*pair)
    return pair


def equations(start, names, whole=False):
    """(`Grazing`, `Singular` or `Completing`, z) at a `LocusStart`, along any number of parameters, a list of one; at a
    GR of one for each touch, which leaves the others out. A tuple of names is one, of several that have one value.
    whole: of the whole orbit, be it symmetric, unless an SB asks for half of it. Raises ArgumentError."""
    scene, spot = start.scene, start.spot
    if start.kind != "GR" and not len(spot.times):
        rule = "must be one of an orbit with impacts: of others a GR alone has derivatives and a locus"
        raise check.ArgumentError("special", rule, f"{start.kind} without impacts")
    impacts = _impacts(start)
    values = [tied(scene, name) for name in names]
    numbered, which = marked(scene, *names)
    half = is_half(start, names)
    if start.kind == "SB" and not half:
        raise check.ArgumentError("names", "must keep the scene symmetric: an SB is no point of another", names)
    half = half and not (whole and start.kind != "SB")
    turn, periods = (-1.0, 0.5 * spot.periods) if half else (1.0, float(spot.periods))
    if half:
        impacts = impacts[: len(impacts) // 2]
    blank = np.zeros(0)
    numbers = (np.asarray(each) for each in (0.0, periods, turn))
    seed = Singular(numbered, which, Cycle(blank, blank, blank, *numbers), np.asarray(1.0))
    if start.kind in RESTS:
        return [_completing(seed, impacts, values, start.kind)]
    if start.kind != "GR":
        closing = 1.0 if start.kind == "SN" else -1.0
        return [_singular(seed._replace(closing=np.asarray(closing)), impacts, values)]
    slack = TOUCH * scene_length(scene)
    still = [k for k, (_, speed, side) in enumerate(impacts) if speed <= slack and not are_releases(side)]
    if not still:
        raise check.ArgumentError("special", "must touch a wall: a GR at which none is", start.spot.value)
    alone = ([one for k, one in enumerate(impacts) if k == touch or k not in still] for touch in still)
    return [_grazing(seed, each, values, slack) for each in alone]


def _singular(seed, impacts, values):
    """(`Singular`, z) with these impacts."""
    cycle = padded(seed, impacts)
    return seed._replace(cycle=cycle), np.concatenate([cycle.times, cycle.speeds, values])


def _completing(seed, impacts, values, kind):
    """(`Completing`, z) with these impacts, at the row whose rest just is one."""
    held, slack = kind == "RL", TOUCH * scene_length(seed.scene)
    cycle = padded(seed, impacts)
    z = np.concatenate([cycle.times, cycle.speeds, values])
    curve = Completing(
        seed.scene, seed.which, cycle, np.zeros(len(cycle.sides)), np.asarray(float(held)), np.asarray(slack)
    )
    curve.pick[np.argmin(abs((resting.presses if held else resting.excesses)(curve, z)))] = 1.0
    return curve, z


def _grazing(seed, impacts, values, slack):
    """(`Grazing`, z) with these impacts, one of them without speed."""
    cycle = padded(seed, impacts)
    pick = np.where(are_impacts(cycle) & (cycle.speeds <= slack), 1.0, 0.0)
    z = np.concatenate([cycle.times, cycle.speeds, values])
    if soft_grazing.is_smooth(seed.scene, cycle.sides[np.argmax(pick)]):
        cycle = cycle._replace(still=pick)
    return Grazing(seed.scene, seed.which, cycle, pick, np.asarray(slack)), z


def _impacts(start):
    """(time, speed, side) of each impact, and of each touch at a GR, in order, the first within the first period."""
    spot = start.spot
    listed = [((k, 0.0), one) for k, one in enumerate(zip(spot.times, spot.speeds, spot.sides, strict=True))]
    if start.kind == "GR":
        for one in start.touches:
            if not one.own:
                begin = spot.times[one.row] if len(spot.times) else 0.0
                listed.append(((one.row, one.late), (begin + one.late, 0.0, one.side)))
    listed = [one for _, one in sorted(listed)]
    period = 2.0 * np.pi / float(start.scene.frequency)
    late = period * np.floor(listed[0][0] / period)
    return [(time - late, speed, side) for time, speed, side in listed]


def is_half(start, names):
    """Whether an orbit is its own mirror image, and stays one whatever the parameters are."""
    impacts = _impacts(start)
    if len(impacts) % 2 or not stays_symmetric(start.scene, *flat(names)):
        return False
    times, speeds, sides = np.array(impacts).T
    whole = start.spot._replace(times=times, speeds=speeds, sides=sides)
    return is_own_image(start.scene, whole)


def impacts_of(curve, zs):
    """(times, speeds, sides, periods) of the whole orbits at points of a curve, (points, n + 1): times and speeds are
    (points, impacts), sides (impacts,); half an orbit is followed by its mirror image."""
    rows, count = len(curve.cycle.sides), int(np.sum(curve.cycle.sides != 0))
    times, speeds, sides = zs[:, :count], zs[:, rows : rows + count], codes(curve.cycle)[:count]
    periods = float(curve.cycle.periods)
    if float(curve.cycle.turn) < 0:
        late = periods * 2.0 * np.pi / _frequencies(curve, zs)
        times, speeds, sides = np.hstack([times, times + late]), np.hstack([speeds] * 2), np.append(sides, -sides)
        periods *= 2
    return times, speeds, sides, int(periods)


def _frequencies(curve, zs):
    """(points, 1), or one number where the frequency is no parameter of the curve."""
    place = int(curve.which.frequency)
    return zs[:, [2 * len(curve.cycle.sides) + place - 1]] if place else float(curve.scene.frequency)


def _settled_at(curve, z, ahead, control):
    """z after Newton's method."""
    found = step(problem(curve), start_point(z, ahead), 0.0, control, curve)
    return found.z if found.met else z
