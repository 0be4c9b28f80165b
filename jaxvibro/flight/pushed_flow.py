"""A stay within a soft wall beside a force of the user's own: its end found as surely as an impact, step by step.

The steps are in s (`push_series`): e falls to 0 where the mass leaves, as a clearance does where it meets a wall, and
what `event` says of one holds for the other.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Bool, Float, Int

from ..compiled.compiler_hints import choose, most, positive, stage, two_sum
from . import event, push_series, taylor_steps
from .force_flow import MOST_STEPS
from .push_series import Within, chosen_lanes, onwards

ROUNDS = 60  # of Newton's steps, or halvings, to the time that a stay is followed for
NEAR = 4.0  # roundings: as near is the time
POLISHED = 2  # Newton's steps to the end of a stay, from one that is nearer than `event.landing`
FLOWN = 10  # the last power of steps with derivatives: their cost is what there is to compile, which is less by it
LOST = 1e100  # a root beyond which nothing comes back


class Passage(NamedTuple):
    """Lanes on their way through a stay: where they are, the time they have left and its low part; span: in s, so far;
    leaves: whether they have left the wall; steps taken."""

    now: Within
    left: Float[jax.Array, "*lanes"]
    left_low: Float[jax.Array, "*lanes"]
    span: Float[jax.Array, "*lanes"]
    leaves: Bool[jax.Array, "*lanes"]
    steps: Int[jax.Array, ""]


def passed(frame, side, start, left, left_low=None):
    """The `Passage` of lanes within the wall on a side up to where they leave it, or until so much time is gone.

    Lanes that have no time stay where they are. left is not 0 of a lane that has neither left nor come to its end.
    """
    none = jnp.zeros_like(left)
    low = none if left_low is None else left_low

    def going(passage):
        return jnp.any((passage.left > 0) & ~passage.leaves) & (passage.steps < MOST_STEPS)

    return lax.while_loop(
        going,
        lambda passage: _step(frame, side, passage),
        Passage(start, left, low, none, left != left, jnp.int32(0)),
    )


def _step(frame, side, passage):
    now, left = passage.now, passage.left
    terms = push_series.coefficients(frame, side, now, taylor_steps.order(frame))
    longest = push_series.reach(frame, terms, now.scale)
    nearing = stage(_nearing, terms.root, longest, tolerance=frame.law.tolerance)
    bound = event.bound(nearing, stage(event.cubic, nearing))
    near, guess = stage(event.free_step, bound), stage(event.quadratic, *bound[:3])
    sure = stage(event.sure_step, bound, stage(event.horizon, bound, guess), near)
    root = stage(event.newton, nearing, stage(event.halley, nearing, guess))
    slack = stage(event.slack, nearing, guess, root)
    leaves = stage(_leaves, nearing, root, slack)
    span = stage(_span, terms, longest, sure, root, slack, leaves)
    going = (left > 0) & ~passage.leaves
    time = stage(_time, terms.time, span)
    over = going & (time >= left) & ~(leaves & (time <= left + stage(_tiny, frame.period, left)))
    span = lax.cond(jnp.any(over), _until, _as_it_is, terms.time, span, left, over)
    leaves &= ~over
    root, rate, time = stage(onwards, terms, span)
    root = choose(leaves, 0.0, root)
    cosine, sine = stage(push_series.turned, frame, now, time)
    new = now._replace(root=root, rate=rate, cosine=cosine, sine=sine)
    rest, low = two_sum(left, -time)
    rest, low = two_sum(rest, low + passage.left_low)
    rest = choose(over, 0.0, positive(rest))
    low = choose(rest > 0, low, 0.0)
    lost = ~(lax.abs(root) < LOST)
    after = new, choose(lost, jnp.nan, rest), low, passage.span + span, leaves
    kept = now, left, passage.left_low, passage.span, passage.leaves
    return Passage(*chosen_lanes(going, after, kept), passage.steps + 1)


def _tiny(period, like):
    return NEAR * event.rounding(like.dtype) * period


def _nearing(root, longest, tolerance):
    """The `event.Progress` of minus the root, in longest steps; where the stay begins its root at 0 is divided out."""
    power, terms, rest, size = lax.full_like(longest, 1.0), [], lax.full_like(longest, 0.0), None
    for k, each in enumerate(root):
        term = each * power
        if k < event.TERMS:
            terms.append(-term)
        else:
            rest = rest + (k / event.TERMS) * lax.abs(term)
        size = lax.abs(term) if size is None else most(size, lax.abs(term)) if k < 3 else size
        power = power * longest
    return event.progress(terms, rest + 2.0 * tolerance * size, root[0] == 0)


def _leaves(nearing, root, slack):
    """Whether the root is where the stay ends, and near enough."""
    g = nearing.terms
    return (slack >= 0) & (slack * (lax.abs(g[2]) + g[1]) < event.landing(root.dtype) * g[1])


def _span(terms, longest, sure, root, slack, leaves):
    """How long the step is, in s: to the end of the stay, polished, or as far as there surely is none."""
    end = root * longest
    for _ in range(POLISHED):
        value, slope, _ = onwards(terms, end)
        end = end - choose(leaves, value / slope, 0.0)
    return choose(leaves, end, most(sure, choose(slack >= 0, root - slack, 0.0)) * longest)


def _time(terms, span):
    return onwards([terms], span)[0]


def _as_it_is(terms, span, left, over):
    return span


def _until(terms, span, left, over):
    """The span after which the time left is gone, in lanes that go beyond it: the time rises all the way."""
    speeds = [k * term for k, term in enumerate(terms)][1:]

    def going(carry):
        _, _, _, change, count = carry
        return jnp.any(change) & (count < ROUNDS)

    def nearer(carry):
        low, high, at, _, count = carry
        value, slope = onwards([terms, speeds], at)
        beyond = value > left
        low, high = choose(beyond, low, at), choose(beyond, at, high)
        new = at - (value - left) / slope
        new = choose((new > low) & (new < high), new, 0.5 * (low + high))
        change = over & (lax.abs(new - at) > NEAR * event.rounding(at.dtype) * at)
        return low, high, new, change, count + 1

    none = lax.full_like(span, 0.0)
    at = lax.while_loop(going, nearer, (none, span, span, over, jnp.int32(0)))[2]
    return choose(over, at, span)


def fly(frame, side, start, span):
    """(`Within`, the time that is gone) a span of s after a start, with derivatives, forward; no end is looked for."""
    none = jnp.zeros_like(span)

    def going(carry):
        return jnp.any(carry[2] > 0) & (carry[3] < MOST_STEPS)

    def step(carry):
        now, gone, left, count = carry
        terms = push_series.coefficients(frame, side, now, FLOWN)
        reach = push_series.reach(*lax.stop_gradient((frame, terms, now.scale)))
        last = left <= reach
        length = choose(last, left, reach)
        root, rate, time = onwards(terms, length)
        cosine, sine = push_series.turned(frame, now, time)
        new = now._replace(root=root, rate=rate, cosine=cosine, sine=sine), gone + time
        new = chosen_lanes(left > 0, new, (now, gone))
        return *new, choose(last, 0.0, positive(left - length)), count + 1

    start = jax.tree.map(lambda each: each + none, start)
    now, gone, _, _ = lax.while_loop(going, step, (start, none, span, jnp.int32(0)))
    return now, gone
