"""Free flight under a force of the user's own by steps of one of diffrax's solvers, loaded where a force asks for it.

A step is as long as its estimated error allows: that of its end, which the solver tells, and that of the polynomial
between. This is the quintic through x, v and the acceleration at both ends; its error is h^6 x^(6) (s (1 - s))^3 / 720
at the place s of a step h, so that it is 1/24 of h^2 times what the acceleration is off in the middle; or less under a
force that damps fast, which holds the error of v, and not of its change, to as much over its rate.
"""

import math
from functools import lru_cache, partial, reduce
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, least, most
from ..scene.force import Force
from . import drive, event, flow
from .taylor_steps import STEADY, Ahead, Press, as_derivatives, local_size, remainder, scale
from .wall import course

TRIES = 60  # of a step: each that fails is shorter than the last
SHORTEST, LONGEST = 0.05, 0.8  # of the last try
SAFETY = 0.9
CONVERGENCE = 1.5  # least order at which error / motion decreases with the step; rounding errors have order 0 or 1
ROUNDINGS = 64.0  # of x; smaller errors are always accepted
SHORTER = 0.3  # of the last step at which the press on a wall was looked at
SMOOTH = 24.0  # of the polynomial's error, see above
EXACT = 4  # the last derivative of x that is taken from the force, by its own derivatives
PLACES = 0.5 * (1.0 - np.cos(np.pi * np.arange(1, event.TERMS + 1) / event.TERMS))  # of a step, Chebyshev's
SHARES = np.linalg.inv(np.vander(PLACES, increasing=True))  # of the values there in a polynomial's coefficients
FROM_ERROR = diffrax.with_stepsize_controller_tols(diffrax.VeryChord)().rtol  # stands for a tolerance


Matrix = Float[jax.Array, "2 2"]


class Cramer(lx.AbstractLinearSolver):
    """Solves the two linear equations of a step by Cramer's rule: what LAPACK does has no place within a kernel."""

    def init(self, operator: lx.AbstractLinearOperator, options: dict[str, Any]) -> Matrix:
        return operator.as_matrix()

    def compute(
        self, state: Matrix, vector: Float[jax.Array, "2"], options: dict[str, Any]
    ) -> tuple[Float[jax.Array, "2"], lx.RESULTS, dict[str, Any]]:
        (a, b), (c, d) = state
        u, w = vector
        solution = jnp.stack([d * u - b * w, a * w - c * u]) / (a * d - b * c)
        return solution, lx.RESULTS.successful, {}

    def transpose(self, state: Matrix, options: dict[str, Any]) -> tuple[Matrix, dict[str, Any]]:
        return state.T, {}

    def conj(self, state: Matrix, options: dict[str, Any]) -> tuple[Matrix, dict[str, Any]]:
        return state, {}

    def assume_full_rank(self) -> bool:
        return True


@lru_cache(64)
def _ready(solver, tolerance):
    """A solver that can be differentiated forward, its equations solved to a tolerance."""
    if getattr(solver, "scan_kind", "") is None:
        solver = eqx.tree_at(lambda one: one.scan_kind, solver, "lax", is_leaf=lambda leaf: leaf is None)
    if isinstance(solver, diffrax.AbstractImplicitSolver):
        for name, value in (("rtol", tolerance), ("atol", tolerance), ("norm", optimistix.max_norm)):
            if getattr(solver.root_finder, name) is FROM_ERROR:
                solver = eqx.tree_at(lambda one, name=name: getattr(one.root_finder, name), solver, value)
        if isinstance(getattr(solver.root_finder, "linear_solver", None), lx.AutoLinearSolver):
            solver = eqx.tree_at(lambda one: one.root_finder.linear_solver, solver, Cramer())
    return solver


class Lane(NamedTuple):
    """Force and drive of one lane or of several; the drive is as in `coefficients.Frame`."""

    law: Force
    frequency: Float[jax.Array, "..."]
    force: Float[jax.Array, "..."]
    terms: tuple[drive.Term, ...]


def _lanes(function, frame, *given):
    """function(lane, *given), of one state, for each lane."""
    own, tree = jax.tree.flatten(Lane(frame.law, frame.frequency, frame.force, frame.terms))
    count, form = len(own), []

    def single(*every):
        leaves, found = jax.tree.flatten(function(tree.unflatten(every[:count]), *every[count:]))
        form[:] = [found]
        return tuple(leaves)  # all that vectorize takes of lanes with axes of one

    leaves = jnp.vectorize(single)(*own, *given)
    return form[0].unflatten(leaves)


def _acceleration(lane, cosine, sine, late, x, v):
    """The acceleration a time after the drive was at this cosine and sine."""
    law, frequency, force, terms = lane
    c, s = flow.rotated(cosine, sine, frequency * late)
    pull = law.function(lax.atan2(sine, cosine) / frequency + late, x, v, law.numbers) + force * c
    return pull + sum(along for along, _, _ in drive.waves(terms, frequency, c, s))


def _step(lane, x, v, cosine, sine, size, time):
    """(x, v after a step, the acceleration there, the estimated error over the size)."""
    solver = _ready(lane.law.solver, lane.law.tolerance)

    def field(late, y, _):
        x, v = size * y[0], size * y[1]
        return jnp.stack([v, _acceleration(lane, cosine, sine, late, x, v)]) / size

    term, start = diffrax.ODETerm(field), jnp.stack([x, v]) / size
    none = jnp.zeros_like(time)
    state = solver.init(term, none, time, start, None)
    end, error, _, _, result = solver.step(term, none, time, start, None, state, made_jump=False)
    right = result == diffrax.RESULTS.successful
    error = jnp.where(right, jnp.max(jnp.abs(error)), jnp.inf)
    x, v = size * end[0], size * end[1]
    return x, v, _acceleration(lane, cosine, sine, time, x, v), error


def ahead(frame, x, v, cosine, sine):
    """The `taylor_steps.Ahead` of lanes, a constant for derivatives."""
    frame, x, v, cosine, sine = lax.stop_gradient((frame, x, v, cosine, sine))
    pull = _pull(frame, x, v, cosine, sine)
    size = scale(frame, x, v, pull)
    return Ahead(*_lanes(_searched, frame, x, v, cosine, sine, pull, size, frame.reach + 0.0 * x))


def _pull(frame, x, v, cosine, sine):
    """The acceleration of lanes."""
    return _lanes(_acceleration, frame, cosine, sine, jnp.zeros_like(x), x, v)


def stiffening(frame, x, v, cosine, sine):
    """How fast the force grows with x."""

    def single(lane, x, v, cosine, sine):
        pull = partial(_acceleration, lane, cosine, sine, jnp.zeros_like(x))
        return jax.jvp(lambda x: pull(x, v), (x,), (jnp.ones_like(x),))[1]

    return _lanes(single, frame, x, v, cosine, sine)


def _searched(lane, x, v, cosine, sine, pull, size, longest):
    """Select the step length of one lane; return (terms, length, remainder), see `taylor_steps.Ahead`.

    The error of an accepted step is at most `tolerance * size`. Steps are shortened further until the error is also at
    most `sqrt(tolerance)` times the motion, so that small motions keep half of the digits. This ends where a shorter
    step does not reduce the error: then rounding dominates, or the residual of an implicit solver's equations.
    """
    law, pull_at = lane.law, partial(_acceleration, lane, cosine, sine)
    power = -1.0 / min(_ready(law.solver, law.tolerance).order(None), 5)
    largest, share = law.tolerance * size, math.sqrt(law.tolerance)
    rounding = ROUNDINGS * float(jnp.finfo(x.dtype).eps) * jnp.abs(x) + event.smallest(x.dtype)

    def attempt(time):
        """Return (terms, error, error / allowed error) of a step."""
        end, speed, last, error = _step(lane, x, v, cosine, sine, size, time)
        terms = quintic(x, v, pull, end, speed, last, time)
        half = 0.5 * time
        there, pace = event.horner(terms, half)
        bend = event.horner([k * term for k, term in enumerate(terms)][1:], half)[1]
        pulled, drag = jax.jvp(partial(pull_at, half, there), (pace,), (jnp.ones_like(pace),))
        between = time * time * jnp.abs(bend - pulled) / (SMOOTH + time * jnp.abs(drag))
        error = jnp.maximum(size * error, between)
        error = jnp.where(jnp.isnan(error), jnp.inf, error)
        own = most(local_size(v, pull, time), most(jnp.abs(end - x), time * jnp.abs(speed)))
        allowed = least(largest, most(share * own, rounding))
        return tuple(terms), error, error / allowed

    def shorter(carry):
        time, terms, error, ratio, count, _ = carry
        next_time = time * jnp.clip(SAFETY * ratio**power, SHORTEST, LONGEST)
        next_terms, next_error, next_ratio = attempt(next_time)
        stalled = (error <= largest) & ~(next_ratio < ratio * (next_time / time) ** CONVERGENCE)
        current, following = (time, terms, error, ratio), (next_time, next_terms, next_error, next_ratio)
        return *jax.tree.map(partial(choose, stalled), current, following), count + 1, stalled

    def goes_on(carry):
        *_, ratio, count, stalled = carry
        return (ratio > 1.0) & (count < TRIES) & ~stalled

    start = (longest, *attempt(longest), jnp.int32(0), jnp.zeros(x.shape, bool))
    time, terms, error, *_ = lax.while_loop(goes_on, shorter, start)
    none, rest = jnp.zeros_like(time), remainder(local_size(v, pull, time), error, size, law.tolerance)
    return [*terms, *[none] * (event.TERMS + 3 - len(terms))], time, rest


def quintic(x, v, pull, end, speed, last, time):
    """The coefficients, from the constant on, of the polynomial with this x, v and acceleration at 0 and at a time."""
    gap = (end - x) - time * (v + 0.5 * time * pull)
    rise = time * ((speed - v) - time * pull)
    bend = time * time * (last - pull)
    cubic, quartic = 10.0 * gap - 4.0 * rise + 0.5 * bend, 7.0 * rise - 15.0 * gap - bend
    return x, v, 0.5 * pull, cubic / time**3, quartic / time**4, (6.0 * gap - 3.0 * rise + 0.5 * bend) / time**5


def gained(frame, x, v, cosine, sine, time, terms=None):
    """(what x gains, what v gains) by a step of the solver."""
    size = lax.stop_gradient(scale(frame, x, v, _pull(frame, x, v, cosine, sine)))

    def single(lane, x, v, cosine, sine, size, time):
        end, speed, _, _ = _step(lane, x, v, cosine, sine, size, time)
        return end - x, speed - v

    return _lanes(single, frame, x, v, cosine, sine, size, time)


def derivatives(frame, x, v, cosine, sine, order):
    """x and its derivatives up to an order: beyond some those of a step's polynomial."""
    count = min(order, EXACT) - 1
    found = [x, v, *_lanes(partial(_rates, count=count), frame, x, v, cosine, sine)]
    if order > EXACT:
        found += as_derivatives(ahead(frame, x, v, cosine, sine).terms)[EXACT + 1 : order + 1]
    return found


def _rates(lane, x, v, cosine, sine, count):
    """The acceleration and its first derivatives along the motion, so many in all."""
    pull = partial(_acceleration, lane, cosine, sine)

    def along(function):
        return lambda late, x, v: jax.jvp(function, (late, x, v), (jnp.ones_like(late), v, pull(late, x, v)))[1]

    found, function = [], pull
    for _ in range(count):
        found.append(function(jnp.zeros_like(x), x, v))
        function = along(function)
    return found


def _press(frame, wall, cosine, sine, late):
    """The press on a wall a time after the drive was at this cosine and sine."""
    where, pace, bend = course(wall, frame.frequency, *flow.rotated(cosine, sine, frame.frequency * late), 2)
    still = jnp.zeros_like(late)
    pace, bend = (still if each is None else each for each in (pace, bend))
    return _lanes(_acceleration, frame, cosine, sine, late, where, pace) - bend


def press_terms(frame, wall, cosine, sine, order):
    """The Taylor coefficients of the press on a wall, see `press`, up to an order."""

    def along(function):
        return lambda late: jax.jvp(function, (late,), (jnp.ones_like(late),))[1]

    found, function = [], partial(_press, frame, wall, cosine, sine)
    for k in range(order + 1):
        found.append(function(jnp.zeros_like(cosine)) * (1.0 / math.factorial(k)))
        function = along(function)
    return found


def pressed(frame, wall, cosine, sine):
    """The `taylor_steps.Press` on a wall, from the press at some times of a step, which is shortened to them."""
    start = _press(frame, wall, cosine, sine, jnp.zeros_like(cosine))

    def terms(reach):
        rows = [(_press(frame, wall, cosine, sine, place * reach) - start) / place for place in PLACES.tolist()]
        found = [start, *(sum(share * row for share, row in zip(shares, rows, strict=True)) for shares in SHARES)]
        found = [lax.convert_element_type(each, reach.dtype) for each in found]
        sizes = [lax.abs(each) for each in found]
        return found, choose(sizes[-1] > STEADY * reduce(most, sizes[:-1]), lax.full_like(start, 1.0), 0.0)

    def shorter(carry):
        reach, _, wrong, count = carry
        reach = choose(wrong > 0, SHORTER * reach, reach)
        return reach, *terms(reach), count + 1

    longest = frame.reach + 0.0 * cosine
    begun = (longest, *terms(longest), jnp.int32(0))
    reach, found, _, _ = lax.while_loop(lambda carry: jnp.any(carry[2] > 0) & (carry[3] < TRIES), shorter, begun)
    own = as_derivatives([term / reach**k for k, term in enumerate(found[: event.TERMS])])
    return Press(own, 2.0 * lax.abs(found[event.TERMS]), reach)


def spaced(frame, reach):
    """How far the polynomials of steps so long are right to 1e-4 of their size."""
    return reach * (1e-4 / frame.law.tolerance) ** (1.0 / 6.0)
