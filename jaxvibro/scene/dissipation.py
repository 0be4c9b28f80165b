"""Whether areas of the state space never grow: a proof, by intervals.

In flight an area changes at the rate d force / d v, whatever the drive does; at an impact with a rigid wall by R^2,
standing or moving, and not at all where a soft wall is met. So it is enough that damping is not negative, R not above
1, and d force / d v not positive at any t and v, and any x that the walls allow. The last is what JAX traces of the
derivative, evaluated with intervals (`intervals`), over cells of x and v that are halved where they do not tell. A
force is to be continuous in v, as an area may grow where it jumps; where it jumps in t or x none does.
"""

from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

from . import check
from .force import of_row
from .force_trace import inner_of, traced
from .intervals import ENTIRE, FLAG, JUMPS, RULES, Interval, minus, of, plus, times

MOST = 4096  # lanes, and cells, at once
ROUNDS = 40  # of halving
ONE = of(1.0)
SUMS = {"add": plus, "add_any": plus, "sub": minus}


def never_grow(*scenes):
    """True where it is proved that no area grows, in flight or at an impact, of any scene whose numbers lie between
    those of these, of which each lane differs in one number at the most; else None."""
    if check.is_traced(*jax.tree.leaves(scenes)):
        return None
    passive = all(bool(np.all(np.abs(scene.bounce(side)) <= 1.0)) for scene in scenes for side in scene.walls)
    if not passive:
        return None
    if scenes[0].force is None:
        damped = [name for name in scenes[0].names if name.endswith("damping")]
        return all(bool(np.all(scene.parameter(name) >= 0.0)) for scene in scenes for name in damped) or None
    if scenes[0].soft_sides:
        return None
    return _never_feeds(scenes) or None


def _never_feeds(scenes):
    """Whether d force / d v is proved not to be positive: of all the lanes at once, or else of each."""
    names, dtype = tuple(scenes[0].force.numbers), np.dtype(scenes[0].dtype)
    slope = _slope(scenes[0].force.function, names, dtype)
    lanes = [_between([scene.force.numbers[name] for scene in scenes]) for name in names]
    lanes.append(_between([end for scene in scenes for end in _reach(scene)]))
    shape = np.broadcast_shapes(*(np.shape(each.low) for each in lanes))
    lanes = [Interval(*(np.broadcast_to(end, shape).reshape(-1) for end in each)) for each in lanes]
    if slope is None:
        return False
    together = [Interval(each.low.min()[None], each.high.max()[None]) for each in lanes]
    count = len(lanes[-1].low)
    some = ([Interval(*(end[k : k + MOST] for end in each)) for each in lanes] for k in range(0, count, MOST))
    return _proved(slope, together) or (count > 1 and all(_proved(slope, each) for each in some))


def _between(values):
    """From the least to the largest of some arrays, lane by lane."""
    values = np.stack(np.broadcast_arrays(*(np.asarray(each, float) for each in values)))
    return Interval(values.min(axis=0), values.max(axis=0))


def _reach(scene):
    """(the least, the largest) x that the walls of a scene allow."""
    ends = {"left": -np.inf, "right": np.inf}
    for side, wall in scene.walls.items():
        swing = 0.0 if wall.motion is None else np.abs(np.asarray(wall.motion.amplitude, float))
        where = np.asarray(wall.position, float)
        ends[side] = where if wall.motion is None else np.nextafter(where + np.copysign(swing, ends[side]), ends[side])
    return ends["left"], ends["right"]


def _proved(slope, lanes):
    """Whether d force / d v is nowhere positive; lanes: the intervals of the force's numbers and, the last, of x."""
    none = np.zeros(len(lanes[-1].low))
    cells = [Interval(*(np.tile(end, 2) for end in each)) for each in lanes]
    cells.append(Interval(np.append(none - np.inf, none), np.append(none, none + np.inf)))
    for _ in range(ROUNDS):
        left = ~(_evaluated(slope, cells).high <= 0.0)
        if not left.any():
            return True
        cells = [Interval(low[left], high[left]) for low, high in cells]
        *numbers, x, v = cells
        at = [*numbers, *(of(_middle(each)) for each in (x, v))]
        if 4 * len(x.low) > MOST + 4 * len(none) or (_evaluated(slope, at).low > 0.0).any():
            return False
        cells = _halved(_halved(cells, -1), -2)
    return False


def _halved(cells, place):
    """Cells cut in two along one of their intervals."""
    low, high = cells[place]
    middle = _middle(cells[place])
    found = [Interval(*(np.tile(end, 2) for end in each)) for each in cells]
    found[place] = Interval(np.append(low, middle), np.append(middle, high))
    return found


def _middle(interval):
    """A number within an interval, which may be unbounded."""
    low, high = interval
    with np.errstate(invalid="ignore", over="ignore"):
        far = np.where(low >= 0.0, np.maximum(2.0 * low, 1.0), np.where(high <= 0.0, np.minimum(2.0 * high, -1.0), 0.0))
        return np.where(np.isfinite(low) & np.isfinite(high), 0.5 * low + 0.5 * high, far)


@lru_cache(256)
def _slope(function, names, dtype):
    """The `ClosedJaxpr` of d force / d v, of t, x, v and the numbers; None of a force that may jump where v changes."""
    if not _continuous(traced(function, names, dtype).jaxpr, [False, False, True, *[False] * len(names)])[0]:
        return None
    force = of_row(function, names)

    def slope(t, x, v, *numbers):
        return jax.jvp(lambda v: force(t, x, v, *numbers), (v,), (jnp.ones_like(v),))[1]

    return jax.make_jaxpr(slope)(*[jax.ShapeDtypeStruct((), dtype)] * (3 + len(names)))


def _continuous(jaxpr, moving):
    """(whether what is done to numbers that move with v is known to be continuous, whether each result moves)."""
    known = dict(zip(jaxpr.invars, moving, strict=True))
    sure = True
    for eqn in jaxpr.eqns:
        given = [not isinstance(each, core.Literal) and known.get(each, False) for each in eqn.invars]
        own, results = inner_of(eqn), [any(given)] * len(eqn.outvars)
        if own is not None:
            smooth, results = _continuous(own.jaxpr, given)
        else:
            name = eqn.primitive.name
            chosen = name == "select_n" and not given[0]
            smooth = not any(given) or chosen or _kept(eqn) or (name in RULES and name not in JUMPS)
        sure = sure and smooth
        known.update(zip(eqn.outvars, results, strict=True))
    return sure, [not isinstance(each, core.Literal) and known.get(each, False) for each in jaxpr.outvars]


def _kept(eqn):
    """Whether an operation turns a number into one of the same type."""
    return eqn.primitive.name == "convert_element_type" and eqn.invars[0].aval.dtype == eqn.outvars[0].aval.dtype


def _evaluated(slope, cells):
    """The interval of d force / d v in each cell, of the numbers', x's and v's intervals."""
    *numbers, x, v = cells
    (found,) = _run(slope, [ENTIRE, x, v, *numbers])
    return Interval(*(np.broadcast_to(np.asarray(end, float), np.shape(x.low)) for end in found))


def _run(closed, given):
    """The intervals of what a `ClosedJaxpr` gives."""
    known = dict(zip(closed.jaxpr.invars, given, strict=True))
    known |= {name: _constant(value) for name, value in zip(closed.jaxpr.constvars, closed.consts, strict=True)}
    made: dict[Any, Any] = {}

    def read(variable):
        return _constant(variable.val) if isinstance(variable, core.Literal) else known[variable]

    for eqn in closed.jaxpr.eqns:
        of_its_own = inner_of(eqn)
        if of_its_own is not None:
            results = _run(of_its_own, [read(each) for each in eqn.invars])
        else:
            results = [_result(eqn, made, read)] if len(eqn.outvars) == 1 else [ENTIRE] * len(eqn.outvars)
        known.update(zip(eqn.outvars, results, strict=True))
        made.update(dict.fromkeys(eqn.outvars, eqn))
    return [read(each) for each in closed.jaxpr.outvars]


def _constant(value):
    return of(float(value)) if np.ndim(value) == 0 and np.isfinite(value) else ENTIRE


def _result(eqn, made, read):
    """The interval of what one operation gives: anything where no rule is known."""
    name, (out,) = eqn.primitive.name, eqn.outvars
    whatever = FLAG if out.aval.dtype == bool else ENTIRE
    known = name in RULES and (name != "convert_element_type" or _kept(eqn) or eqn.invars[0].aval.dtype == bool)
    plain = not any(each.aval.shape for each in (*eqn.invars, out)) and not np.issubdtype(out.aval.dtype, np.integer)
    if not known or not plain:
        return whatever
    return _once(eqn, made, read) or RULES[name](*map(read, eqn.invars), **eqn.params)


def _once(eqn, made, read):
    """A square of one number, and a + a b, a - a b as a (1 + b), a (1 - b): what stands there twice is one number. None
    of other operations."""
    name = eqn.primitive.name
    if name not in ("mul", *SUMS) or any(isinstance(each, core.Literal) for each in eqn.invars):
        return None
    first, second = eqn.invars
    if name == "mul":
        return RULES["square"](read(first)) if first is second else None
    for lone, other in ((first, second), (second, first))[: 1 if name == "sub" else 2]:
        product = made.get(other)
        if product is not None and product.primitive.name == "mul" and any(each is lone for each in product.invars):
            rest = product.invars[0 if product.invars[1] is lone else 1]
            return times(read(lone), SUMS[name](ONE, read(rest)))
    return None
