"""Derivatives of a replay with respect to chosen leaves of (scene, state)."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..compiled.lane_arithmetic import value_and_gradient
from ..contact.kinds import make_flow_coefficients
from ..scene.codes import Contact, Status
from .impact_replay import RecordedImpacts, replay_periods


class ReplayData(NamedTuple):
    """Impacts of a strobe that are replayed for derivatives.

    Attributes
    ----------
    impacts_since_release : RecordedImpacts
        Impacts since the last release, on which the final state depends.
    recorded_impacts : RecordedImpacts
        All recorded impacts.
    slowest_impact_index : array
        Index of the slowest impact among `recorded_impacts`; -1 if the slowest impact is not recorded.
    """

    impacts_since_release: RecordedImpacts
    recorded_impacts: RecordedImpacts
    slowest_impact_index: Float[jax.Array, "*lanes"]


def collect_replay_data(end_state, impacts, replay_history):
    """Return the `ReplayData` of a strobe, slots last, from the final state, the impacts and the `ReplayHistory`.

    If the mass sticks at the end, the wall determines the final state, and no impact is replayed for this state.
    """
    end_contact_code = jnp.where(abs(end_state.contact) >= Contact.STUCK, end_state.contact, 0.0)
    has_no_end_state, is_sticking = impacts.status >= Status.CAP, abs(end_contact_code) == Contact.STUCK
    n_since_release = jnp.where(replay_history.count > replay_history.times.shape[-1], -1.0, replay_history.count)
    n_since_release = jnp.where(has_no_end_state, -1.0, jnp.where(is_sticking, 0.0, n_since_release))
    n_impacts = jnp.where(has_no_end_state, -1.0, impacts.count)
    sides = impacts.side.astype(impacts.time.dtype)
    recorded_since_release = RecordedImpacts(
        replay_history.times, replay_history.sides, n_since_release, replay_history.release_time, end_contact_code
    )
    return ReplayData(
        recorded_since_release,
        RecordedImpacts(
            impacts.time, sides, n_impacts, replay_history.release_time, end_contact_code, replay_history.last_releases
        ),
        _slowest_index(impacts),
    )


def move_slots_first(impacts):
    """Move the slots of `RecordedImpacts` from the last axis to the first."""
    slot_rows = {name: getattr(impacts, name) for name in ("times", "sides", "last_releases")}
    return impacts._replace(
        **{name: None if slot_row is None else jnp.moveaxis(slot_row, -1, 0) for name, slot_row in slot_rows.items()}
    )


def _slowest_index(impacts):
    """Return the index of the slowest impact; -1 if this impact is not recorded, as after complete chatter."""
    if not impacts.speed.shape[-1]:
        return jnp.full_like(impacts.least_speed, -1.0)
    speeds = jnp.where(impacts.side != 0, impacts.speed, jnp.inf)
    is_slowest_recorded = jnp.isfinite(impacts.least_speed) & (jnp.min(speeds, axis=-1) == impacts.least_speed)
    return jnp.where(is_slowest_recorded, jnp.argmin(speeds, axis=-1), -1.0)


def truncate_slots(impacts, slots):
    """Truncate the recorded impacts to a smaller number of slots."""
    has_truncated_impacts = (impacts.status == Status.OK) & (impacts.count > slots)
    slot_rows = {name: getattr(impacts, name)[..., :slots] for name in ("time", "side", "speed")}
    status = jnp.where(has_truncated_impacts, Status.FULL, impacts.status).astype(impacts.status.dtype)
    return replace(impacts, status=status, **slot_rows)


def replay_derivatives(leaves, impacts, tree, argnums, periods, order, of_state):
    """Compute the derivatives of orders 1 to `order` with respect to the leaves `argnums`.

    If `of_state` is true, x and v at the end are differentiated, otherwise the times and speeds of the impacts. Results
    have lanes first and one trailing axis for each differentiation. They are nan where a replay is not possible.
    `impacts` has slots first.
    """

    def replay_outputs(*active_values):
        replaced_leaves = list(leaves)
        for argnum, value in zip(argnums, active_values, strict=True):
            replaced_leaves[argnum] = value
        scene, state = tree.unflatten(replaced_leaves)
        end_state, times, speeds = replay_periods(make_flow_coefficients(scene), state, impacts, periods, order)
        return end_state if of_state else (times, speeds)

    all_derivatives = make_with_derivatives(replay_outputs, order)(*(leaves[argnum] for argnum in argnums))[1:]
    n_lane_axes = impacts.count.ndim

    def nan_where_invalid(derivative):
        derivative = derivative if of_state else jnp.moveaxis(derivative, 0, n_lane_axes)
        has_no_replay = jnp.reshape(impacts.count < 0, (*impacts.count.shape, *[1] * (derivative.ndim - n_lane_axes)))
        return jnp.where(has_no_replay, jnp.nan, derivative)

    return jax.tree.map(nan_where_invalid, all_derivatives)


def make_with_derivatives(function, order):
    """Return a function that computes the value and the derivatives of `function` up to an order, lane by lane."""
    if order == 0:
        return lambda *args: (function(*args),)
    lower_order_function = make_with_derivatives(function, order - 1)

    def value_and_derivatives(*args):
        values, derivatives = value_and_gradient(lower_order_function, args, -1)
        return (*values, derivatives[-1])

    return value_and_derivatives
