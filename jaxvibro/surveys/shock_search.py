"""The least of very many shocks that leads to another attractor: discs that shrink to the least one found.

Which starts leave is a set whose edge may be fractal, and no slope leads to its nearest point. So a disc about the
attractor's points is tried evenly, and shrinks to the least shock that leaves; where none does, it is tried more
densely, and, as starts take the longer the nearer to an edge they are, closely about those that took longest. About
each least one windows of all sizes are tried, down to rounding, and at the end its own ray.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
import scipy
from jaxtyping import Float

from continuation.limits import UNLIMITED, Limits

from ..attractors.assign import OUTSIDE, UNRESOLVED, Home, assign_labels
from ..attractors.trapping_region import Cloud, Trap
from ..flight.wall_positions import places
from ..scene.scene import SIDES, Scene

GOLDEN = 0.6180339887498949, (0.7548776662466927, 0.5698402909980532)  # steps of even sequences in one and two numbers
FIRST, MORE = 1 << 12, 4  # shocks of the first disc; times as many in one that is tried again
GAIN = 1e-5  # of the size: by less a disc has not shrunk
LONGEST, AROUND, DEEPER = 64, 128, 5  # starts that took longest, shocks tried about each, windows a quarter as wide
LOCAL, AGAIN = 1024, 3  # shocks of a window about the least one; windows of one size at most
RAY = 256  # shocks tried along a ray
TWICE = 2.0  # times the least shock: so far its direction is tried


class Ground(NamedTuple):
    """Where shocks are tried: a single scene at a phase of the drive (rad), the `Home` of each of its attractors, the
    place of the one that is to be left; plane: whether positions change too; patience: drive periods of a start."""

    scene: Scene
    phase: float
    homes: list[Home]
    place: int
    plane: bool
    patience: int


class Found(NamedTuple):
    """What came of one phase. size: of the least shock that leaves, inf where none does; change: (dx, dv); before: (x,
    v); to: the attractor's place; bracket: (one that stays, the least that leaves) on its ray; until: up to here all
    tried on the ray leave; safe: none smaller leaves, as a trap holds them all; below: smaller ones that were tried;
    undecided: how many of them are certain to be on no attractor; least_undecided: the least of all such, else inf;
    complete: whether the search came to its end."""

    size: float
    change: Float[np.ndarray, "2"]
    before: Float[np.ndarray, "2"]
    to: int
    bracket: tuple[float, float]
    until: float
    safe: float
    below: int
    undecided: int
    least_undecided: float
    complete: bool


def search(
    ground: Ground,
    reach: float,
    shocks: int,
    seed: int,
    count: Callable[[int], object],
    limits: Limits = UNLIMITED,
) -> Found:
    """The least shock at one phase: no longer than `reach`, looked for until so many in a disc find none smaller.

    count: called with the number of shocks of each call. limits: once the time is over the least shock so far is given.
    """
    trial = _Trial(ground, reach, np.random.default_rng(seed), count, limits)
    number = min(FIRST, shocks)
    while True:
        before = trial.size
        trial.disc(number)
        if trial.is_over():
            break
        if trial.size > (1.0 - GAIN) * before:
            trial.linger(number)
        if trial.size < before:
            trial.closer()
        if trial.size <= trial.least:
            break
        if trial.size > (1.0 - GAIN) * before:
            if number == shocks:
                break
            number = min(MORE * number, shocks)
    return trial.found(trial.ray())


def unsearched(ground: Ground) -> Found:
    """What is known of a phase at which no shock has been tried."""
    none, trap = np.full(2, np.nan), ground.homes[ground.place].trap
    held = 0.0 if trap is None else safe(trap, ground.plane)
    return Found(np.nan, none, none, -1, (np.nan, np.nan), np.nan, held, 0, 0, np.inf, False)


class _Trial:
    """The least shock so far, of sizes below `size`, and all that was tried."""

    def __init__(self, ground, reach, rng, count, limits):
        self.ground, self.rng, self.count, self.limits, self.complete = ground, rng, count, limits, True
        self.points = between(ground.scene, ground.phase, base(ground.homes[ground.place]))
        self.tree = scipy.spatial.cKDTree(self.points)
        self.least = np.finfo(ground.scene.dtype).eps * abs(self.points).max()  # smaller ones are lost in rounding
        self.size, self.start, self.change, self.to = reach, -1, np.full(2, np.nan), -1
        self.sizes, self.lost = [], []
        self.last, self.drawn = None, 0

    def is_over(self):
        """Return True if the time is over; what is found is then not complete."""
        self.complete = self.complete and not self.limits.expired
        return not self.complete

    def look(self, start, change):
        """Tries shocks (lanes, 2) of the points at these places and keeps the least that leaves: (labels, sizes)."""
        z = self.points[start] + change
        if self.ground.plane and len(self.points) > 1:
            start = self.tree.query(z)[1]
            change = z - self.points[start]
        size = np.hypot(*change.T)
        kept = size < self.size
        if not kept.any():
            return np.empty(0, np.int32), np.empty(0)
        start, change, size, z = start[kept], change[kept], size[kept], z[kept]
        scene, phase, homes, place, _, patience = self.ground
        label, seen = assign_labels(scene, *z.T, phase, homes, patience)
        self.count(len(z))
        self.sizes.append(size[label != OUTSIDE])
        self.lost.append(size[label == UNRESOLVED])
        leaves = (label >= 0) & (label != place)
        if leaves.any():
            least = np.where(leaves, size, np.inf).argmin()
            self.size, self.start, self.to = float(size[least]), int(start[least]), int(label[least])
            self.change = change[least]
        stays = (label == place) & (size < self.size)
        self.last = start[stays], change[stays], seen[stays]
        return label, size

    def disc(self, number):
        """Tries so many shocks, evenly over the sizes below the least one."""
        start = self.rng.integers(len(self.points), size=number)
        steps = self.drawn + np.arange(1, number + 1)
        self.drawn += number
        self.look(start, self.size * self._even(steps))

    def _even(self, steps):
        """Even shocks (lanes, 2) of sizes below 1."""
        if not self.ground.plane:
            return np.stack([np.zeros(len(steps)), 2.0 * (GOLDEN[0] * steps % 1.0) - 1.0], -1)
        radius, turn = np.sqrt(GOLDEN[1][0] * steps % 1.0), 2.0 * np.pi * (GOLDEN[1][1] * steps % 1.0)
        return radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], -1)

    def linger(self, number):
        """Tries windows about those shocks of the last disc that took longest, ever smaller ones."""
        width = self.size * (np.sqrt(np.pi / number) if self.ground.plane else 2.0 / number)
        for _ in range(DEEPER):
            start, change, seen = self.last
            order = self.rng.permutation(len(seen))
            chosen = order[np.argsort(-seen[order], kind="stable")[:LONGEST]]
            if not chosen.size or self.is_over():
                return
            chosen = np.repeat(chosen, AROUND)
            self._window(start[chosen], change[chosen], width)
            width /= 4.0

    def closer(self):
        """Tries windows about the least shock, ever smaller ones, and goes along with it."""
        width, again = 0.5, 0
        while width > np.finfo(self.ground.scene.dtype).eps ** 0.5 and not self.is_over():
            before = self.size
            self._window(np.full(LOCAL, self.start), np.tile(self.change, (LOCAL, 1)), width * before)
            again = again + 1 if self.size < before else AGAIN
            if again >= AGAIN:
                width, again = width / 4.0, 0

    def _window(self, start, change, width):
        """Tries shocks no further than a width from these (lanes, 2), one each; of a sample's near points too."""
        if len(self.points) > 1:
            near, start = self.points[start] + width * self._random(len(start), True), start
            apart, other = self.tree.query(near)
            start = np.where(apart <= width, other, start)
        self.look(start, change + width * self._random(len(start), self.ground.plane))

    def _random(self, number, plane):
        turn, radius = 2.0 * np.pi * self.rng.random(number), np.sqrt(self.rng.random(number))
        if not plane:
            return np.stack([np.zeros(number), 2.0 * self.rng.random(number) - 1.0], -1)
        return radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], -1)

    def ray(self):
        """(bracket, until) of the least shock in its direction."""
        if self.to < 0:
            return (self.size, np.inf), np.inf
        if self.size <= self.least:
            return (0.0, self.size), self.size
        low, eps = 0.0, np.finfo(self.ground.scene.dtype).eps
        shares = np.arange(1, RAY) / RAY
        while self.size - low > eps**0.5 * self.size and not self.is_over():
            high, start, way = self.size, self.start, self.change / self.size
            sizes = low + shares * (high - low)
            self.look(np.full(len(sizes), start), sizes[:, None] * way)
            low = max(low, *sizes[sizes < self.size].tolist())
        return (low, self.size), self._until()

    def _until(self):
        scene, phase, homes, place, _, patience = self.ground
        sizes = self.size * (1.0 + (TWICE - 1.0) * np.geomspace(1e-6, 1.0, RAY))
        z = self.points[self.start] + sizes[:, None] * (self.change / self.size)
        label, _ = assign_labels(scene, *z.T, phase, homes, patience)
        stays = np.flatnonzero((label < 0) | (label == place))
        return float(np.append(self.size, sizes)[stays[0] if stays.size else -1])

    def found(self, ray):
        """The `Found` of the least shock."""
        (bracket, until), reached = ray, self.to >= 0
        sizes, lost = np.concatenate(self.sizes), np.concatenate(self.lost)
        home = self.ground.homes[self.ground.place]
        return Found(
            size=self.size if reached else np.inf,
            change=self.change,
            before=self.points[self.start] if reached else np.full(2, np.nan),
            to=self.to,
            bracket=bracket,
            until=until,
            safe=safe(home.trap, self.ground.plane),
            below=int((sizes < self.size).sum()),
            undecided=int((lost < self.size).sum()),
            least_undecided=float(lost.min(initial=np.inf)),
            complete=self.complete,
        )


def base(home: Home) -> Float[np.ndarray, "points 2"]:
    """The points of an attractor that shocks are tried from: of a chaotic one all of its sample."""
    return np.asarray(home.trap.tree.data if isinstance(home.trap, Cloud) else home.points)


def between(scene, phase, points):
    """Points (lanes, 2), those that rounding puts beyond a rigid wall on it."""
    for sign, side, (place, _) in zip((1.0, -1.0), SIDES, jax.device_get(places(scene, phase)), strict=True):
        wall = getattr(scene, side)
        if wall is not None and not wall.soft:
            x = sign * np.maximum(sign * points[:, 0], sign * place)
            points = np.stack([x, points[:, 1]], -1)
    return points


def safe(trap: Trap | Cloud, plane: bool) -> float:
    """How large a shock can be that is sure to leave an attractor's trap of ellipses in no direction; 0 of a cloud."""
    if isinstance(trap, Cloud):
        return 0.0
    grips = [np.linalg.norm(length, 2) if plane else np.hypot(*length[:, 1]) for length in trap.lengths]
    return float(1.0 / max(grips))
