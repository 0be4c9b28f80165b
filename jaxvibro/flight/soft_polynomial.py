"""Motion within a soft wall over a step no longer than the longest, as a polynomial in the time over that step.

Its coefficients are arrays, powers first: a dozen operations in place of a Horner scheme for each part of the flow, for
what is evaluated few lanes at a time or differentiated.
"""

import jax
import jax.numpy as jnp
from jax import lax

from ..compiled.compiler_hints import choose
from . import flow, soft_contact

DEGREE = flow.ORDER
POWERS = tuple(range(DEGREE + 1))


def table(frame, touch):
    """What each part of the motion adds to the polynomial of each lane, (DEGREE + 1, *lanes) each: y, the flow's
    `Series`, and those of the `soft_contact.forces`; frame: as the lanes feel it."""
    soft = [each for each in frame.contacts if each is not None]
    moving = soft_contact.moves(frame)
    tables = [_rows(each, moving, touch.ndim) for each in soft]
    found = tables[0] if len(tables) == 1 else [jnp.where(touch < 0, *each) for each in zip(*tables, strict=True)]
    scales = powers(lax.stop_gradient(frame.reach))
    return [each * scales for each in found]


def _rows(soft, moving, lanes):
    """The same of one wall in powers of the time itself, for lanes of so many axes."""
    still = [soft.series.stay, soft.series.move, soft.series.lift, soft.series.lag]
    more = [jnp.zeros_like(each) for each in still[2:]] if soft.waves is None else [soft.waves.lift, soft.waves.lag]
    terms = [rows for term in soft.terms for rows in (term.lift, term.lag)]
    parts = [jnp.ones_like(still[0][:1]), *still, *terms, *(more if moving else [])]
    firsts = (0, 2, 1, *(2, 3) * (len(parts) // 2 - 1))
    rows = []
    for part, first in zip(parts, firsts, strict=True):
        around = [(first, DEGREE + 1 - first - len(part))] + [(0, 0)] * (part.ndim - 1)
        rows.append(jnp.pad(part, around))
    return [each.reshape(*each.shape, *[1] * (lanes + 1 - each.ndim)) for each in rows]


def coefficients(frame, touch, table, y, v, cosine, sine):
    """The polynomial's, (DEGREE + 1, *lanes), from y and y' on."""
    place, _ = soft_contact.rested(frame, touch, cosine, 1.0, 0.0 * cosine)
    parts = [y, y + place, v, frame.force * cosine, -(frame.force * sine)]
    for along, across, _ in soft_contact.forces(frame, touch, cosine, sine):
        parts += [along, -across]
    return sum(part * row for part, row in zip(parts, table, strict=True))


def powers(share):
    """1, s, s^2, ..., s^DEGREE, first axis."""
    found, factor = jnp.stack([jnp.ones_like(share), share]), share * share
    while len(found) <= DEGREE:
        found, factor = jnp.concatenate([found, found * factor]), factor * factor
    return found[: DEGREE + 1]


def total(terms, axis=0):
    """The sum along an axis, as the last of running sums: of many lanes the emitter of a whole loop as one kernel
    has no other over an axis that is not theirs."""
    return lax.index_in_dim(lax.cumsum(terms, axis), -1, axis, keepdims=False)


def value(coefficients, powers):
    """Of a polynomial where s has these powers."""
    return total(coefficients * powers[: len(coefficients)])


def slope(coefficients):
    """The coefficients of its derivative by s."""
    order = jnp.asarray(POWERS[1 : len(coefficients)], coefficients.dtype)
    return coefficients[1:] * order.reshape(-1, *[1] * (coefficients.ndim - 1))


def response(frame, touch, table, time):
    """The `soft_contact.StayResponse` of each lane over any time, a constant, by steps that are doubled."""
    reach = lax.stop_gradient(frame.reach)
    count = jnp.maximum(jnp.ceil(jnp.log2(lax.stop_gradient(time) / reach)), 0.0)
    step = time * jnp.exp2(-count)
    places = powers(step / reach)
    _, stay, move, lift, lag, *more = (value(row, places) for row in table)
    free = 1.0 + stay, move, 1.0 + stay - 2.0 * frame.damping * move
    rates = [rate for *_, rate in soft_contact.forces(frame, touch, 0.0 * time, 0.0 * time)]
    waves = [(lift, lag, frame.frequency + 0.0 * time)]
    waves += zip(more[::2], more[1::2], rates, strict=True)
    forced = [(((u, move - rate * w), (w, rate * u)), _turn(rate * step)) for u, w, rate in waves]

    def double(carry):
        left, *now = carry
        free, *forced = now
        new = [flow.twice(frame.stiffness, free, *each) for each in forced]
        new = [new[0][0], *(each[1:] for each in new)]
        return left - 1.0, *jax.tree.map(lambda new, old: choose(left > 0, new, old), new, now)

    start = (count, free, *forced)
    _, free, *forced = lax.while_loop(lambda carry: jnp.any(carry[0] > 0), double, start)
    return soft_contact.StayResponse(free, forced[0][0], tuple(each for each, _ in forced[1:]))


def _turn(angle):
    """(cos - 1, sin) of an angle."""
    half = jnp.sin(0.5 * angle)
    return -2.0 * half * half, jnp.sin(angle)
