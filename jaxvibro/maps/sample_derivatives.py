"""States of a sample and their derivatives of any order: each piece of the flight is replayed right after it.

Derivatives pass from piece to piece as a Taylor polynomial of x and v in the active arguments: a replay that starts
with it gives the polynomial at the end of the piece. The times at which pieces end are constants. One additional
argument is the delay of a sample from its stop; a sample depends on its own time through this delay only.
"""

from functools import cache, partial
from itertools import repeat
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Float

from ..compiled.blocks import run_in_blocks, vmap_as_lanes
from ..compiled.compiler_hints import choose, two_sum
from ..compiled.kernels import call_as_kernel
from ..flight import flow, impact_log, integrate
from ..flight.coefficients import compute_coefficients, dekker_product_error
from ..flight.entry import start_path
from ..flight.flight_state import CAPPED, absolute_state
from ..scene.codes import Contact, Status
from ..scene.state import State
from .derivative_tensors import active_argnums, contract_tangents, select_argnums
from .one_period import REPLAY_SLOTS, reported_contact
from .replay import RecordedImpacts, replay_duration
from .replay_derivatives import with_derivatives
from .stops import Stops, fly_to_stops

MAX_PERIODS = 1e6  # limit of the last time: beyond it the call would seem to hang
MIN_TIME_EXPONENT = 0.5  # a time 0 is replaced by tiny**0.5, so that an impact at the start is included


class SampleRequest(NamedTuple):
    """Static options of a sample with derivatives.

    `tree` is that of (scene, state), and `order` that of the derivatives. `argnums` are the indices of the arguments of
    differentiation, among the leaves without the contact, then the times.
    """

    tree: jax.tree_util.PyTreeDef
    order: int = 0
    argnums: tuple[int, ...] = ()


class DerivativeState(NamedTuple):
    """Derivatives that are carried along the flight.

    `derivatives` are those of (x, v), order 1 first, with one last axis for each differentiation. `at_stop` holds the
    same at the last stop, with derivatives with respect to its own time. `start_time` is the time since the start.
    `is_lost` is 1 where there are no derivatives.
    """

    derivatives: tuple[tuple[Float[jax.Array, "..."], Float[jax.Array, "..."]], ...]
    at_stop: tuple[tuple[Float[jax.Array, "..."], Float[jax.Array, "..."]], ...]
    start_time: Float[jax.Array, "..."]
    is_lost: Float[jax.Array, "..."]


@cache
def differentiable_sample(request):
    """Return the function that maps leaves and times to ((contact, status), ((x, v), derivatives of order 1, ...)).

    All results are real. Lanes come first, then the times; the status has lanes only.
    """
    inner = jax.jit(partial(sample_in_blocks, request))
    run = jax.custom_jvp(vmap_as_lanes(lambda *arguments: inner(*arguments), n_rows=1))

    def jvp_rule(primals, tangents):
        active_indices = active_argnums(_move_contact_last(tangents))
        if not active_indices:
            outputs = run(*primals)
            return outputs, jax.tree.map(jnp.zeros_like, outputs)
        higher_request = request._replace(
            order=request.order + 1, argnums=tuple(sorted({*request.argnums, *active_indices}))
        )
        contact_and_status, tensors = differentiable_sample(higher_request)(*primals)
        values = tuple(
            select_argnums(array, higher_request, [*repeat(request.argnums, order)])
            for order, array in enumerate(tensors[:-1])
        )
        jacobians = (
            select_argnums(array, higher_request, [*repeat(request.argnums, order), active_indices])
            for order, array in enumerate(tensors[1:])
        )
        primals_and_tangents = [_add_time_axis(_move_contact_last(array)) for array in (primals, tangents)]
        tangents_out = tuple(contract_tangents(array, *primals_and_tangents) for array in jacobians)
        return (contact_and_status, values), (jax.tree.map(jnp.zeros_like, contact_and_status), tangents_out)

    run.defjvp(jvp_rule, symbolic_zeros=True)
    return run


def _move_contact_last(arguments):
    """Move the contact behind the arguments of differentiation."""
    return (*arguments[:-2], arguments[-1], arguments[-2])


def _add_time_axis(arguments):
    """Add an axis for the times to the arguments of lanes."""
    *leaves, times, contact = arguments
    widened = [leaf if isinstance(leaf, SymbolicZero) else jnp.asarray(leaf)[..., None] for leaf in leaves]
    return (*widened, times, contact)


def sample_in_blocks(request, *arguments):
    """Evaluate the results of `differentiable_sample` block by block."""
    *leaves, times = arguments
    _, state = request.tree.unflatten(leaves)
    shape = jnp.broadcast_shapes(*map(jnp.shape, leaves), times.shape[:-1])
    leaves[request.tree.num_leaves - 4] = jnp.broadcast_to(state.x, shape)
    n_times, n_argnums = times.shape[-1], len(request.argnums)

    def empty_results(n_lanes):
        shapes = [(n_lanes, n_times, *[n_argnums] * order) for order in range(request.order + 1)]
        pairs = tuple(
            (jnp.zeros(array_shape, times.dtype), jnp.zeros(array_shape, times.dtype)) for array_shape in shapes
        )
        return (jnp.zeros((n_lanes, n_times), times.dtype), jnp.zeros(n_lanes, times.dtype)), pairs

    def run(leaves, times):
        return call_as_kernel(_sample_block, leaves, times, request=request)

    return run_in_blocks(run, leaves, empty_results, 1, [jnp.broadcast_to(times, (*shape, n_times))])


def _sample_block(leaves, times, request):
    """Evaluate the results of one block."""
    scene, state = request.tree.unflatten(leaves)
    times = jnp.moveaxis(times, -1, 0)
    coeffs = compute_coefficients(scene)
    path, entry_status = start_path(coeffs, state)
    entry_status = choose(entry_status == Status.OK, _time_order_status(times), entry_status)
    is_too_long = times[-1] > MAX_PERIODS * coeffs.period
    path = path._replace(time_remaining=choose(is_too_long & (entry_status == Status.OK), CAPPED, path.time_remaining))
    stops = _make_stops(coeffs, state, times, (entry_status == Status.OK) & ~is_too_long)
    loop = integrate.initial_loop_state(
        coeffs, path, 0, coeffs.period + 0.0 * path.x, n_since_release=REPLAY_SLOTS if request.order else 0
    )
    derivatives = _initial_derivatives(request, path.x, stops.span[0] * 0.0) if request.order else ()
    after_piece = partial(_replay_piece, request, leaves, entry_status) if request.order else _reset_log
    (loop, _), observations = fly_to_stops(
        coeffs,
        loop,
        derivatives,
        stops,
        integrate.loop_limits(coeffs, 1),
        after_piece,
        partial(_observe_stop, coeffs, entry_status),
    )
    status, contact, xv, at_stop = observations
    arrays = [jnp.moveaxis(array, 0, state.x.ndim) for array in (contact, *xv)]
    at_stop = jax.tree.map(lambda array: jnp.moveaxis(array, 0, state.x.ndim), at_stop)
    return (arrays[0], status[-1]), (tuple(arrays[1:]), *at_stop)


def _time_order_status(times):
    """Return INVALID where times are not finite, negative or not in order, else OK."""
    is_in_order = jnp.all(jnp.isfinite(times), 0) & (times[0] >= 0) & jnp.all(times[1:] >= times[:-1], 0)
    return choose(is_in_order, lax.full_like(times[0], Status.OK), Status.INVALID)


def _make_stops(coeffs, state, times, is_valid):
    """Return the `Stops` at the times; lanes that are not valid do not fly."""
    previous_times = jnp.concatenate([jnp.zeros_like(times[:1]), times[:-1]])
    span, span_low = (choose(is_valid + (times < 0), time_part, 0.0) for time_part in two_sum(times, -previous_times))
    min_time = float(jnp.finfo(times.dtype).tiny) ** MIN_TIME_EXPONENT
    span = span.at[0].set(choose(is_valid, jnp.maximum(span[0], min_time), 0.0))
    angle = coeffs.frequency * times
    cosine, sine = flow.rotate_by_angle(
        jnp.cos(angle), jnp.sin(angle), dekker_product_error(coeffs.frequency, times, angle)
    )
    start_cosine, start_sine = jnp.cos(state.phase), jnp.sin(state.phase)
    return Stops(
        span, span_low, cosine * start_cosine - sine * start_sine, sine * start_cosine + cosine * start_sine, None
    )


def _observe_stop(coeffs, entry_status, loop, derivatives):
    """Return (status, contact, (x, v), derivatives) at a stop, nan where there is no state."""
    path = loop.path
    x, v = absolute_state(coeffs, path)
    status = choose(path.time_remaining == CAPPED, lax.full_like(x, Status.CAP), Status.OK)
    is_finite = jnp.isfinite(x) & jnp.isfinite(v) & jnp.isfinite(path.cosine)
    status = choose(is_finite, status, Status.NONFINITE)
    status = choose(entry_status == Status.OK, status, entry_status)
    is_valid = status == Status.OK
    xv = tuple(choose(is_valid, component, jnp.nan) for component in (x, v))
    at_stop = _where_lanes(is_valid & (derivatives.is_lost == 0), derivatives.at_stop, jnp.nan) if derivatives else ()
    return status, choose(is_valid, reported_contact(path), 0.0), xv, at_stop


def _where_lanes(mask, tree, fill_value):
    """Replace the arrays of lanes outside a mask by a number."""
    return jax.tree.map(
        lambda array: jnp.where(mask.reshape(*mask.shape, *[1] * (array.ndim - mask.ndim)), array, fill_value), tree
    )


def _reset_log(piece, loop, derivatives):
    """Restart the log of impacts at time 0 for the next piece."""
    history_slots = 0 if loop.impact_slots.since_release is None else REPLAY_SLOTS
    log, slots = impact_log.empty_log(loop.path.x, 0, piece.length, history_slots)
    return loop._replace(
        log=log, impact_slots=slots, release_time=jnp.full_like(loop.release_time, -1.0), n_steps=loop.n_steps * 0.0
    ), derivatives


def _initial_derivatives(request, x, zero):
    """Return the `DerivativeState` of the start."""
    x_argnum, n_argnums = request.tree.num_leaves - 4, len(request.argnums)

    def zeros_of_order(order):
        return jnp.zeros((*x.shape, *[n_argnums] * order), x.dtype)

    unit_rows = [jnp.array([float(argnum == x_argnum + k) for argnum in request.argnums], x.dtype) for k in (0, 1)]
    first_order = tuple(zeros_of_order(1) + row for row in unit_rows)
    all_orders = (first_order, *((zeros_of_order(k), zeros_of_order(k)) for k in range(2, request.order + 1)))
    return DerivativeState(all_orders, all_orders, zero + 0.0 * x, zero + 0.0 * x)


def _replay_piece(request, leaves, entry_status, piece, loop, derivatives):
    """Replay the impacts of a piece and propagate the derivatives through it."""
    path, (impact_times, speeds, count) = loop.path, impact_log.impacts_since_release(loop.log, loop.impact_slots)
    times_argnum, base_coeffs = request.tree.num_leaves - 1, compute_coefficients(request.tree.unflatten(leaves)[0])
    contact = reported_contact(path)
    end_contact = choose(abs(contact) >= Contact.STUCK, contact, 0.0)
    has_no_end = (path.time_remaining == CAPPED) | (entry_status != Status.OK)
    is_sticking = abs(contact) == Contact.STUCK
    is_lost = has_no_end | ((count > REPLAY_SLOTS) & ~is_sticking)
    count = choose(is_lost, -1.0, choose(is_sticking, 0.0, count))
    impacts = RecordedImpacts(impact_times, jnp.sign(speeds), count, loop.release_time, end_contact)
    start_xv = absolute_state(base_coeffs, piece.path)

    def piece_end(*active_values):
        increments = [value - lax.stop_gradient(value) for value in active_values]
        all_leaves = [*leaves[:-1], jnp.zeros_like(derivatives.start_time)]
        for argnum, value in zip(request.argnums, active_values, strict=True):
            all_leaves[argnum] = value
        scene, state = request.tree.unflatten([*all_leaves[:-1], leaves[-1]])
        coeffs = compute_coefficients(scene)
        derivative_rows = zip(*derivatives.derivatives, strict=True)
        x, v = (
            _taylor_polynomial(value, orders, increments)
            for value, orders in zip(start_xv, derivative_rows, strict=True)
        )
        phase = state.phase + coeffs.frequency * derivatives.start_time
        start_state = State(x, v, phase, reported_contact(piece.path))
        return replay_duration(coeffs, start_state, impacts, piece.length + all_leaves[times_argnum], request.order)

    all_leaves = [*leaves[:-1], jnp.zeros_like(derivatives.start_time)]
    at_stop = with_derivatives(piece_end, request.order)(*(all_leaves[argnum] for argnum in request.argnums))[1:]
    forgets_start = is_sticking | (loop.release_time >= 0)
    is_lost = choose(is_lost, 1.0, choose(forgets_start, 0.0, derivatives.is_lost))
    next_derivatives = _where_lanes(
        is_lost == 0,
        jax.tree.map(partial(_drop_time_derivatives, request.argnums, times_argnum, path.x.ndim), at_stop),
        0.0,
    )
    return _reset_log(
        piece, loop, DerivativeState(next_derivatives, at_stop, derivatives.start_time + piece.length, is_lost)
    )


def _taylor_polynomial(value, derivatives, increments):
    """Evaluate a value with its derivatives of order 1, ... as a polynomial of the increments, which are 0."""
    total = derivatives[-1]
    for order in range(len(derivatives), 0, -1):
        n_axes = total.ndim - 1
        terms = [
            total[..., k] * jnp.reshape(increment, (*jnp.shape(increment), *[1] * (n_axes - jnp.ndim(increment))))
            for k, increment in enumerate(increments)
        ]
        total = (derivatives[order - 2] if order > 1 else value) + sum(terms) / order
    return total


def _drop_time_derivatives(argnums, times_argnum, n_lane_axes, tensor):
    """Set the derivatives with respect to the time of the sample to zero; no later sample depends on it."""
    mask = jnp.array([float(argnum != times_argnum) for argnum in argnums], tensor.dtype)
    for axis in range(tensor.ndim - n_lane_axes):
        tensor = tensor * mask.reshape(-1, *[1] * axis)
    return tensor
