"""Derivatives of a replay with respect to chosen numbers of scene and state."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..flight.coefficients import compute_coefficients
from ..scene.codes import Contact, Status
from .replay import RecordedImpacts, replay_periods


class ReplayData(NamedTuple):
    """Data for the replays of a strobe.

    `state_impacts` are the impacts since the last release, for the end; `all_impacts` are the recorded impacts from the
    first. `slowest_index` is the index of the slowest of these, -1 for none.
    """

    state_impacts: RecordedImpacts
    all_impacts: RecordedImpacts
    slowest_index: Float[jax.Array, "*lanes"]


def collect_replay_data(end, impacts, history):
    """Return the `ReplayData` of a strobe, slots last, from its end, its impacts and its `ReplayHistory`.

    The end state of a sticking mass is that of its wall, whatever came before.
    """
    end_contact = jnp.where(abs(end.contact) >= Contact.STUCK, end.contact, 0.0)
    has_no_end, is_sticking = impacts.status >= Status.CAP, abs(end_contact) == Contact.STUCK
    n_since_release = jnp.where(history.count > history.times.shape[-1], -1.0, history.count)
    n_since_release = jnp.where(has_no_end, -1.0, jnp.where(is_sticking, 0.0, n_since_release))
    n_impacts = jnp.where(has_no_end, -1.0, impacts.count)
    sides = impacts.side.astype(impacts.time.dtype)
    state_impacts = RecordedImpacts(history.times, history.sides, n_since_release, history.release_time, end_contact)
    return ReplayData(
        state_impacts,
        RecordedImpacts(impacts.time, sides, n_impacts, history.release_time, end_contact, history.last_releases),
        _slowest_index(impacts),
    )


def move_slots_first(impacts):
    """Move the slots of `RecordedImpacts` from the last axis to the first."""
    rows = {name: getattr(impacts, name) for name in ("times", "sides", "last_releases")}
    return impacts._replace(**{name: None if row is None else jnp.moveaxis(row, -1, 0) for name, row in rows.items()})


def _slowest_index(impacts):
    """Return the index of the slowest impact, -1 if it is not recorded or has zero speed."""
    if not impacts.speed.shape[-1]:
        return jnp.full_like(impacts.least_speed, -1.0)
    speeds = jnp.where(impacts.side != 0, impacts.speed, jnp.inf)
    is_recorded = jnp.isfinite(impacts.least_speed) & (jnp.min(speeds, axis=-1) == impacts.least_speed)
    return jnp.where(is_recorded, jnp.argmin(speeds, axis=-1), -1.0)


def truncate_slots(impacts, slots):
    """Cut the impacts to a smaller number of slots."""
    is_truncated = (impacts.status == Status.OK) & (impacts.count > slots)
    rows = {name: getattr(impacts, name)[..., :slots] for name in ("time", "side", "speed")}
    status = jnp.where(is_truncated, Status.FULL, impacts.status).astype(impacts.status.dtype)
    return replace(impacts, status=status, **rows)


def replay_derivatives(leaves, impacts, tree, argnums, periods, order, of_state):
    """Compute derivatives of orders 1, 2, ... with respect to leaves `argnums`, with one last axis per differentiation.

    With `of_state` they are those of x and v at the end, else those of the times and speeds of the impacts, lanes
    first. They are nan where a replay is not possible. `impacts` has slots first.
    """

    def replay_outputs(*active_values):
        all_leaves = list(leaves)
        for argnum, value in zip(argnums, active_values, strict=True):
            all_leaves[argnum] = value
        scene, state = tree.unflatten(all_leaves)
        end, times, speeds = replay_periods(compute_coefficients(scene), state, impacts, periods, order)
        return end if of_state else (times, speeds)

    derivatives = with_derivatives(replay_outputs, order)(*(leaves[argnum] for argnum in argnums))[1:]
    n_lane_axes = impacts.count.ndim

    def mask_invalid(derivative):
        derivative = derivative if of_state else jnp.moveaxis(derivative, 0, n_lane_axes)
        is_invalid = jnp.reshape(impacts.count < 0, (*impacts.count.shape, *[1] * (derivative.ndim - n_lane_axes)))
        return jnp.where(is_invalid, jnp.nan, derivative)

    return jax.tree.map(mask_invalid, derivatives)


def with_derivatives(function, order):
    """Extend a function to return its value and its derivatives up to an order, lane by lane."""
    if order == 0:
        return lambda *args: (function(*args),)
    lower_orders = with_derivatives(function, order - 1)

    def all_orders(*args):
        def directional_derivative(direction):
            component_and_arg = zip(direction, args, strict=True)
            return jax.jvp(
                lower_orders,
                args,
                tuple(jnp.broadcast_to(component, jnp.shape(arg)) for component, arg in component_and_arg),
            )

        values, derivatives = jax.vmap(directional_derivative, out_axes=(None, -1))(
            jnp.eye(len(args), dtype=args[0].dtype)
        )
        return (*values, derivatives[-1])

    return all_orders
