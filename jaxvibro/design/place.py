"""Bifurcations moved to where they are wanted, by the least change of the scene: `place`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from continuation.limits import EXPIRED, UNLIMITED, limits_of

from ..branches.branch import Special
from ..output.table_text import columns
from ..scene import check
from ..scene.codes import SolutionStatus
from ..scene.scene import Scene
from .free_numbers import room_of, units_of
from .located import located
from .located_point import Located

ROUNDS = 30  # of Newton's steps
APART = 1e-5  # units: the points of a difference
SHORTEST = 1.0 / 256.0  # of the way to the targets: a step as short that fails is the end
FAR = 1.0  # unit and more: the longest of Newton's steps, over 1 + the change
SHARP = 1e-13  # of 1 + the largest: what rounding leaves
Value = Callable[[Scene], Float[jax.Array, ""]]


@dataclass(frozen=True, eq=False)
class Placement:
    """What `place` found. scene: the new one, or, where the targets cannot be met, the last on the way to them; change:
    of each free number; distance: the root of the sum of squares of (change / unit); values: there, of what was to be
    placed; targets; met: whether they are the targets; why: what stands in the way where not, else ""; at_bound: free
    numbers that are at a bound; slope: the largest number left in the condition that the change is the least."""

    scene: Scene = field(repr=False)
    change: dict[str, float]
    distance: float
    values: Float[np.ndarray, " targets"]
    targets: Float[np.ndarray, " targets"]
    met: bool
    why: str
    at_bound: tuple[str, ...]
    slope: float

    def table(self) -> str:
        """The free numbers, before and after, and the values."""
        rows = [("number", "was", "is")]
        for name, change in self.change.items():
            now = float(self.scene.parameter(name))
            rows.append((name, f"{now - change:.9g}", f"{now:.9g}" + (" (bound)" if name in self.at_bound else "")))
        told = [
            f"value {value:.9g}, wanted {target:.9g}" for value, target in zip(self.values, self.targets, strict=True)
        ]
        return "\n".join([columns(rows), *told, *([self.why] if self.why else [])])


class _Asked(NamedTuple):
    """names, units of free numbers; now: their values; low, high: bounds, in units from there; sloped: (places,
    free) -> (values, slopes); virtual: (free,) -> the kinds of the points that are virtual there."""

    names: tuple[str, ...]
    units: Float[np.ndarray, " free"]
    now: Float[np.ndarray, " free"]
    low: Float[np.ndarray, " free"]
    high: Float[np.ndarray, " free"]
    sloped: Callable[
        [Float[np.ndarray, "places free"]],
        tuple[Float[np.ndarray, "places targets"], Float[np.ndarray, "places targets free"]],
    ]
    virtual: Callable[[Float[np.ndarray, " free"]], list[str]]


class _Step(NamedTuple):
    """A point on the way to the targets. share: of the way; change: in units; force: multipliers; held: which free
    numbers are at a bound; slope: what is left of the condition; late: whether the time was over there."""

    share: float
    change: Float[np.ndarray, " free"]
    force: Float[np.ndarray, " targets"]
    held: Bool[np.ndarray, " free"]
    slope: float
    late: bool = False


@check.host("use the function that located gives")
def place(
    what: Special | Value | Sequence[Special | Value],
    name: str | None,
    target: float | Sequence[float],
    free: Mapping[str, float],
    bounds: Mapping[str, Sequence[float]] | None = None,
    scene: Scene | None = None,
    *,
    max_seconds: float | None = None,
) -> Placement:
    """The least change of some numbers of a scene that gives special points the values wanted: a `Placement`.

    what: a `Special`, or a JAX function of a scene (`located`, the difference of two of them, ...), or several. name:
    of the parameter whose value is to be the target, for every `Special`; None takes each one's own. target: a number
    for each. free: {name: unit}, numbers that may change; what is least is the sum of squares of (change / unit).
    bounds: {name: (low, high)} of them, by default their domains. scene: to begin with, by default the first point's.

    The targets are approached on the straight way from the present values, each place on it by Newton's method on the
    condition of Karush, Kuhn and Tucker. Where the way ends before, or an orbit at the targets passes through a wall (a
    virtual orbit), `met` is False, `why` tells what ended it, and the scene, change and values are those of the last
    point on the way whose orbits are all admissible, to 1/256 of the way. max_seconds: wall-clock time, s, after which
    no further place on the way is looked for, which `why` then tells; None is no limit.

    Raises ArgumentError for arguments that cannot be: a free number that is the parameter, one without a unit, more
    targets than free numbers.
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    every = tuple(what) if isinstance(what, list | tuple) else (what,)
    goal = np.atleast_1d(np.asarray(target, float))
    values = [located(one, name) if isinstance(one, Special) else one for one in every]
    first = next((one for one in every if isinstance(one, Special)), None)
    begin = scene if scene is not None else getattr(first, "scene", None)
    if not isinstance(begin, Scene):
        raise check.ArgumentError("scene", "must be a Scene, where no Special is given", scene)
    if not all(callable(each) for each in values):
        raise check.ArgumentError("what", "must be a Special, or a function of a scene", what)
    free = units_of(begin, free)
    own = {each.name for each in values if isinstance(each, Located)}
    for key in own & set(free):
        raise check.ArgumentError(f"free.{key}", "must be none of the parameters that have the target", free[key])
    if goal.shape != (len(values),) or not np.isfinite(goal).all() or len(goal) > len(free):
        rule = f"must be a finite number for each of {len(values)} values, and no more than free numbers, {len(free)}"
        raise check.ArgumentError("target", rule, target)
    asked = _asked(begin, free, bounds or {}, values)
    return _result(begin, asked, goal, *_approached(asked, goal, limits))


def _asked(scene, free, bounds, values):
    names, units = tuple(free), np.array(list(free.values()))
    now = np.array([float(scene.parameter(name)) for name in names])

    def value(change):
        there = scene.replace(**dict(zip(names, jnp.asarray(now) + change * units, strict=True)))
        found = jnp.stack([each(there) for each in values])
        return found, found

    sloped = jax.vmap(jax.jacrev(value, has_aux=True))
    if not all(isinstance(each, Located) for each in values):  # what a special point calls is compiled once for all
        sloped = jax.jit(sloped)

    def both(places):
        slopes, found = jax.device_get(sloped(places))
        return found, slopes

    def virtual(change):
        there = scene.replace(**dict(zip(names, now + change * units, strict=True)))
        points = [each for each in values if isinstance(each, Located)]
        return [each.special.kind for each in points if each.solve(there).status == SolutionStatus.VIRTUAL]

    return _Asked(names, units, now, *room_of(scene, free, bounds), both, virtual)


def _approached(asked, goal, limits=UNLIMITED):
    """(the last admissible `_Step`, which numbers are at a bound there, or stop it, the kinds of points that are
    virtual beyond it). limits: no further place is looked for once their time is over."""
    size = len(asked.names)
    now = last = _Step(0.0, np.zeros(size), np.zeros(len(goal)), np.zeros(size, bool), 0.0)
    begun = asked.sloped(_around(now.change))[0][0]
    if not np.isfinite(begun).all():
        raise check.ArgumentError("scene", "must have the points that are to be placed", begun)

    def ahead(now, share):
        found, stops = _within(asked, now.change, now.force, now.held, begun + share * (goal - begun))
        return None if found is None else _Step(share, *found), stops

    step, virtual = 1.0, asked.virtual(now.change)
    stops, late = now.held, False
    while now.share < 1.0 and step >= SHORTEST and not (late := limits.expired):
        found, stops = ahead(now, min(1.0, now.share + step))
        if found is None:
            step *= 0.5
        else:
            now, step = found, 2.0 * step
            virtual = asked.virtual(now.change)
            last = last if virtual else now
    if not virtual:
        return now._replace(late=late), now.held if now.share == 1.0 or late else stops, virtual
    beyond = now.share
    while beyond - last.share > SHORTEST and not (late := late or limits.expired):
        middle = 0.5 * (last.share + beyond)
        found, _ = ahead(last, middle)
        if found is None or asked.virtual(found.change):
            beyond = middle
        else:
            last = found
    return last._replace(late=late), last.held, virtual


def _within(asked, change, force, held, goal):
    """((change, multipliers, which numbers are at a bound, slope) of the least change with these values, within the
    bounds, None where Newton's method leads to none; which numbers were at a bound last)."""
    for _ in range(2 * len(change) + 1):
        found = _solved(asked, change, force, held, goal)
        if found is None:
            return None, held
        change, force, pull, slope = found
        out = np.where(held, 0.0, np.maximum(change - asked.high, asked.low - change))
        leaves = np.where(change >= asked.high, -pull, pull)
        wrong = np.where(held, leaves, 0.0)  # a bound that holds what would leave it
        if out.max() > SHARP:
            place = int(np.argmax(out))
            held = held | (np.arange(len(held)) == place)
            change = np.clip(change, asked.low, asked.high)
        elif wrong.max() > SHARP * (1.0 + abs(pull).max()):
            held = held & (np.arange(len(held)) != int(np.argmax(wrong)))
        else:
            return (change, force, held, slope), held
    return None, held


def _around(change):
    """Places about one, itself first."""
    steps = APART * np.eye(len(change))
    return np.concatenate([change[None], change + steps, change - steps])


def _solved(asked, change, force, held, goal):
    """(change, multipliers, what pulls each number, the largest of it that is left) by Newton's method; None."""
    size, count, step, loose = len(change), len(goal), np.inf, ~held
    for _ in range(ROUNDS):
        values, slopes = asked.sloped(_around(change))
        if not (np.isfinite(values).all() and np.isfinite(slopes).all()):
            return None
        here, bend = slopes[0], (slopes[1 : size + 1] - slopes[size + 1 :]) / (2.0 * APART)
        curved = np.eye(size) + np.einsum("jci,c->ij", bend, force)
        curved = 0.5 * (curved + curved.T)
        pull, miss = change + force @ here, values[0] - goal
        small = SHARP * (1.0 + abs(change).max())
        if step <= 1e-9 * (1.0 + abs(change).max()):
            return change, force, -pull, float(abs(pull[loose]).max(initial=0.0))
        if loose.sum() < count:
            return None
        table = np.zeros((loose.sum() + count,) * 2)
        block = curved[np.ix_(loose, loose)]
        table[:-count, :-count] = block if np.linalg.eigvalsh(block).min() > small else np.eye(loose.sum())
        table[-count:, :-count], table[:-count, -count:] = here[:, loose], here[:, loose].T
        try:
            move = -np.linalg.solve(table, np.concatenate([change[loose], miss]))
        except np.linalg.LinAlgError:
            return None
        way, new = np.zeros(size), move[-count:]
        way[loose] = move[:-count]
        cut = min(1.0, FAR * (1.0 + np.linalg.norm(change)) / max(np.linalg.norm(way), 1e-300))
        change, force, step = change + cut * way, new, float(np.linalg.norm(way))
    return None


def _result(scene, asked, goal, last, held, virtual):
    change = last.change
    there = scene.replace(**dict(zip(asked.names, asked.now + change * asked.units, strict=True)))
    found = asked.sloped(_around(change))[0][0]
    names = tuple(name for name, each in zip(asked.names, held, strict=True) if each)
    why = _why(last.share, virtual, names, last.late)
    return Placement(
        scene=there,
        change=dict(zip(asked.names, map(float, change * asked.units), strict=True)),
        distance=float(np.linalg.norm(change)),
        values=found,
        targets=goal,
        met=not why,
        why=why,
        at_bound=names,
        slope=last.slope,
    )


def _why(share, virtual, names, late=False):
    """What stands in the way to the targets; "" where they are met. virtual: kinds of points whose orbits pass through
    a wall beyond; names: of numbers at a bound; late: whether the time was over."""
    if share == 1.0:
        return ""
    what = "the point cannot be followed on (it meets another, or the value has an extreme there)"
    if late:
        what = EXPIRED
    elif virtual:
        what = f"beyond, the {virtual[0]}'s orbit passes through a wall"
    elif names:
        what = f"{', '.join(names)} {'are' if len(names) > 1 else 'is'} at a bound"
    return f"the way ends after {share:.3g} of it: {what}"
