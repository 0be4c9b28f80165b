"""Stroboscopic map with derivatives of any order in forward and reverse mode.

The map is simulated, and the recorded impacts are replayed for the derivatives. The fast path may propagate first
derivatives instead. Derivatives of each order are a separate function, a replay of the impacts. The derivative of this
function is the next order contracted with the tangents. The contraction is linear in the tangents, so reverse mode
transposes it and no loop runs backwards. The replay is differentiated in forward mode, once for each order.
"""

from dataclasses import replace as replaced
from functools import cache, partial
from itertools import repeat
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from ..compiled.kernel_calls import BLOCK_WIDTH, call_as_kernel
from ..compiled.lane_blocks import run_in_blocks, vmap_as_lanes
from ..scene import check
from ..scene.state import State
from . import two_tier_strobe
from .derivative_tensors import active_argnums, contract_tangents, select_argnums
from .impact_replay import RecordedImpacts
from .reference_strobe import REPLAY_SLOTS
from .replay_derivatives import collect_replay_data, move_slots_first, replay_derivatives, truncate_slots


class StrobeDerivativeRequest(NamedTuple):
    """Static options of a differentiable strobe.

    Attributes
    ----------
    tree : PyTreeDef
        Pytree structure of (scene, state).
    periods, slots, clearance : int, int, bool
        Arguments of `strobe`.
    of_state : bool
        True to differentiate x and v at the end, False for the times and speeds of the impacts.
    order : int
        Highest order of the derivatives.
    argnums : tuple of int
        Indices of the leaves with respect to which the results are differentiated.
    """

    tree: jax.tree_util.PyTreeDef
    periods: int
    slots: int
    clearance: bool = False
    of_state: bool = True
    order: int = 1
    argnums: tuple[int, ...] = ()


def traced_strobe(scene, state, periods, slots, clearance):
    """Evaluate the stroboscopic map for traced arguments and return (State, Impacts)."""
    leaves, treedef = jax.tree.flatten((scene, state))
    end_state, impacts = _differentiable_strobe(StrobeDerivativeRequest(treedef, periods, slots, clearance))(*leaves)
    integer_fields = {field_name: getattr(impacts, field_name).astype(jnp.int32) for field_name in ("count", "status")}
    return end_state, replaced(impacts, side=impacts.side.astype(jnp.int8), **integer_fields)


@cache
def _differentiable_strobe(request):
    """Return the function that maps the leaves of (scene, state) to (State, Impacts) with real fields."""
    strobe_kwargs = {"periods": request.periods, "slots": request.slots, "clearance": request.clearance}
    compiled_strobe = jax.jit(partial(two_tier_strobe.two_tier_strobe, **strobe_kwargs, min_lanes=1))
    strobe_of_leaves = jax.custom_jvp(
        vmap_as_lanes(lambda *leaves: _cast_to_state_dtype(compiled_strobe(*request.tree.unflatten(leaves))))
    )

    def jvp_rule(primals, tangents):
        active_indices = active_argnums(tangents)
        if active_indices and _has_fast_derivatives(request, primals):
            end_and_impacts, state_jacobian = _strobe_with_jacobian(request._replace(argnums=active_indices))(*primals)
            return end_and_impacts, _strobe_tangents(
                request,
                end_and_impacts,
                _strobe_with_replay_data(request)(*primals)[1],
                primals,
                tangents,
                state_jacobian,
            )
        end_and_impacts, replay_data = _strobe_with_replay_data(request)(*primals)
        return end_and_impacts, _strobe_tangents(request, end_and_impacts, replay_data, primals, tangents)

    strobe_of_leaves.defjvp(jvp_rule, symbolic_zeros=True)
    return strobe_of_leaves


def _has_fast_derivatives(request, leaves):
    """Return True if the fast path propagates the derivatives of the final state.

    The result is False for few concrete lanes and if the least clearance is requested. Only the replay is then
    compiled, which the derivatives of the impacts need in any case.
    """
    is_small_concrete_batch = not check.is_traced(*leaves) and max(map(np.size, leaves)) <= BLOCK_WIDTH
    return not (is_small_concrete_batch or request.clearance) and two_tier_strobe.has_fast_path(
        request.tree.unflatten(leaves)[0]
    )


@cache
def _strobe_with_jacobian(request):
    """Return the function that maps leaves to ((State, Impacts), derivatives of x and v at the end).

    The last axis of the derivatives runs over the arguments of differentiation. The fast path propagates the
    derivatives. Higher derivatives come from the replay.
    """
    strobe_kwargs = {"periods": request.periods, "slots": request.slots, "argnums": request.argnums}
    compiled_strobe = jax.jit(partial(two_tier_strobe.strobe_with_jacobian, request.tree, **strobe_kwargs, min_lanes=1))
    strobe_of_leaves = jax.custom_jvp(vmap_as_lanes(lambda *leaves: _cast_to_state_dtype(compiled_strobe(*leaves))))

    def jvp_rule(primals, tangents):
        active_indices = active_argnums(tangents)

        def replay_with_jacobian(*active_values):
            leaves = list(primals)
            for argnum, value in zip(active_indices, active_values, strict=True):
                leaves[argnum] = value
            end_and_impacts, replay_data = _strobe_with_replay_data(request._replace(argnums=()))(*leaves)
            return end_and_impacts, _replay_jacobian(request, replay_data, leaves, of_state=True)

        return jax.jvp(
            replay_with_jacobian,
            *(
                [primals_or_tangents[argnum] for argnum in active_indices]
                for primals_or_tangents in (primals, tangents)
            ),
        )

    strobe_of_leaves.defjvp(jvp_rule, symbolic_zeros=True)
    return strobe_of_leaves


@cache
def _strobe_with_replay_data(request):
    """Return the function that maps leaves to ((State, Impacts), `ReplayData`); `ReplayData` has no derivatives."""
    history_slots = REPLAY_SLOTS * request.periods
    strobe_kwargs = {
        "periods": request.periods,
        "slots": max(request.slots, history_slots),
        "clearance": request.clearance,
        "history_slots": history_slots,
    }
    compiled_strobe = jax.jit(partial(two_tier_strobe.strobe_and_history, **strobe_kwargs, min_lanes=1))

    def strobe_and_collect(*leaves):
        (end_state, impacts), replay_history = _cast_to_state_dtype(compiled_strobe(*request.tree.unflatten(leaves)))
        return (end_state, truncate_slots(impacts, request.slots)), collect_replay_data(
            end_state, impacts, replay_history
        )

    strobe_of_leaves = jax.custom_jvp(vmap_as_lanes(strobe_and_collect))

    def jvp_rule(primals, tangents):
        end_and_impacts, replay_data = strobe_of_leaves(*primals)
        return (end_and_impacts, replay_data), (
            _strobe_tangents(request, end_and_impacts, replay_data, primals, tangents),
            jax.tree.map(jnp.zeros_like, replay_data),
        )

    strobe_of_leaves.defjvp(jvp_rule, symbolic_zeros=True)
    return strobe_of_leaves


@cache
def _replay_tensors(request):
    """Return the function for the derivatives of all orders up to `order` of the request.

    The arguments of the function are the leaves and the fields of `RecordedImpacts`. The result has two arrays for each
    order, with one trailing axis for each differentiation.
    """
    compiled_replay = jax.jit(partial(_tensors_in_blocks, request))
    tensors_of_arguments = jax.custom_jvp(
        vmap_as_lanes(lambda *arguments: compiled_replay(*arguments), n_trailing_axis_args=2 if request.of_state else 3)
    )

    def jvp_rule(primals, tangents):
        leaf_tangents = tangents[: request.tree.num_leaves]
        active_indices = active_argnums(leaf_tangents)
        if not active_indices:
            tensor_values = tensors_of_arguments(*primals)
            return tensor_values, jax.tree.map(jnp.zeros_like, tensor_values)
        higher_request = request._replace(
            order=request.order + 1, argnums=tuple(sorted({*request.argnums, *active_indices}))
        )
        tensors_by_order = list(enumerate(_replay_tensors(higher_request)(*primals)))
        tensor_values = tuple(
            select_argnums(tensor_pair, higher_request, [*repeat(request.argnums, order + 1)])
            for order, tensor_pair in tensors_by_order[:-1]
        )
        tensor_jacobians = (
            select_argnums(tensor_pair, higher_request, [*repeat(request.argnums, order), active_indices])
            for order, tensor_pair in tensors_by_order[1:]
        )
        return tensor_values, tuple(
            contract_tangents(tensor_pair, primals[: request.tree.num_leaves], leaf_tangents)
            for tensor_pair in tensor_jacobians
        )

    tensors_of_arguments.defjvp(jvp_rule, symbolic_zeros=True)
    return tensors_of_arguments


def _strobe_tangents(request, end_and_impacts, replay_data, primals, tangents, state_jacobian=None):
    """Return the tangents of (State, Impacts); `state_jacobian` is the derivative of x and v, None if not known."""
    (end_state, impacts), active_indices = end_and_impacts, active_argnums(tangents)
    if not active_indices:
        return jax.tree.map(jnp.zeros_like, end_and_impacts)
    request = request._replace(argnums=active_indices)
    x_tangent, v_tangent = contract_tangents(
        state_jacobian or _replay_jacobian(request, replay_data, primals, of_state=True), primals, tangents
    )
    time_tangents, speed_tangents = contract_tangents(
        _replay_jacobian(request, replay_data, primals, of_state=False), primals, tangents
    )
    slowest_impact_index = jnp.maximum(replay_data.slowest_impact_index, 0.0).astype(int)[..., None]
    least_speed_tangent = jnp.take_along_axis(speed_tangents, slowest_impact_index, -1)[..., 0]
    phase_tangent = 0.0 if isinstance(tangents[-2], SymbolicZero) else tangents[-2]
    end_state = State(
        x_tangent, v_tangent, jnp.zeros_like(end_state.phase) + phase_tangent, jnp.zeros_like(end_state.contact)
    )
    return end_state, replaced(
        jax.tree.map(jnp.zeros_like, impacts),
        time=time_tangents[..., : request.slots],
        speed=speed_tangents[..., : request.slots],
        least_speed=jnp.where(replay_data.slowest_impact_index < 0, 0.0, least_speed_tangent),
    )


def _replay_jacobian(request, replay_data, leaves, of_state):
    """Return the first derivatives of x and v at the end, or of the times and speeds of the impacts."""
    replay_data = replay_data.impacts_since_release if of_state else replay_data.recorded_impacts
    recorded_fields = (
        replay_data.count,
        replay_data.release_time,
        replay_data.end_contact,
        replay_data.times,
        replay_data.sides,
    )
    last_release_times = () if of_state else (replay_data.last_releases,)
    return _replay_tensors(request._replace(of_state=of_state))(*leaves, *recorded_fields, *last_release_times)[0]


def _cast_to_state_dtype(array_tree):
    """Cast all arrays to the type of the first array."""
    return jax.tree.map(lambda array: array.astype(jax.tree.leaves(array_tree)[0].dtype), array_tree)


def _tensors_in_blocks(request, *arguments):
    """Evaluate the results of `_replay_tensors` block by block."""
    leaves, (n_impacts, release_time, end_contact, *impact_rows) = (
        arguments[: request.tree.num_leaves],
        arguments[request.tree.num_leaves :],
    )
    impact_times = impact_rows[0]
    n_argnums, slot_axis_shape = len(request.argnums), [] if request.of_state else [impact_times.shape[-1]]

    def make_zero_tensors(n_lanes):
        tensor_shapes = [(n_lanes, *slot_axis_shape, *[n_argnums] * order) for order in range(1, request.order + 1)]
        return tuple(
            (jnp.zeros(shape, impact_times.dtype), jnp.zeros(shape, impact_times.dtype)) for shape in tensor_shapes
        )

    def replay_block(leaves_and_fields, impact_times, impact_sides, *last_release_times):
        leaves, scalar_fields = leaves_and_fields
        impacts = move_slots_first(RecordedImpacts(impact_times, impact_sides, *scalar_fields, *last_release_times))
        replay_kwargs = {name: getattr(request, name) for name in ("tree", "argnums", "periods", "order", "of_state")}
        return call_as_kernel(replay_derivatives, leaves, impacts, **replay_kwargs)

    return run_in_blocks(
        replay_block, (leaves, (n_impacts, release_time, end_contact)), make_zero_tensors, 1, impact_rows
    )
