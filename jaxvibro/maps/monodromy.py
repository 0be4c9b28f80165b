"""Monodromy matrix as a product of flight and saltation matrices (paper, (37)), without automatic differentiation.

A flight of duration t has the matrix P(t) of the free flow. An impact on a rigid wall has the saltation matrix Q, which
follows from the impact law and from the condition that defines the time of the impact. In a soft wall the matrix of the
contact phase replaces Q. With u = v- - v_b,

    Q = ((-R, 0), ((a+ + R a- - (1 + R) a_b) / u, -R)),

where v- is the velocity before the impact, a- and a+ are the accelerations before and after the impact, v_b and a_b are
the velocity and acceleration of the wall, and R is the coefficient of restitution. If the mass sticks, its later state
does not depend on the initial state, and the monodromy matrix is zero.
"""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.kernel_calls import call_as_kernel
from ..compiled.lane_arithmetic import COMPILER_OPTIONS, call_without_inlining, choose
from ..compiled.lane_blocks import MIN_LANES, run_in_blocks, vmap_as_lanes
from ..contact.contact_duration import multiply_2x2_matrices
from ..contact.end_time_and_contact import EndTimeAndContact
from ..contact.kinds import make_flow_coefficients
from ..contact.monodromy_state import MonodromyState
from ..flight.impact import wall_state_and_force
from ..flight.motion_in_soft_wall import is_soft_side, soft_walls
from ..flight.motion_in_soft_wall import restitution_of as restitution
from ..flight.taylor_polynomials import ExpansionPoint
from ..flight.wall_motion import subtract_optional, wall_jet_on_side
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import Contact, State, Status, make_state_arrays
from . import reference_strobe
from .reference_strobe import REPLAY_SLOTS


@check.check_types
def monodromy(
    scene: Scene, state: State, periods: int = 1, slots: int = REPLAY_SLOTS
) -> Float[jax.Array, "*lanes 2 2"]:
    """Compute the monodromy matrix, the derivative of the final state with respect to the initial state.

    The matrix is the product of the flight matrices and the saltation matrices of the impacts (paper, (37)).

    Parameters
    ----------
    scene : Scene
        Oscillator, drive and walls. A single scene or a batch.
    state : State
        Initial state at its phase. The fields broadcast with the fields of `scene`.
    periods : int, optional
        Number of drive periods, at least 1.
    slots : int, optional
        Largest average number of impacts per period, at least 1.

    Returns
    -------
    Array of shape (..., 2, 2)
        Derivative of the final (x, v), by rows, with respect to the initial (x, v). It is nan if the status is CAP or
        worse, or if there are more than `slots` impacts per period on average and the mass does not stick. The matrix
        is zero if the mass sticks to a wall. At a grazing the derivative does not exist, and the entries are inf or
        nan.

    Raises
    ------
    ArgumentError
        If the arguments are invalid, as for `strobe`.
    TypeError
        If the result is differentiated. Use derivatives of `strobe` instead.

    See Also
    --------
    strobe : The map, with derivatives of any order.
    Orbit : Periodic orbit with its multipliers.

    Examples
    --------
    The eigenvalues over one period of an orbit are its Floquet multipliers.

    >>> matrix = jv.monodromy(orbit.scene, orbit.state, orbit.periods)
    >>> np.linalg.eigvals(matrix).round(6)
    array([-0.235309+0.350203j, -0.235309-0.350203j])
    """
    periods, slots = check.check_whole_number("periods", periods, 1), check.check_whole_number("slots", slots, 1)
    leaves, treedef = jax.tree.flatten((scene, make_state_arrays(scene, state)))
    is_traced = check.is_traced(*leaves)
    return (_traced_monodromy if is_traced else _compiled_monodromy)(treedef, periods, slots * periods)(*leaves)


@cache
def _traced_monodromy(treedef, periods, slots):
    monodromy_of_leaves = jax.custom_jvp(
        vmap_as_lanes(jax.jit(partial(_matrices_in_blocks, treedef, periods, slots, 1)))
    )

    @monodromy_of_leaves.defjvp
    def raise_jvp_error(primals, tangents):
        raise TypeError("monodromy has no derivatives; differentiate jax.jacfwd of strobe instead")

    return monodromy_of_leaves


@cache
def _compiled_monodromy(treedef, periods, slots):
    return jax.jit(partial(_matrices_in_blocks, treedef, periods, slots, MIN_LANES), compiler_options=COMPILER_OPTIONS)


def _matrices_in_blocks(treedef, periods, slots, min_lanes, *leaves):
    """Compute the matrices of all lanes block by block."""
    scene, state = treedef.unflatten(leaves)
    shape = jnp.broadcast_shapes(*map(jnp.shape, leaves))

    def run_block(arguments):
        matrix_entries = call_as_kernel(_block_monodromy, *arguments, periods=periods, slots=slots)
        return jnp.stack(matrix_entries, -1).reshape(*matrix_entries[0].shape, 2, 2)

    arguments = scene, replace(state, x=jnp.broadcast_to(state.x, shape))
    return run_in_blocks(run_block, arguments, lambda n_lanes: jnp.zeros((n_lanes, 2, 2), scene.dtype), min_lanes)


def _block_monodromy(scene, state, periods, slots):
    """Compute the matrices of a block of lanes by rows."""
    return strobe_with_monodromy(scene, state, periods, slots)[2]


def strobe_with_monodromy(scene, state, periods, slots, clearance=False):
    """Evaluate the map and its monodromy matrix for a block of lanes, within one kernel.

    Parameters
    ----------
    scene, state : Scene, State
        Scene and state of the lanes, as for `strobe_with_matrix_state`.
    periods : int
        Number of drive periods.
    slots : int
        Number of impacts to record in all periods.
    clearance : bool, optional
        Measure the least clearance.

    Returns
    -------
    end : State
        State after the last period.
    impacts : Impacts
        Recorded impacts.
    matrix : list of array
        Four entries of the monodromy matrix by rows: nan where the matrix is undefined, 0 where the mass sticks.
    """
    end_state, impacts, has_stuck, monodromy_state = strobe_with_matrix_state(scene, state, periods, slots, clearance)
    is_undefined_matrix = (impacts.status >= Status.CAP) | ((impacts.count > slots) & ~has_stuck)
    return (
        end_state,
        impacts,
        [
            choose(is_undefined_matrix, jnp.nan, choose(has_stuck, 0.0, matrix_entry))
            for matrix_entry in monodromy_state.matrix
        ],
    )


def strobe_with_matrix_state(scene, state, periods, slots, clearance=False):
    """Evaluate the map and the product of matrices for a block of lanes, within one kernel.

    Parameters
    ----------
    scene, state : Scene, State
        Scene and state of the lanes. ``state.x`` has the shape of the lanes; other fields are scalars or have this
        shape.
    periods : int
        Number of drive periods.
    slots : int
        Number of impacts to record in all periods.
    clearance : bool, optional
        Measure the least clearance.

    Returns
    -------
    end : State
        State after the last period.
    impacts : Impacts
        Recorded impacts.
    is_sticking : array of bool
        True if the mass sticks at some time, which makes the monodromy matrix zero.
    monodromy_state : MonodromyState
        State at the end with the product of the matrices P and Q. The product is meaningless if the status is CAP or
        worse, or if there are more than `slots` impacts.
    """
    (end_state, impacts), (release_time, *_) = reference_strobe.strobe_with_history(
        scene, state, periods, slots, clearance
    )
    has_stuck = (abs(end_state.contact) == Contact.STUCK) | (abs(state.contact) == Contact.STUCK) | (release_time >= 0)
    return (
        end_state,
        impacts,
        has_stuck,
        _multiply_path_matrices(scene, state, impacts, end_state.contact, periods, slots),
    )


def _multiply_path_matrices(scene, state, impacts, end_contact_code, periods, slots):
    """Return the final `MonodromyState`: the product of the matrices of all flights, impacts and contact phases."""
    coeffs, zero = make_flow_coefficients(scene), lax.full_like(end_contact_code, 0.0)
    impact_rows = impacts.time, impacts.side.astype(zero.dtype), impacts.speed
    impact_rows = [jnp.moveaxis(slot_array, -1, 0) for slot_array in impact_rows]
    n_impacts = lax.min(jnp.max(impacts.count), jnp.int32(slots)) if coeffs.walls else jnp.int32(0)
    has_end = impacts.status < Status.CAP

    def advance_to_next_impact(carry):
        """Pass a contact phase if one is due, then fly to the next impact, or to the end after the last impact."""
        impact_index, relative_state, current_state = carry
        if relative_state:
            current_state = coeffs.contact.propagate_contact_phase(
                coeffs, relative_state, impact_index > 0, EndTimeAndContact(end_time, end_contact_code), current_state
            )
        impact_time, side, speed = (lax.dynamic_index_in_dim(row, impact_index, keepdims=False) for row in impact_rows)
        is_after_last_impact = impact_index == n_impacts
        is_impact = (side != 0) & ~is_after_last_impact
        flight_time = choose(
            is_after_last_impact,
            end_time - current_state.time,
            choose(is_impact, impact_time - current_state.time, 0.0),
        )
        # a lane without an end may start beyond a wall, where a force can be stiff or unstable
        flight_time = choose(has_end, flight_time, 0.0)
        xv, drive_cosine, drive_sine, flight_matrix = coeffs.flow.propagate_with_matrix(
            coeffs, current_state.xv, current_state.cosine, current_state.sine, flight_time
        )
        matrix = multiply_2x2_matrices(flight_matrix, current_state.matrix)
        if coeffs.walls:
            xv, matrix = _pass_impact(coeffs, is_impact, side, speed, drive_cosine, drive_sine, xv, matrix)
        if relative_state:
            relative_state = (
                choose(is_impact & is_soft_side(coeffs, side), side * Contact.ENTERED, 0.0),
                zero,
                side * speed,
            )
        time = current_state.time + flight_time
        next_state = MonodromyState(time, xv, drive_cosine, drive_sine, matrix, current_state.total_contact_times)
        return impact_index + 1, relative_state, next_state

    drive_cosine, drive_sine = jnp.cos(state.phase) + zero, jnp.sin(state.phase) + zero
    end_time, identity_entries = zero + periods * coeffs.period, (zero + 1.0, zero, zero, zero + 1.0)
    xv = state.x + zero, state.v + zero
    relative_state = coeffs.contact.initial_phase(
        coeffs, ExpansionPoint(*xv, drive_cosine, drive_sine, zero), state.contact
    )
    total_contact_times = (zero,) * len(soft_walls(coeffs))
    start_state = MonodromyState(
        zero, coeffs.flow.matrix_state(*xv), drive_cosine, drive_sine, identity_entries, total_contact_times
    )
    return lax.while_loop(
        lambda carry: carry[0] <= n_impacts, advance_to_next_impact, (jnp.int32(0), relative_state, start_state)
    )[-1]


def _pass_impact(coeffs, is_impact, side, speed, drive_cosine, drive_sine, xv, matrix):
    """Return (x, v) and the matrix after the impact for lanes that hit a wall, unchanged for other lanes."""
    zero = lax.full_like(speed, 0.0)
    restitution_coeff, saltation_shear = call_without_inlining(
        saltation_entries, coeffs, side, speed, drive_cosine, drive_sine
    )
    matrix_after_impact = multiply_2x2_matrices((-restitution_coeff, zero, saltation_shear, -restitution_coeff), matrix)
    matrix = tuple(choose(is_impact, new, old) for new, old in zip(matrix_after_impact, matrix, strict=True))
    if xv:
        xv = _state_after_impact(coeffs, is_impact, side, speed, restitution_coeff, drive_cosine, drive_sine, xv)
    return xv, matrix


def _state_after_impact(coeffs, is_impact, side, speed, restitution_coeff, drive_cosine, drive_sine, xv):
    """Return (x, v) after the impact for lanes that hit a wall, and `xv` for other lanes."""
    wall_side = choose(is_impact, side, lax.full_like(side, float(coeffs.walls[0].sign)))
    wall_position, wall_velocity = wall_state_and_force(coeffs, wall_side, drive_cosine, drive_sine)[:2]
    x, v = xv
    return choose(is_impact, wall_position, x), choose(is_impact, wall_velocity - restitution_coeff * side * speed, v)


def saltation_entries(coeffs, side, speed, drive_cosine, drive_sine):
    """Return R and the lower left entry of the saltation matrix Q of an impact; arbitrary values for side 0."""
    wall_position, wall_velocity, wall_acceleration = wall_jet_on_side(coeffs, side, drive_cosine, drive_sine, 2)
    restitution_coeff = restitution(coeffs, side) + 0.0 * speed
    wall_velocity = 0.0 if wall_velocity is None else wall_velocity
    approach_velocity = side * speed
    acceleration_and_jerk_of = coeffs.flow.acceleration_and_jerk
    mass_accel_before, _ = acceleration_and_jerk_of(
        coeffs, wall_position, wall_velocity + approach_velocity, drive_cosine, drive_sine
    )
    mass_accel_after, _ = acceleration_and_jerk_of(
        coeffs, wall_position, wall_velocity - restitution_coeff * approach_velocity, drive_cosine, drive_sine
    )
    weighted_accelerations = mass_accel_after + restitution_coeff * mass_accel_before
    return restitution_coeff, subtract_optional(
        weighted_accelerations, None if wall_acceleration is None else (1.0 + restitution_coeff) * wall_acceleration
    ) / approach_velocity
