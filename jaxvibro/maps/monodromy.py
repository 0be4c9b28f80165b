"""Compute the monodromy matrix as a product of flight and saltation matrices (paper, (37)), without autodiff.

P(t) is the matrix of the free flow. The saltation matrix Q follows from the impact law and from the condition that
defines the time of the impact. With u = v- - v_b,

    Q = ((-R, 0), ((a+ + R a- - (1 + R) a_b) / u, -R)),

where a- and a+ are the accelerations before and after the impact, and v_b and a_b are the velocity and acceleration of
the wall. If the mass sticks, its state does not depend on its past: M = 0.
"""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.blocks import MIN_LANES, run_in_blocks, vmap_as_lanes
from ..compiled.compiler_hints import COMPILER_OPTIONS, choose, stage
from ..compiled.kernels import call_as_kernel
from ..flight.coefficients import ContactLaw, compute_coefficients
from ..flight.flows import flow_of
from ..flight.impact import wall_surface
from ..flight.soft_contact import is_soft_side
from ..flight.soft_contact import restitution_of as restitution
from ..flight.taylor import ExpansionPoint
from ..flight.wall_motion import subtract, wall_jet_on_side
from ..scene import check
from ..scene.codes import Contact, Status
from ..scene.scene import Scene
from ..scene.state import State, state_arrays
from . import force_law_matrix, initial_contact, linear_contact_matrix, one_period
from .contact_duration import matrix_product
from .monodromy_state import MonodromyState
from .one_period import REPLAY_SLOTS
from .path_end import PathEnd

CONTACT_PASSAGES = {
    ContactLaw.RIGID: None,
    ContactLaw.LINEAR: linear_contact_matrix.pass_contact_phase,
    ContactLaw.FORCE_LAW: force_law_matrix.pass_contact_phase,
}


@check.check_types
def monodromy(
    scene: Scene, state: State, periods: int = 1, slots: int = REPLAY_SLOTS
) -> Float[jax.Array, "*lanes 2 2"]:
    """Compute the monodromy matrix: the derivative of the end state by the initial state.

    The matrix is the product of the flight matrices and the saltation matrices of the impacts (paper, (37)).

    Parameters
    ----------
    scene : Scene
        Oscillator, drive and walls. A single scene or a batch.
    state : State
        Initial state at its phase; its numbers broadcast with those of `scene`.
    periods : int, optional
        Number of drive periods, at least 1.
    slots : int, optional
        Largest number of impacts per period, at least 1.

    Returns
    -------
    Array of shape (..., 2, 2)
        Derivative of the final (x, v), by rows, with respect to the initial (x, v). It is nan if the status is CAP or
        worse, or if there are more than `slots` impacts per period and the mass does not stick. It is zero if the mass
        sticks to a wall. At a grazing the derivative does not exist, and the entries are inf or nan.

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
    periods, slots = check.whole_number("periods", periods, 1), check.whole_number("slots", slots, 1)
    leaves, tree = jax.tree.flatten((scene, state_arrays(scene, state)))
    is_traced = check.is_traced(*leaves)
    return (_traced_monodromy if is_traced else _compiled_monodromy)(tree, periods, slots * periods)(*leaves)


@cache
def _traced_monodromy(tree, periods, slots):
    run = jax.custom_jvp(vmap_as_lanes(jax.jit(partial(_matrices_in_blocks, tree, periods, slots, 1))))

    @run.defjvp
    def _(primals, tangents):
        raise TypeError("monodromy has no derivatives; differentiate jax.jacfwd of strobe instead")

    return run


@cache
def _compiled_monodromy(tree, periods, slots):
    return jax.jit(partial(_matrices_in_blocks, tree, periods, slots, MIN_LANES), compiler_options=COMPILER_OPTIONS)


def _matrices_in_blocks(tree, periods, slots, min_lanes, *leaves):
    """Compute the matrices of all lanes block by block."""
    scene, state = tree.unflatten(leaves)
    shape = jnp.broadcast_shapes(*map(jnp.shape, leaves))

    def run(arguments):
        entries = call_as_kernel(_block_monodromy, *arguments, periods=periods, slots=slots)
        return jnp.stack(entries, -1).reshape(*entries[0].shape, 2, 2)

    arguments = scene, replace(state, x=jnp.broadcast_to(state.x, shape))
    return run_in_blocks(run, arguments, lambda n_lanes: jnp.zeros((n_lanes, 2, 2), scene.dtype), min_lanes)


def _block_monodromy(scene, state, periods, slots):
    """Compute the matrices of a block of lanes by rows."""
    return strobe_with_monodromy(scene, state, periods, slots)[2]


def strobe_with_monodromy(scene, state, periods, slots, clearance=False):
    """Evaluate the map and its monodromy matrix for a block of lanes, within one kernel.

    Parameters
    ----------
    scene, state : Scene, State
        Numbers of the lanes, as for `strobe_with_product`.
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
        The four entries of the monodromy matrix by rows: nan where it is undefined, zero where the mass sticks.
    """
    end, impacts, is_sticking, monodromy_state = strobe_with_product(scene, state, periods, slots, clearance)
    is_undefined = (impacts.status >= Status.CAP) | ((impacts.count > slots) & ~is_sticking)
    return (
        end,
        impacts,
        [choose(is_undefined, jnp.nan, choose(is_sticking, 0.0, entry)) for entry in monodromy_state.matrix],
    )


def strobe_with_product(scene, state, periods, slots, clearance=False):
    """Evaluate the map and the product of matrices for a block of lanes, within one kernel.

    Parameters
    ----------
    scene, state : Scene, State
        Numbers of the lanes. ``state.x`` has the shape of the lanes; other numbers are scalars or have this shape.
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
        State at the end with the product of P and Q. It has no meaning for a status from CAP on, or with more than
        `slots` impacts.
    """
    (end, impacts), (release_time, *_) = one_period.strobe_with_history(scene, state, periods, slots, clearance)
    is_sticking = (abs(end.contact) == Contact.STUCK) | (abs(state.contact) == Contact.STUCK) | (release_time >= 0)
    return end, impacts, is_sticking, _monodromy_product(scene, state, impacts, end.contact, periods, slots)


def _monodromy_product(scene, state, impacts, end_contact, periods, slots):
    """Multiply the matrices of all flights, impacts and contact phases; `end_contact` is the contact at the end."""
    coeffs, zero = compute_coefficients(scene), lax.full_like(end_contact, 0.0)
    flow, pass_contact = flow_of(coeffs), CONTACT_PASSAGES[coeffs.contact_law]
    impact_rows = impacts.time, impacts.side.astype(zero.dtype), impacts.speed
    impact_rows = [jnp.moveaxis(entry, -1, 0) for entry in impact_rows]
    n_impacts = lax.min(jnp.max(impacts.count), jnp.int32(slots)) if coeffs.walls else jnp.int32(0)

    def step_impact(carry):
        """Pass a contact phase if one is due, then fly to the next impact, or to the end after the last impact."""
        k, relative_state, current = carry
        if relative_state:
            current = pass_contact(coeffs, relative_state, k > 0, PathEnd(end_time, end_contact), current)
        time, side, speed = (lax.dynamic_index_in_dim(row, k, keepdims=False) for row in impact_rows)
        is_last = k == n_impacts
        is_impact = (side != 0) & ~is_last
        flight_time = choose(is_last, end_time - current.time, choose(is_impact, time - current.time, 0.0))
        xv, cosine, sine, flight_matrix = flow.propagate_matrix(
            coeffs, current.xv, current.cosine, current.sine, flight_time
        )
        matrix = matrix_product(flight_matrix, current.matrix)
        if coeffs.walls:
            restitution_coeff, shear = stage(saltation_entries, coeffs, side, speed, cosine, sine)
            impact_matrix = matrix_product((-restitution_coeff, zero, shear, -restitution_coeff), matrix)
            matrix = tuple(choose(is_impact, new, old) for new, old in zip(impact_matrix, matrix, strict=True))
        if coeffs.walls and xv:
            xv = _state_after_impact(coeffs, is_impact, side, speed, restitution_coeff, cosine, sine, xv)
        if relative_state:
            relative_state = (
                choose(is_impact & is_soft_side(coeffs, side), side * Contact.ENTERED, 0.0),
                zero,
                side * speed,
            )
        return (
            k + 1,
            relative_state,
            MonodromyState(current.time + flight_time, xv, cosine, sine, matrix, current.contact_times),
        )

    cosine, sine = jnp.cos(state.phase) + zero, jnp.sin(state.phase) + zero
    end_time, identity = zero + periods * coeffs.period, (zero + 1.0, zero, zero, zero + 1.0)
    xv = () if flow.LINEAR and not pass_contact else (state.x + zero, state.v + zero)
    relative_state = (
        initial_contact.initial_relative_state(coeffs, ExpansionPoint(*xv, cosine, sine, zero), state.contact)
        if pass_contact
        else ()
    )
    contact_times = tuple(zero for entry in coeffs.soft_flows if entry is not None)
    start = MonodromyState(zero, () if flow.LINEAR else xv, cosine, sine, identity, contact_times)
    return lax.while_loop(lambda carry: carry[0] <= n_impacts, step_impact, (jnp.int32(0), relative_state, start))[-1]


def _state_after_impact(coeffs, is_impact, side, speed, restitution_coeff, cosine, sine, xv):
    """Return (x, v) after the impact for lanes that hit a wall, unchanged otherwise."""
    wall_side = choose(is_impact, side, lax.full_like(side, float(coeffs.walls[0].sign)))
    wall_position, wall_velocity = wall_surface(coeffs, wall_side, cosine, sine)[:2]
    x, v = xv
    return choose(is_impact, wall_position, x), choose(is_impact, wall_velocity - restitution_coeff * side * speed, v)


def saltation_entries(coeffs, side, speed, cosine, sine):
    """Return R and the lower left entry of Q for an impact on a side; arbitrary values for side 0."""
    wall_position, wall_velocity, wall_acceleration = wall_jet_on_side(coeffs, side, cosine, sine, 2)
    restitution_coeff = restitution(coeffs, side) + 0.0 * speed
    wall_velocity = 0.0 if wall_velocity is None else wall_velocity
    approach_velocity = side * speed
    accelerations = flow_of(coeffs).acceleration_and_jerk
    acceleration_before, _ = accelerations(coeffs, wall_position, wall_velocity + approach_velocity, cosine, sine)
    acceleration_after, _ = accelerations(
        coeffs, wall_position, wall_velocity - restitution_coeff * approach_velocity, cosine, sine
    )
    weighted_sum = acceleration_after + restitution_coeff * acceleration_before
    return restitution_coeff, subtract(
        weighted_sum, None if wall_acceleration is None else (1.0 + restitution_coeff) * wall_acceleration
    ) / approach_velocity
