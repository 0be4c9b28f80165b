"""Compute the states of a motion at given times, with derivatives of any order.

States of a sample and their derivatives of any order. The flight is divided into pieces. Each piece is replayed as soon
as it has been simulated. Taylor polynomials of x and v in the arguments of differentiation carry the derivatives from
piece to piece: a replay that starts with the polynomials gives the polynomials at the end of the piece. The times at
which pieces end are constants. An additional argument is the delay between a sample and its stop. A sample depends on
its own time only through this delay.
"""

from functools import cache, partial
from itertools import repeat
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_derivatives import SymbolicZero
from jaxtyping import ArrayLike, Float, Int

from continuation.array_type import Array
from continuation.hostcall import persistent_jit

from ..compiled.kernel_calls import call_as_kernel
from ..compiled.lane_arithmetic import COMPILER_OPTIONS, choose, two_sum
from ..compiled.lane_blocks import run_in_blocks, vmap_as_lanes
from ..contact.kinds import make_flow_coefficients
from ..flight import flow, impact_log, integration_loop
from ..flight.flight_coefficients import dekker_product_error
from ..flight.flight_state import CAPPED, absolute_state
from ..flight.path_start import start_path
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import Contact, State, Status, make_state_arrays
from .derivative_tensors import active_argnums, contract_tangents, select_argnums
from .flight_stops import FlightStops, fly_to_stops
from .impact_replay import RecordedImpacts, make_with_derivatives, replay_duration
from .reference_strobe import REPLAY_SLOTS, reported_contact_code

MAX_PERIODS = 1e6  # limit of the last time: beyond it the call would seem to hang
MIN_TIME_EXPONENT = 0.5  # a time 0 is replaced by tiny**0.5, so that an impact at the start is included


class SampleDerivativeRequest(NamedTuple):
    """Static options of a sample with derivatives.

    Attributes
    ----------
    tree : PyTreeDef
        Pytree structure of (scene, state).
    order : int
        Highest order of the derivatives.
    argnums : tuple of int
        Indices of the arguments of differentiation. The arguments are the leaves without the contact, then the times.
    """

    tree: jax.tree_util.PyTreeDef
    order: int = 0
    argnums: tuple[int, ...] = ()


class PropagatedDerivatives(NamedTuple):
    """Derivatives that are carried along the flight.

    Attributes
    ----------
    derivatives : tuple of (array, array)
        Derivatives of x and v, order 1 first, with one trailing axis for each differentiation.
    derivatives_at_stop : tuple of (array, array)
        Derivatives at the last stop, which include the derivatives with respect to the time of the sample.
    start_time : array
        Time from the start of the flight to the start of the current piece.
    are_derivatives_lost : array
        1 where derivatives are not available, 0 elsewhere.
    """

    derivatives: tuple[tuple[Float[jax.Array, "..."], Float[jax.Array, "..."]], ...]
    derivatives_at_stop: tuple[tuple[Float[jax.Array, "..."], Float[jax.Array, "..."]], ...]
    start_time: Float[jax.Array, "..."]
    are_derivatives_lost: Float[jax.Array, "..."]


@cache
def differentiable_sample(request):
    """Return the function that maps leaves and times to ((contact, status), ((x, v), derivatives of order 1, ...)).

    All results are real. Arrays have axes (lanes, times), and the status has the axis of the lanes only.
    """
    compiled_sample = jax.jit(partial(sample_in_lane_blocks, request))
    sample_of_arguments = jax.custom_jvp(
        vmap_as_lanes(lambda *arguments: compiled_sample(*arguments), n_trailing_axis_args=1)
    )

    def jvp_rule(primals, tangents):
        active_indices = active_argnums(_move_contact_last(tangents))
        if not active_indices:
            outputs = sample_of_arguments(*primals)
            return outputs, jax.tree.map(jnp.zeros_like, outputs)
        higher_request = request._replace(
            order=request.order + 1, argnums=tuple(sorted({*request.argnums, *active_indices}))
        )
        contact_and_status, tensors = differentiable_sample(higher_request)(*primals)
        tensor_values = tuple(
            select_argnums(tensor_pair, higher_request, [*repeat(request.argnums, order)])
            for order, tensor_pair in enumerate(tensors[:-1])
        )
        tensor_jacobians = (
            select_argnums(tensor_pair, higher_request, [*repeat(request.argnums, order), active_indices])
            for order, tensor_pair in enumerate(tensors[1:])
        )
        primals_and_tangents = [
            _add_time_axis(_move_contact_last(primals_or_tangents)) for primals_or_tangents in (primals, tangents)
        ]
        output_tangents = tuple(
            contract_tangents(tensor_pair, *primals_and_tangents) for tensor_pair in tensor_jacobians
        )
        return (contact_and_status, tensor_values), (jax.tree.map(jnp.zeros_like, contact_and_status), output_tangents)

    sample_of_arguments.defjvp(jvp_rule, symbolic_zeros=True)
    return sample_of_arguments


def _move_contact_last(leaves_and_times):
    """Move the contact from the last but one to the last place of the arguments."""
    return (*leaves_and_times[:-2], leaves_and_times[-1], leaves_and_times[-2])


def _add_time_axis(arguments):
    """Add an axis for the times to all arguments except the times and the contact."""
    *leaves, times, contact = arguments
    leaves_with_time_axis = [
        leaf if isinstance(leaf, SymbolicZero) else jnp.asarray(leaf)[..., None] for leaf in leaves
    ]
    return (*leaves_with_time_axis, times, contact)


def sample_in_lane_blocks(request, *arguments):
    """Evaluate the results of `differentiable_sample` block by block."""
    *leaves, times = arguments
    _, start_state = request.tree.unflatten(leaves)
    shape = jnp.broadcast_shapes(*map(jnp.shape, leaves), times.shape[:-1])
    leaves[request.tree.num_leaves - 4] = jnp.broadcast_to(start_state.x, shape)
    n_times, n_argnums = times.shape[-1], len(request.argnums)

    def make_zero_results(n_lanes):
        array_shapes = [(n_lanes, n_times, *[n_argnums] * order) for order in range(request.order + 1)]
        xv_pairs = tuple(
            (jnp.zeros(array_shape, times.dtype), jnp.zeros(array_shape, times.dtype)) for array_shape in array_shapes
        )
        return (jnp.zeros((n_lanes, n_times), times.dtype), jnp.zeros(n_lanes, times.dtype)), xv_pairs

    def run_block(leaves, times):
        return call_as_kernel(_sample_block, leaves, times, request=request)

    return run_in_blocks(run_block, leaves, make_zero_results, 1, [jnp.broadcast_to(times, (*shape, n_times))])


def _sample_block(leaves, times, request):
    """Evaluate the results of `differentiable_sample` for one block of lanes."""
    scene, state = request.tree.unflatten(leaves)
    times = jnp.moveaxis(times, -1, 0)
    coeffs = make_flow_coefficients(scene)
    path, start_status = start_path(coeffs, state)
    start_status = choose(start_status == Status.OK, _time_order_status(times), start_status)
    is_beyond_max_time = times[-1] > MAX_PERIODS * coeffs.period
    path = path._replace(
        time_remaining=choose(is_beyond_max_time & (start_status == Status.OK), CAPPED, path.time_remaining)
    )
    stops = _make_stops(coeffs, state, times, (start_status == Status.OK) & ~is_beyond_max_time)
    loop_state = integration_loop.initial_loop_state(
        coeffs, path, 0, coeffs.period + 0.0 * path.x, n_slots_since_release=REPLAY_SLOTS if request.order else 0
    )
    derivative_state = _initial_derivatives(request, path.x, stops.flight_time[0] * 0.0) if request.order else ()
    finish_piece = partial(_replay_piece, request, leaves, start_status) if request.order else _reset_impact_log
    (loop_state, _), stop_observations = fly_to_stops(
        coeffs,
        loop_state,
        derivative_state,
        stops,
        integration_loop.loop_limits(coeffs, 1),
        finish_piece,
        partial(_observe_stop, coeffs, start_status),
    )
    status, contact, xv, derivatives_at_stop = stop_observations
    contact_and_xv = [jnp.moveaxis(array, 0, state.x.ndim) for array in (contact, *xv)]
    derivatives_at_stop = jax.tree.map(lambda array: jnp.moveaxis(array, 0, state.x.ndim), derivatives_at_stop)
    return (contact_and_xv[0], status[-1]), (tuple(contact_and_xv[1:]), *derivatives_at_stop)


def _time_order_status(times):
    """Return INVALID where times are not finite, negative or not in order, else OK."""
    are_times_in_order = jnp.all(jnp.isfinite(times), 0) & (times[0] >= 0) & jnp.all(times[1:] >= times[:-1], 0)
    return choose(are_times_in_order, lax.full_like(times[0], Status.OK), Status.INVALID)


def _make_stops(coeffs, state, times, is_flying_lane):
    """Return the `FlightStops` at the times; lanes that are not valid have flights of duration 0."""
    previous_times = jnp.concatenate([jnp.zeros_like(times[:1]), times[:-1]])
    flight_time, flight_time_low = (
        choose(is_flying_lane + (times < 0), time_part, 0.0) for time_part in two_sum(times, -previous_times)
    )
    min_first_time = float(jnp.finfo(times.dtype).tiny) ** MIN_TIME_EXPONENT
    flight_time = flight_time.at[0].set(choose(is_flying_lane, jnp.maximum(flight_time[0], min_first_time), 0.0))
    elapsed_angle = coeffs.frequency * times
    elapsed_cosine, elapsed_sine = flow.rotate_phasor_by_angle(
        jnp.cos(elapsed_angle), jnp.sin(elapsed_angle), dekker_product_error(coeffs.frequency, times, elapsed_angle)
    )
    start_cosine, start_sine = jnp.cos(state.phase), jnp.sin(state.phase)
    return FlightStops(
        flight_time,
        flight_time_low,
        elapsed_cosine * start_cosine - elapsed_sine * start_sine,
        elapsed_sine * start_cosine + elapsed_cosine * start_sine,
        None,
    )


def _observe_stop(coeffs, start_status, loop_state, derivative_state):
    """Return (status, contact, (x, v), derivatives) at a stop; results are nan where there is no state."""
    path = loop_state.path
    x, v = absolute_state(coeffs, path)
    status = choose(path.time_remaining == CAPPED, lax.full_like(x, Status.CAP), Status.OK)
    is_finite = jnp.isfinite(x) & jnp.isfinite(v) & jnp.isfinite(path.cosine)
    status = choose(is_finite, status, Status.NONFINITE)
    status = choose(start_status == Status.OK, status, start_status)
    has_state = status == Status.OK
    xv = tuple(choose(has_state, component, jnp.nan) for component in (x, v))
    derivatives_at_stop = (
        _fill_outside_mask(
            has_state & (derivative_state.are_derivatives_lost == 0), derivative_state.derivatives_at_stop, jnp.nan
        )
        if derivative_state
        else ()
    )
    return status, choose(has_state, reported_contact_code(path), 0.0), xv, derivatives_at_stop


def _fill_outside_mask(lane_mask, array_tree, fill_value):
    """Replace the entries of lanes outside a mask by a number."""
    return jax.tree.map(
        lambda array: jnp.where(
            lane_mask.reshape(*lane_mask.shape, *[1] * (array.ndim - lane_mask.ndim)), array, fill_value
        ),
        array_tree,
    )


def _reset_impact_log(flight_piece, loop_state, derivative_state):
    """Restart the log of impacts at time 0 for the next piece."""
    history_slots = 0 if loop_state.impact_slots.slots_since_release is None else REPLAY_SLOTS
    log, empty_impact_slots = impact_log.empty_log(loop_state.path.x, 0, flight_piece.duration, history_slots)
    return loop_state._replace(
        log=log,
        impact_slots=empty_impact_slots,
        release_time=jnp.full_like(loop_state.release_time, -1.0),
        n_steps=loop_state.n_steps * 0.0,
    ), derivative_state


def _initial_derivatives(request, x, zero):
    """Return the `PropagatedDerivatives` at the start of the flight."""
    x_argnum, n_argnums = request.tree.num_leaves - 4, len(request.argnums)

    def zeros_of_order(order):
        return jnp.zeros((*x.shape, *[n_argnums] * order), x.dtype)

    unit_tangents = [jnp.array([float(argnum == x_argnum + k) for argnum in request.argnums], x.dtype) for k in (0, 1)]
    first_derivatives = tuple(zeros_of_order(1) + unit_tangent for unit_tangent in unit_tangents)
    derivatives_by_order = (
        first_derivatives,
        *((zeros_of_order(k), zeros_of_order(k)) for k in range(2, request.order + 1)),
    )
    return PropagatedDerivatives(derivatives_by_order, derivatives_by_order, zero + 0.0 * x, zero + 0.0 * x)


def _replay_piece(request, leaves, start_status, flight_piece, loop_state, derivative_state):
    """Replay the impacts of a flight piece and propagate the derivatives to the end of the piece."""
    path, sample_delay_argnum = loop_state.path, request.tree.num_leaves - 1
    impact_times, speeds, n_impacts = impact_log.impacts_since_release(loop_state.log, loop_state.impact_slots)
    constant_coeffs = make_flow_coefficients(request.tree.unflatten(leaves)[0])
    is_sticking = abs(reported_contact_code(path)) == Contact.STUCK
    has_no_end_state = (path.time_remaining == CAPPED) | (start_status != Status.OK)
    are_derivatives_lost = has_no_end_state | ((n_impacts > REPLAY_SLOTS) & ~is_sticking)
    n_impacts = choose(are_derivatives_lost, -1.0, choose(is_sticking, 0.0, n_impacts))
    impacts = RecordedImpacts(
        impact_times, jnp.sign(speeds), n_impacts, loop_state.release_time, _end_contact_code(path)
    )
    start_xv = absolute_state(constant_coeffs, flight_piece.path)

    def replay_piece_end(*active_values):
        argument_increments = [value - lax.stop_gradient(value) for value in active_values]
        all_leaves = [*leaves[:-1], jnp.zeros_like(derivative_state.start_time)]
        for argnum, value in zip(request.argnums, active_values, strict=True):
            all_leaves[argnum] = value
        scene, state = request.tree.unflatten([*all_leaves[:-1], leaves[-1]])
        coeffs = make_flow_coefficients(scene)
        xv_derivatives = zip(*derivative_state.derivatives, strict=True)
        x, v = (
            _taylor_polynomial(value, component_derivatives, argument_increments)
            for value, component_derivatives in zip(start_xv, xv_derivatives, strict=True)
        )
        phase = state.phase + coeffs.frequency * derivative_state.start_time
        start_state = State(x, v, phase, reported_contact_code(flight_piece.path))
        return replay_duration(
            coeffs, start_state, impacts, flight_piece.duration + all_leaves[sample_delay_argnum], request.order
        )

    all_leaves = [*leaves[:-1], jnp.zeros_like(derivative_state.start_time)]
    derivatives_at_stop = make_with_derivatives(replay_piece_end, request.order)(
        *(all_leaves[argnum] for argnum in request.argnums)
    )[1:]
    is_independent_of_start = is_sticking | (loop_state.release_time >= 0)
    are_derivatives_lost = choose(
        are_derivatives_lost, 1.0, choose(is_independent_of_start, 0.0, derivative_state.are_derivatives_lost)
    )
    next_derivatives = _fill_outside_mask(
        are_derivatives_lost == 0,
        jax.tree.map(
            partial(_drop_time_derivatives, request.argnums, sample_delay_argnum, path.x.ndim), derivatives_at_stop
        ),
        0.0,
    )
    return _reset_impact_log(
        flight_piece,
        loop_state,
        PropagatedDerivatives(
            next_derivatives,
            derivatives_at_stop,
            derivative_state.start_time + flight_piece.duration,
            are_derivatives_lost,
        ),
    )


def _end_contact_code(path):
    """Return the contact code of lanes that stick or are within a soft wall, else 0."""
    contact_code = reported_contact_code(path)
    return choose(abs(contact_code) >= Contact.STUCK, contact_code, 0.0)


def _taylor_polynomial(value, derivatives, argument_increments):
    """Evaluate a Taylor polynomial, given by value and derivatives, at increments that are 0 but have derivatives."""
    polynomial = derivatives[-1]
    for order in range(len(derivatives), 0, -1):
        n_axes_of_term = polynomial.ndim - 1
        order_terms = [
            polynomial[..., k]
            * jnp.reshape(increment, (*jnp.shape(increment), *[1] * (n_axes_of_term - jnp.ndim(increment))))
            for k, increment in enumerate(argument_increments)
        ]
        polynomial = (derivatives[order - 2] if order > 1 else value) + sum(order_terms) / order
    return polynomial


def _drop_time_derivatives(argnums, sample_delay_argnum, n_lane_axes, tensor):
    """Set the derivatives with respect to the time of the sample to zero; later samples do not depend on this time."""
    argument_mask = jnp.array([float(argnum != sample_delay_argnum) for argnum in argnums], tensor.dtype)
    for axis in range(tensor.ndim - n_lane_axes):
        tensor = tensor * argument_mask.reshape(-1, *[1] * axis)
    return tensor


MIN_COMPILED_TIMES = 8  # smallest number of times to compile for; concrete times are padded to a power of two


@check.check_types
def sample(scene: Scene, state: State, times: Float[ArrayLike, "..."]) -> tuple[State, Int[Array, "..."]]:
    """Compute the states of a motion at given times.

    The map has derivatives of any order in forward and reverse mode.

    Parameters
    ----------
    scene : Scene
        Oscillator, drive and walls. A single scene or a batch.
    state : State
        Initial state at its phase. The fields broadcast with the fields of `scene`.
    times : array_like
        Times since the initial state, in t, of shape (n,) or (..., n). The times must not be negative and must not
        decrease along the last axis. The leading axes broadcast with `scene` and `state`.

    Returns
    -------
    states : State
        States of shape (..., n). The phase continues from the phase of `state`. The contact is defined as for `strobe`.
    status : Array of int
        Status of each lane, of shape (...), with the codes of `Impacts`: OK; CAP for 1,000 impacts or a million steps
        within a period, or for times beyond a million periods; INVALID for an invalid scene, a start beyond a wall or
        times that are not in order; NONFINITE. If the status is CAP or worse, unknown states are nan.

    Raises
    ------
    ArgumentError
        If concrete times are not finite, negative or not in order, if `state` or `times` does not broadcast, or if an
        argument is not a number.

    See Also
    --------
    simulate : Trajectory of one state at evenly spaced times, with the impacts.
    strobe : State after whole periods.

    Notes
    -----
    A sample at the time of an impact, up to rounding, is the state after the impact. The derivatives are one-sided:
    they are the limit of the derivatives at later times. At an entry into a soft wall or an exit from the wall, the
    contact shows whether the state and the derivatives belong to the motion before or after the event.

    Derivatives are with respect to x, v and the phase of the state, every number of the scene, and the times. A
    derivative is nan where the state is nan. If more than 32 impacts occur between two times and within a period,
    later derivatives are nan until the mass sticks. If the mass sticks, later states do not depend on the initial state
    or on the impacts before the mass sticks.

    Examples
    --------
    >>> states, status = jv.sample(scene, state, np.linspace(0.0, 2.0, 5))
    >>> np.asarray(states.x).round(4), int(status)
    (array([ 0.9   ,  0.4963,  0.2084, -0.3364, -0.8562]), 0)
    """
    state = make_state_arrays(scene, state)
    time_array = _validate_times(scene, state, times)
    n_times = time_array.shape[-1]
    is_traced = check.is_traced(*jax.tree.leaves((scene, state, time_array)))
    n_padded_times = (
        n_times if is_traced and n_times else max(MIN_COMPILED_TIMES, 1 << (n_times - 1).bit_length() if n_times else 0)
    )
    padded_times = (jnp if is_traced else np).concatenate(
        [time_array, _repeat_last_time(time_array, n_padded_times - n_times)], -1
    )
    leaves, treedef = jax.tree.flatten((scene, state))
    (contact, status), ((x, v), *_) = (
        differentiable_sample(SampleDerivativeRequest(treedef)) if is_traced else partial(_sample_concrete, treedef)
    )(*leaves, padded_times)
    x, v, contact = (array[..., :n_times] for array in (x, v, contact))
    phase = jnp.asarray(state.phase)[..., None] + jnp.asarray(scene.frequency)[..., None] * time_array
    phase = jnp.broadcast_to(phase, x.shape)
    return State(x, v, phase, contact), status.astype(jnp.int32)


@persistent_jit(static_argnums=0, compiler_options=COMPILER_OPTIONS)
def _compiled_sample(treedef, leaves, times):
    return sample_in_lane_blocks(SampleDerivativeRequest(treedef), *leaves, times)


def _sample_concrete(treedef, *arguments):
    return _compiled_sample(treedef, arguments[:-1], arguments[-1])


def _repeat_last_time(times, n_repeats):
    """Return the last time repeated `n_repeats` times, or zeros if there are no times."""
    if times.shape[-1]:
        return times[..., [-1] * n_repeats]
    return np.zeros((*times.shape[:-1], n_repeats), times.dtype)


def _validate_times(scene, state, times):
    """Validate the times and return an array of the floating-point type of the scene."""
    times = check.check_real_array("times", times, scene.dtype)
    if not times.ndim:
        raise check.ArgumentError("times", "must have at least one axis", times)
    shape = np.broadcast_shapes(scene.shape, *map(np.shape, jax.tree.leaves(state)))
    try:
        np.broadcast_shapes(shape, times.shape[:-1])
    except ValueError:
        rule_text = (
            f"must have a shape (..., n) whose leading axes broadcast with {shape}, the shape of scene and state"
        )
        raise check.ArgumentError("times", rule_text, times) from None
    if not check.is_traced(times):
        check.require("times", "must be finite", times, np.isfinite(times))
        check.require("times", "must not be negative", times, times >= 0)
        are_times_in_order = np.diff(times, axis=-1, prepend=0.0) >= 0
        check.require("times", "must be in order, each not less than the one before", times, are_times_in_order)
    return times
