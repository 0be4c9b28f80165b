"""Derivatives of what a replay makes again, by chosen numbers of scene and state."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..flight.coefficients import frame
from ..scene.codes import Contact, Status
from .replay import KnownImpacts, replay


class Known(NamedTuple):
    """What the replays of a strobe have to know: of its end, with the impacts since the last release; of its impacts,
    with the first ones; slowest: the place of the slowest among these, -1: none."""

    of_state: KnownImpacts
    of_impacts: KnownImpacts
    slowest: Float[jax.Array, "*lanes"]


def known_impacts(end, impacts, past):
    """The `Known` of a strobe, slots last: where the mass ended, its impacts, its `one_period.Past`.

    The end of a mass that rests is that of its wall, whatever came before.
    """
    rests = jnp.where(abs(end.contact) >= Contact.STUCK, end.contact, 0.0)
    none, still = impacts.status >= Status.CAP, abs(rests) == Contact.STUCK
    later = jnp.where(past.count > past.times.shape[-1], -1.0, past.count)
    later = jnp.where(none, -1.0, jnp.where(still, 0.0, later))
    first = jnp.where(none, -1.0, impacts.count)
    sides = impacts.side.astype(impacts.time.dtype)
    of_state = KnownImpacts(past.times, past.sides, later, past.freed, rests)
    return Known(of_state, KnownImpacts(impacts.time, sides, first, past.freed, rests, past.before), _slowest(impacts))


def slots_first(known):
    """`KnownImpacts` with slots first in place of last."""
    rows = {name: getattr(known, name) for name in ("times", "sides", "before")}
    return known._replace(**{name: None if row is None else jnp.moveaxis(row, -1, 0) for name, row in rows.items()})


def _slowest(impacts):
    """The place of the slowest impact, -1 where it is not among those recorded, or has no speed."""
    if not impacts.speed.shape[-1]:
        return jnp.full_like(impacts.least_speed, -1.0)
    speeds = jnp.where(impacts.side != 0, impacts.speed, jnp.inf)
    known = jnp.isfinite(impacts.least_speed) & (jnp.min(speeds, axis=-1) == impacts.least_speed)
    return jnp.where(known, jnp.argmin(speeds, axis=-1), -1.0)


def cut(impacts, slots):
    """The impacts with so many slots, of more."""
    full = (impacts.status == Status.OK) & (impacts.count > slots)
    rows = {name: getattr(impacts, name)[..., :slots] for name in ("time", "side", "speed")}
    status = jnp.where(full, Status.FULL, impacts.status).astype(impacts.status.dtype)
    return replace(impacts, status=status, **rows)


def replayed_slopes(leaves, known, tree, chosen, periods, order, of_state):
    """The derivatives of orders 1, 2, ... by the chosen ones of the tree's leaves, an axis for each choice, last.

    Of x and v at the end, or of the impacts' times and speeds, lanes first; nan where a replay is not possible. known:
    slots first.
    """

    def function(*numbers):
        full = list(leaves)
        for place, number in zip(chosen, numbers, strict=True):
            full[place] = number
        scene, state = tree.unflatten(full)
        end, times, speeds = replay(frame(scene), state, known, periods, order)
        return end if of_state else (times, speeds)

    slopes = towered(function, order)(*(leaves[place] for place in chosen))[1:]
    lanes = known.count.ndim

    def told(part):
        part = part if of_state else jnp.moveaxis(part, 0, lanes)
        lost = jnp.reshape(known.count < 0, (*known.count.shape, *[1] * (part.ndim - lanes)))
        return jnp.where(lost, jnp.nan, part)

    return jax.tree.map(told, slopes)


def towered(function, order):
    """The function's values and derivatives up to an order, each lane's by its own numbers."""
    if order == 0:
        return lambda *numbers: (function(*numbers),)
    below = towered(function, order - 1)

    def upper(*numbers):
        def along(direction):
            ways = zip(direction, numbers, strict=True)
            return jax.jvp(below, numbers, tuple(jnp.broadcast_to(each, jnp.shape(number)) for each, number in ways))

        values, rates = jax.vmap(along, out_axes=(None, -1))(jnp.eye(len(numbers), dtype=numbers[0].dtype))
        return (*values, rates[-1])

    return upper
