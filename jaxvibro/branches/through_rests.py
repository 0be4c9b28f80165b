"""Past a CH or RL, from orbits that rest to those that do not, or rest otherwise, and back.

Both kinds are told apart by the hops before a release, of which there are ever more towards a CH. What is on the other
side is found from the point by the motion itself: next to it orbits forget their past, so that a flight from the orbit
there settles on that which goes on. Where the hops next to the CH would be lost in rounding a little is left out.
"""

import numpy as np

from continuation.event_search import tangent
from continuation.limits import UNLIMITED
from continuation.points import start_point

from ..flight.wall_positions import fit
from ..orbits.find import find_orbit
from ..orbits.orbit import OrbitError
from ..problem import resting
from ..problem.diagnostics import diagnose
from ..problem.equations import problem, there
from ..problem.grazing import GrazingExit, padded
from ..problem.orbit_start import bring_to, point_of
from ..problem.touches import admissible, scales
from ..scene.state import State

ASIDE = 1e-7, 1e-6, 1e-5, 1e-4, 1e-3  # of 1 + abs of the parameter: so far from the point another orbit is looked for
NEAR = 0.05  # of the largest x and v at the section: as near is the orbit that goes on
SETTLE = 60  # drive periods
SHORT = 0.05  # `releases.Tails.plain`: less, and the first of the last hops is about to be too long for a series
SLOW = 1e-6  # of the scene's length per t: below, the flights between impacts are lost in rounding


def is_chatter(along, z, length, touches=(), slow=SLOW):
    """Whether an impact, but for some `Touch`es, is so slow that many more will be, before the mass comes to rest."""
    own = [touch.row for touch in touches if touch.own]
    speeds = z[len(along.cycle.sides) :][np.setdiff1d(along.hits, own)]
    return bool(((speeds > 0) & (speeds < slow * length)).any())


def exits(along, z, sign, length, limits=UNLIMITED):
    """The `GrazingExit`s of a CH or RL, in a list: the orbits on the other side, towards greater values of the
    parameter where sign is 1. None where the time is over before they are known."""
    lifted = resting.lifted(along, z, length)
    if lifted is not None:
        return [_towards(lifted, z, sign, length)]
    for aside in ASIDE:
        if limits.expired:
            return None
        found = _settled(along, z, z[-1] + sign * aside * (1.0 + abs(z[-1])))
        if found is not None and not is_chatter(*found, length):
            return [_towards(*found, sign, length)]
    return []


def cut_anew(along, z, sign, length):
    """The `GrazingExit` of the same orbit with other hops as rows, None where its own are as good; sign: as of
    `exits`."""
    if along.cycle.releases is None or diagnose(along, z[None]).plain.min() > SHORT:
        return None
    found = _settled(along, z, z[-1])
    return None if found is None else _towards(*found, sign, length)


def _towards(along, z, sign, length):
    """The `GrazingExit` from a point that is none itself, towards greater values where sign is 1."""
    ahead = tangent(problem(along), z, scales(along, length), along)
    return _way(along, z, sign * np.sign(ahead[-1]) * ahead, z)


def completed(along, z, sign, length, limits=UNLIMITED):
    """(the `GrazingExit` from the CH near a grazing on, the largest error left at the CH) where the orbits that rest
    are on one of its sides; None where none are found, or the time is over. sign: of the way that the branch came
    by."""
    for aside in ASIDE:
        for way in (sign, -sign):
            if limits.expired:
                return None
            value = z[-1] + way * aside * (1.0 + abs(z[-1]))
            found = _settled(along, z, value)
            if found is None or _rests(found[0]) <= _rests(along):
                continue
            new, near = found
            point = _nearest(new, near, z[-1], value)
            if point is not None:
                ahead = tangent(problem(new), point.z, scales(new, length), new)
                towards = np.sign(near[-1] - point.z[-1]) * np.sign(ahead[-1])
                return _way(new, point.z, towards * ahead, near), point.residual
    return None


def _rests(along):
    """How many there are."""
    return 0 if along.cycle.releases is None else np.count_nonzero(along.cycle.releases)


def _nearest(along, z, value, own):
    """The CH of one of the rests of an orbit, about as far from a value as the orbit itself."""
    rows = np.flatnonzero(np.isfinite(diagnose(along, z[None]).rest[0]))
    found = [resting.located(along, z, int(row), resting.excesses) for row in rows]
    found = [one for one in found if one.z is not None and abs(one.z[-1] - value) <= 2.0 * abs(own - value)]
    return min(found, key=lambda one: abs(one.z[-1] - own), default=None)


def _way(along, z, ahead, near):
    return GrazingExit(along, start_point(z, ahead), near, diagnose(along, near[None]), ())


def _settled(along, z, value):
    """(along, z) of the orbit that a motion from the orbit of z settles on at a value, None where that is another."""
    scene = there(along, np.append(z[:-1], value))
    look, periods = diagnose(along, z[None]), int(along.cycle.periods)
    state = fit(scene, State(float(look.x[0, 0]), float(look.v[0, 0])))
    try:
        orbit = find_orbit(scene, State(float(state.x), float(state.v)), periods=periods, settle=SETTLE)
        spot = point_of(orbit, value)
    except (OrbitError, ValueError):
        return None
    if orbit.periods != periods or not len(spot.times):
        return None
    new = along._replace(cycle=padded(along, list(zip(spot.times, spot.speeds, spot.sides, strict=True))))
    found = bring_to(new, np.concatenate([new.cycle.times, new.cycle.speeds, [value]]), value)
    there_is = diagnose(new, found.z[None])
    size = NEAR * max(abs(look.x).max(), abs(look.v).max())
    apart = max(abs(there_is.x - look.x).max(), abs(there_is.v - look.v).max())
    return (new, found.z) if found.met and admissible(new, found.z, there_is)[0] and apart < size else None
