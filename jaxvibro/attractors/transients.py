"""Starts are run on until they recur, or until patience ends; those on one periodic orbit are put together."""

from dataclasses import dataclass, field

import jax
import numpy as np
from jaxtyping import ArrayLike, Float

from continuation.limits import UNLIMITED

from ..maps import itinerary
from ..maps.iterate import KEEP, Trail, iterate
from ..scene.codes import Status
from .recurrence import returns, settled_periods

PATIENCE = 16  # times `settle` periods after which a start that has not recurred is given up
MORE = 4  # times that, as long as others still settle: what is left may be on the way as well


@dataclass
class Cluster:
    """Lanes on one periodic orbit: its points on Sigma, shape (periods, 2), and its itinerary."""

    points: Float[np.ndarray, "periods 2"]
    words: tuple[str, ...]
    lanes: list[int] = field(default_factory=list)

    def holds(self, points: Float[np.ndarray, "states 2"], words: tuple[str, ...], near: Float[ArrayLike, ""]) -> bool:
        """Whether these points are the orbit's, begun anywhere along it."""
        if len(points) != len(self.points) or not itinerary.same(words, self.words):
            return False
        return is_turned(points, self.points, near)


def is_turned(points, others, near):
    """Whether points of an orbit (periods, 2) are others, begun anywhere along it."""
    return any(abs(np.roll(others, k, axis=0) - points).max() <= near for k in range(len(points)))


def settle_lanes(scene, state, settle, reach, limits=UNLIMITED):
    """(trail, periods, scale): the lanes' ends, the period each has settled on (0: none), the largest of x and v.

    A lane is run for `settle` periods, then on in ever longer rounds until it has settled, at most PATIENCE times as
    long altogether, and MORE times that while lanes settle in each round: chaos may be a transient. reach: the largest
    x there may be. limits: no further round is begun once their time is over.
    """
    passed, length = max(settle, KEEP), KEEP
    patience, settles = PATIENCE * passed, False
    found = iterate(scene, state, passed, few=0)
    well = found.status < Status.CAP
    scale = max([reach, *abs(found.v[:, well]).ravel()])
    periods = np.zeros(len(well), int)
    before = returns(found.points)
    while (going := np.flatnonzero(well & (periods == 0))).size and passed < patience * (MORE if settles else 1):
        if limits.expired:
            break
        later = iterate(scene, jax.tree.map(lambda leaf, going=going: leaf[going], found.state), length, few=0)
        now = returns(later.points)
        periods[going] = settled_periods(now, before[:, going], length, scale, scene.dtype)
        before[:, going], settles = now, bool(periods[going].any())
        found = _put(found, going, later)
        well = found.status < Status.CAP
        passed, length = passed + length, 2 * length
    return found, np.where(well, periods, 0), scale


def _put(found, lanes, later):
    """The trail with a later one in place of some lanes'."""
    state = jax.tree.map(lambda old, new: _replaced(old, lanes, new), found.state, later.state)
    status = _replaced(found.status, lanes, later.status)
    kept = (_replaced(old, (slice(None), lanes), new) for old, new in zip(found[2:], later[2:], strict=True))
    return Trail(state, status, *kept)


def _replaced(old, lanes, new):
    whole = np.array(old)
    whole[lanes] = new
    return whole


def orbit_of(found, lane, periods):
    """(points, words) of the last periods of a lane."""
    return found.points[-periods:, lane], itinerary.words(found.side[-periods:, lane])


def clusters(found, periods, near):
    """The periodic orbits that lanes have settled on, in order of the first lane; near: the distance that tells two."""
    known = []
    for lane in np.flatnonzero(periods):
        points, words = orbit_of(found, lane, periods[lane])
        home = next((one for one in known if one.holds(points, words, near)), None)
        if home is None:
            home = Cluster(points, words)
            known.append(home)
        home.lanes.append(int(lane))
    return known
