"""Strobe with derivatives of any order, forward and reverse: simulate, then replay, or propagate first derivatives.

The derivatives of one order are a function of their own, a replay of the recorded impacts. Its derivative is that of
the next order, contracted with the tangents. This is linear in the tangents, so reverse mode transposes it and no loop
runs backwards. The matrices P and Q are not used: `replay` is differentiated in forward mode, once for each order.
"""

from dataclasses import replace as replaced
from functools import cache, partial
from itertools import repeat
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from ..compiled.blocks import run_in_blocks, vmap_as_lanes
from ..compiled.kernels import BLOCK_WIDTH, call_as_kernel
from ..scene import check
from ..scene.state import State
from . import two_tiers
from .derivative_tensors import active_argnums, contract_tangents, select_argnums
from .one_period import REPLAY_SLOTS
from .replay import RecordedImpacts
from .replay_derivatives import collect_replay_data, move_slots_first, replay_derivatives, truncate_slots


class StrobeRequest(NamedTuple):
    """Static options of a differentiable strobe.

    `tree` is that of (scene, state); `periods`, `slots` and `clearance` are those of `strobe`. With `of_state` the
    derivatives are those of x and v at the end, else those of the times and speeds of the impacts. `argnums` are the
    indices of the arguments of differentiation.
    """

    tree: jax.tree_util.PyTreeDef
    periods: int
    slots: int
    clearance: bool = False
    of_state: bool = True
    order: int = 1
    argnums: tuple[int, ...] = ()


def strobe(scene, state, periods, slots, clearance):
    """Return (State, Impacts) of traced numbers."""
    leaves, tree = jax.tree.flatten((scene, state))
    end, impacts = _differentiable_strobe(StrobeRequest(tree, periods, slots, clearance))(*leaves)
    integer_fields = {name: getattr(impacts, name).astype(jnp.int32) for name in ("count", "status")}
    return end, replaced(impacts, side=impacts.side.astype(jnp.int8), **integer_fields)


@cache
def _differentiable_strobe(request):
    """Return the function that maps the numbers of scene and state to (State, Impacts), all real."""
    settings = {"periods": request.periods, "slots": request.slots, "clearance": request.clearance}
    inner = jax.jit(partial(two_tiers.strobe, **settings, min_lanes=1))
    run = jax.custom_jvp(vmap_as_lanes(lambda *leaves: _cast_to_real(inner(*request.tree.unflatten(leaves)))))

    def jvp_rule(primals, tangents):
        active_indices = active_argnums(tangents)
        if active_indices and _carries_tangents(request, primals):
            outputs, state_jacobian = _strobe_with_jacobian(request._replace(argnums=active_indices))(*primals)
            return outputs, _pushforward(
                request, outputs, _strobe_with_record(request)(*primals)[1], primals, tangents, state_jacobian
            )
        outputs, replay_data = _strobe_with_record(request)(*primals)
        return outputs, _pushforward(request, outputs, replay_data, primals, tangents)

    run.defjvp(jvp_rule, symbolic_zeros=True)
    return run


def _carries_tangents(request, leaves):
    """Decide if derivatives are propagated by the fast path: not for a few concrete lanes.

    The derivatives of the impacts need the replay anyway, and the replay alone compiles faster than both.
    """
    is_small_batch = not check.is_traced(*leaves) and max(map(np.size, leaves)) <= BLOCK_WIDTH
    return not (is_small_batch or request.clearance) and two_tiers.has_fast_path(request.tree.unflatten(leaves)[0])


@cache
def _strobe_with_jacobian(request):
    """Return the function for ((State, Impacts), derivatives of x and v at the end).

    The derivatives have a last axis for the active arguments. The fast path propagates the derivatives; their own
    derivatives are those of the replay.
    """
    settings = {"periods": request.periods, "slots": request.slots, "argnums": request.argnums}
    inner = jax.jit(partial(two_tiers.strobe_with_jacobian, request.tree, **settings, min_lanes=1))
    run = jax.custom_jvp(vmap_as_lanes(lambda *leaves: _cast_to_real(inner(*leaves))))

    def jvp_rule(primals, tangents):
        active_indices = active_argnums(tangents)

        def replay_values(*active_values):
            leaves = list(primals)
            for argnum, value in zip(active_indices, active_values, strict=True):
                leaves[argnum] = value
            outputs, replay_data = _strobe_with_record(request._replace(argnums=()))(*leaves)
            return outputs, _replay_jacobian(request, replay_data, leaves, of_state=True)

        return jax.jvp(
            replay_values, *([arguments[argnum] for argnum in active_indices] for arguments in (primals, tangents))
        )

    run.defjvp(jvp_rule, symbolic_zeros=True)
    return run


@cache
def _strobe_with_record(request):
    """Return the function for ((State, Impacts), `ReplayData`); the latter has no derivatives."""
    history_slots = REPLAY_SLOTS * request.periods
    settings = {
        "periods": request.periods,
        "slots": max(request.slots, history_slots),
        "clearance": request.clearance,
        "history_slots": history_slots,
    }
    inner = jax.jit(partial(two_tiers.strobe_with_record, **settings, min_lanes=1))

    def record(*leaves):
        (end, impacts), history = _cast_to_real(inner(*request.tree.unflatten(leaves)))
        return (end, truncate_slots(impacts, request.slots)), collect_replay_data(end, impacts, history)

    run = jax.custom_jvp(vmap_as_lanes(record))

    def jvp_rule(primals, tangents):
        outputs, replay_data = run(*primals)
        return (outputs, replay_data), (
            _pushforward(request, outputs, replay_data, primals, tangents),
            jax.tree.map(jnp.zeros_like, replay_data),
        )

    run.defjvp(jvp_rule, symbolic_zeros=True)
    return run


@cache
def _derivative_tensors(request):
    """Return the function for the derivatives of all orders up to that of the request.

    Its arguments are the leaves and the fields of `RecordedImpacts`. Each order has two arrays with one last axis for
    each differentiation.
    """
    inner = jax.jit(partial(_tensors_in_blocks, request))
    run = jax.custom_jvp(vmap_as_lanes(lambda *arguments: inner(*arguments), n_rows=2 if request.of_state else 3))

    def jvp_rule(primals, tangents):
        leaf_tangents = tangents[: request.tree.num_leaves]
        active_indices = active_argnums(leaf_tangents)
        if not active_indices:
            values = run(*primals)
            return values, jax.tree.map(jnp.zeros_like, values)
        higher_request = request._replace(
            order=request.order + 1, argnums=tuple(sorted({*request.argnums, *active_indices}))
        )
        tensors = list(enumerate(_derivative_tensors(higher_request)(*primals)))
        values = tuple(
            select_argnums(tensor, higher_request, [*repeat(request.argnums, order + 1)])
            for order, tensor in tensors[:-1]
        )
        jacobians = (
            select_argnums(tensor, higher_request, [*repeat(request.argnums, order), active_indices])
            for order, tensor in tensors[1:]
        )
        return values, tuple(contract_tangents(tensor, primals, leaf_tangents) for tensor in jacobians)

    run.defjvp(jvp_rule, symbolic_zeros=True)
    return run


def _pushforward(request, outputs, replay_data, primals, tangents, state_jacobian=None):
    """Return the tangents of (State, Impacts); `state_jacobian` holds the derivatives of x and v if they are known."""
    (end, impacts), active_indices = outputs, active_argnums(tangents)
    if not active_indices:
        return jax.tree.map(jnp.zeros_like, outputs)
    request = request._replace(argnums=active_indices)
    x, v = contract_tangents(
        state_jacobian or _replay_jacobian(request, replay_data, primals, of_state=True), primals, tangents
    )
    time, speed = contract_tangents(_replay_jacobian(request, replay_data, primals, of_state=False), primals, tangents)
    slowest_index = jnp.maximum(replay_data.slowest_index, 0.0).astype(int)[..., None]
    least_speed = jnp.take_along_axis(speed, slowest_index, -1)[..., 0]
    phase_tangent = 0.0 if isinstance(tangents[-2], SymbolicZero) else tangents[-2]
    end = State(x, v, jnp.zeros_like(end.phase) + phase_tangent, jnp.zeros_like(end.contact))
    return end, replaced(
        jax.tree.map(jnp.zeros_like, impacts),
        time=time[..., : request.slots],
        speed=speed[..., : request.slots],
        least_speed=jnp.where(replay_data.slowest_index < 0, 0.0, least_speed),
    )


def _replay_jacobian(request, replay_data, leaves, of_state):
    """Return the first derivatives of x and v at the end, or of the times and speeds of the impacts."""
    replay_data = replay_data.state_impacts if of_state else replay_data.all_impacts
    scalar_fields = (
        replay_data.count,
        replay_data.release_time,
        replay_data.end_contact,
        replay_data.times,
        replay_data.sides,
    )
    release_rows = () if of_state else (replay_data.last_releases,)
    return _derivative_tensors(request._replace(of_state=of_state))(*leaves, *scalar_fields, *release_rows)[0]


def _cast_to_real(outputs):
    """Cast all arrays to the type of the state."""
    return jax.tree.map(lambda array: array.astype(jax.tree.leaves(outputs)[0].dtype), outputs)


def _tensors_in_blocks(request, *arguments):
    """Evaluate the results of `_derivative_tensors` block by block."""
    leaves, (count, release_time, end_contact, *impact_rows) = (
        arguments[: request.tree.num_leaves],
        arguments[request.tree.num_leaves :],
    )
    times = impact_rows[0]
    n_argnums, slot_axis = len(request.argnums), [] if request.of_state else [times.shape[-1]]

    def empty_tensors(n_lanes):
        shapes = [(n_lanes, *slot_axis, *[n_argnums] * order) for order in range(1, request.order + 1)]
        return tuple((jnp.zeros(shape, times.dtype), jnp.zeros(shape, times.dtype)) for shape in shapes)

    def run(tree, times, sides, *last_releases):
        leaves, scalar_fields = tree
        impacts = move_slots_first(RecordedImpacts(times, sides, *scalar_fields, *last_releases))
        settings = {name: getattr(request, name) for name in ("tree", "argnums", "periods", "order", "of_state")}
        return call_as_kernel(replay_derivatives, leaves, impacts, **settings)

    return run_in_blocks(run, (leaves, (count, release_time, end_contact)), empty_tensors, 1, impact_rows)
