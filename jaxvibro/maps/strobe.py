"""Stroboscopic (Poincaré) map: the state after drive periods, the impacts, and derivatives of any order.

Stroboscopic map with derivatives of any order in forward and reverse mode. The map is simulated, and the recorded
impacts are replayed for the derivatives. The fast path may propagate first derivatives instead. Derivatives of each
order are a separate function, a replay of the impacts. The derivative of this function is the next order contracted
with the tangents. The contraction is linear in the tangents, so reverse mode transposes it and no loop runs backwards.
The replay is differentiated in forward mode, once for each order.
"""

import math
from dataclasses import replace as replaced
from functools import cache, partial
from itertools import repeat
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from continuation.hostcall import persistent_jit

from ..compiled.kernel_calls import BLOCK_WIDTH, call_as_kernel
from ..compiled.lane_arithmetic import COMPILER_OPTIONS
from ..compiled.lane_blocks import MIN_LANES, run_in_blocks, vmap_as_lanes
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import Impacts, State, make_state_arrays
from . import reference_strobe, two_tier_strobe
from .derivative_tensors import active_argnums, contract_tangents, select_argnums
from .impact_replay import RecordedImpacts, collect_replay_data, move_slots_first, replay_derivatives, truncate_slots
from .reference_strobe import REPLAY_SLOTS


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


# The fast path nearly always gives up one of this many lanes: up to a chunk of lanes, one call runs both tiers.
MIN_TWO_TIER_LANES = 256
CHUNK_LANES = 1024  # number of lanes of a rerun by the reference path


@persistent_jit(static_argnums=(2, 3, 4), compiler_options=COMPILER_OPTIONS)
def _two_tier_strobe(scene, state, periods, slots, clearance):
    return two_tier_strobe.two_tier_strobe(scene, state, periods, slots, MIN_LANES, clearance)


@persistent_jit(static_argnums=(2, 3), compiler_options=COMPILER_OPTIONS)
def _fast_strobe(scene, state, slots, clearance):
    return two_tier_strobe.fast_strobe(scene, state, slots, MIN_LANES, clearance)


@persistent_jit(static_argnums=(2, 3), compiler_options=COMPILER_OPTIONS)
def _fast_strobe_single(scene, packed_state, slots, clearance):
    """Run the fast path for one state, packed in one array because each array argument costs microseconds."""
    return two_tier_strobe.fast_strobe(scene, State(*packed_state), slots, MIN_LANES, clearance)


@persistent_jit(static_argnums=(2, 3), compiler_options=COMPILER_OPTIONS)
def _reference_strobe(scene, state, slots, clearance, n_lanes_due):
    return reference_strobe.reference_strobe(scene, state, 1, slots, MIN_LANES, clearance, n_lanes_due)


@partial(jax.jit, donate_argnums=0)
def _replace_lanes(all_results, lane_indices, new_lane_results):
    """Replace some lanes of the results in place; an index beyond the end is ignored."""
    return jax.tree.map(lambda old, new: old.at[lane_indices].set(new, mode="drop"), all_results, new_lane_results)


def _take_lanes(tree, lane_indices, lane_shape):
    """Select lanes by index from leaves that broadcast to a shape."""
    return jax.tree.map(lambda leaf: np.broadcast_to(leaf, lane_shape)[lane_indices] if leaf.ndim else leaf, tree)


def concrete_strobe(scene, state, periods, slots, clearance):
    """Evaluate the map for concrete arguments; compile only the tiers that the lanes need."""
    state_leaves = (state.x, state.v, state.phase, state.contact)
    argument_shapes = [scene.shape, *map(np.shape, state_leaves)]
    lane_shape = np.broadcast_shapes(*argument_shapes) if any(argument_shapes) else ()
    if (
        periods > 1
        or not two_tier_strobe.has_fast_path(scene)
        or MIN_TWO_TIER_LANES <= math.prod(lane_shape) <= CHUNK_LANES
    ):
        return _two_tier_strobe(scene, state, periods, slots, clearance)
    if not lane_shape:
        results, is_given_up = _fast_strobe_single(scene, np.array(state_leaves), slots, clearance)
        return _reference_strobe(scene, state, slots, clearance, None) if np.asarray(is_given_up) else results
    results, is_given_up = _fast_strobe(scene, state, slots, clearance)
    given_up_lanes = np.flatnonzero(is_given_up)
    if not given_up_lanes.size:
        return results
    numpy_arguments = jax.tree.map(np.asarray, (scene, state))
    chunk_width = min(CHUNK_LANES, np.size(is_given_up))
    for chunk_start in range(0, given_up_lanes.size, chunk_width):
        chunk_lanes = given_up_lanes[chunk_start : chunk_start + chunk_width]
        n_padding_lanes = chunk_width - chunk_lanes.size
        lane_indices = np.unravel_index(np.pad(chunk_lanes, (0, n_padding_lanes), mode="edge"), lane_shape)
        chunk_results = _reference_strobe(
            *_take_lanes(numpy_arguments, lane_indices, lane_shape), slots, clearance, np.int32(chunk_lanes.size)
        )
        replacement_indices = (
            np.where(np.arange(chunk_width) < chunk_lanes.size, lane_indices[0], lane_shape[0]),
            *lane_indices[1:],
        )
        results = _replace_lanes(results, replacement_indices, chunk_results)
    return results


@check.check_types
def strobe(
    scene: Scene, state: State, periods: int = 1, slots: int = 4, clearance: bool = False
) -> tuple[State, Impacts]:
    """Evaluate the stroboscopic map and record the impacts.

    The fields of `scene` and `state` broadcast together, and the results have the broadcast shape. The map has
    derivatives of any order in forward and reverse mode.

    Parameters
    ----------
    scene : Scene
        Oscillator, drive and walls. A single scene or a batch.
    state : State
        Initial state at its phase. A single state or a batch.
    periods : int, optional
        Number of drive periods, at least 1.
    slots : int, optional
        Number of impacts to record, at least 0. If there are more impacts, the status is FULL, and all other results
        are correct.
    clearance : bool, optional
        Measure `Impacts.least_clearance`. If False, the field is None.

    Returns
    -------
    end : State
        State after the last period. Its phase is that of `state`.
    impacts : Impacts
        Impacts in order of time, and the status of each lane.

    Raises
    ------
    ArgumentError
        If `periods`, `slots`, `clearance` or `state` is invalid. All other failures are reported by `Impacts.status`.

    See Also
    --------
    sample : States at given times.
    simulate : Trajectory of one state, for plots.
    monodromy : First derivative with respect to the state, as a product of matrices.

    Notes
    -----
    *Impacts at the ends.* An impact at the end belongs to the period that ends: `end` is the state after the impact,
    and the contact shows this. A mass that starts on a wall and moves into the wall rebounds at time 0. A flight that
    turns back within 8 ulp of the largest length (x, v, A and the walls' positions) from a wall may count as an impact
    or not.

    *Several periods.* A call with n periods is equivalent to n calls with one. With the linear spring, a single drive
    term and rigid walls, in double precision, the results agree bit for bit. Otherwise they differ by rounding, by less
    than ``16 eps (1 + T) s (1 + sum of |M|)``. Here T = 2 pi / omega, s is the largest length or speed, and
    M is the derivative of the final state with respect to each intermediate state (``docs/numbers.md``).

    *Derivatives.* ``jax.grad``, ``jax.jacfwd``, ``jax.jacrev``, ``jax.hessian`` and their compositions apply, with
    respect to x, v, the phase and every number of the scene. The final state, the times and speeds of the impacts and
    the least speed are differentiable. Other fields of `Impacts` are constants. Derivatives follow these rules:

    - Derivatives are nan if there is no final state, that is, if the status is CAP or worse.
    - Derivatives are one-sided if an impact, an entry into a soft wall or an exit from a soft wall happens at the end.
      They belong to the returned state and contact.
    - With more than 32 impacts per period since the last release, first derivatives of the state may be nan, and higher
      derivatives are nan.
    - Derivatives do not exist at a grazing. The result is the derivative of the flight without the impact.
    - If the mass sticks, later states do not depend on the initial state or on the impacts before the mass sticks.

    Examples
    --------
    >>> end, impacts = jv.strobe(scene, state)
    >>> round(float(end.x), 6), round(float(end.v), 6), int(impacts.count)
    (0.674479, 2.09915, 1)
    >>> position = lambda amplitude: jv.strobe(scene.replace(amplitude=amplitude), state)[0].x
    >>> round(float(jax.grad(position)(2.0)), 6)
    0.442388
    """
    periods, slots = check.check_whole_number("periods", periods, 1), check.check_whole_number("slots", slots, 0)
    if not isinstance(clearance, bool | np.bool_):
        raise check.ArgumentError("clearance", "must be True or False", clearance)
    state = make_state_arrays(scene, state)
    is_traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((scene, state)))
    return (traced_strobe if is_traced else concrete_strobe)(scene, state, periods, slots, bool(clearance))
