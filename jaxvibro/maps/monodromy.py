"""The monodromy matrix as a product (paper, (37)): P for each flight, Q for each impact, never by autodiff.

P(t) is the matrix of the free flow. Q follows from the impact law and from when the wall is met: with u = v- - v_b,

    Q = ((-R, 0), ((a+ + R a- - (1 + R) a_b) / u, -R)),

a-, a+ the accelerations before and after, v_b, a_b the wall's velocity and acceleration. A mass that rests on a wall
forgets where it came from: M = 0.
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
    """The derivative of `strobe`'s (x, v) by the given (x, v): shape (..., 2, 2), rows x and v of the end.

    scene, state, periods as for `strobe`; slots: impacts of a period that there is room for. nan where the strobe has
    no end (status from CAP on) or has more impacts than that and does not rest; zero where the mass rests on a wall.
    On an impact without speed the derivative does not exist: inf or nan.

    Raises ArgumentError as `strobe` does, and TypeError where it is itself to be differentiated.
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
        raise TypeError("monodromy is a product without derivatives: differentiate jax.jacfwd of strobe instead")

    return run


@cache
def _compiled_monodromy(tree, periods, slots):
    return jax.jit(partial(_matrices_in_blocks, tree, periods, slots, MIN_LANES), compiler_options=COMPILER_OPTIONS)


def _matrices_in_blocks(tree, periods, slots, min_lanes, *leaves):
    """M of all lanes, block by block."""
    scene, state = tree.unflatten(leaves)
    shape = jnp.broadcast_shapes(*map(jnp.shape, leaves))

    def run(arguments):
        entries = call_as_kernel(_block_monodromy, *arguments, periods=periods, slots=slots)
        return jnp.stack(entries, -1).reshape(*entries[0].shape, 2, 2)

    arguments = scene, replace(state, x=jnp.broadcast_to(state.x, shape))
    return run_in_blocks(run, arguments, lambda n_lanes: jnp.zeros((n_lanes, 2, 2), scene.dtype), min_lanes)


def _block_monodromy(scene, state, periods, slots):
    """M of a block of lanes, by rows."""
    return strobe_with_monodromy(scene, state, periods, slots)[2]


def strobe_with_monodromy(scene, state, periods, slots, clearance=False):
    """(State, Impacts, M by rows) of a block of lanes, to be called within one kernel as `strobe_with_product` is."""
    end, impacts, is_sticking, monodromy_state = strobe_with_product(scene, state, periods, slots, clearance)
    is_undefined = (impacts.status >= Status.CAP) | ((impacts.count > slots) & ~is_sticking)
    return (
        end,
        impacts,
        [choose(is_undefined, jnp.nan, choose(is_sticking, 0.0, entry)) for entry in monodromy_state.matrix],
    )


def strobe_with_product(scene, state, periods, slots, clearance=False):
    """(end, impacts, rests, way) of a block of lanes: where `strobe` leads, and what M is made of.

    rests: whether the mass is on a wall at some time, which makes M zero whatever the product is. way: the
    `MonodromyState` at the end, its matrix the product of P and Q, of no meaning with a status from CAP on, or with
    more impacts than slots. state.x has the lanes' shape, other numbers are scalars or of that shape. To be called
    within one kernel."""
    (end, impacts), (release_time, *_) = one_period.strobe_with_history(scene, state, periods, slots, clearance)
    is_sticking = (abs(end.contact) == Contact.STUCK) | (abs(state.contact) == Contact.STUCK) | (release_time >= 0)
    return end, impacts, is_sticking, _monodromy_product(scene, state, impacts, end.contact, periods, slots)


def _monodromy_product(scene, state, impacts, end_contact, periods, slots):
    """The `MonodromyState` after P of each flight, Q of each impact, the matrix of each stay; end_contact: of every
    lane, at the end."""
    coeffs, zero = compute_coefficients(scene), lax.full_like(end_contact, 0.0)
    flow, pass_contact = flow_of(coeffs), CONTACT_PASSAGES[coeffs.contact_law]
    impact_rows = impacts.time, impacts.side.astype(zero.dtype), impacts.speed
    impact_rows = [jnp.moveaxis(entry, -1, 0) for entry in impact_rows]
    n_impacts = lax.min(jnp.max(impacts.count), jnp.int32(slots)) if coeffs.walls else jnp.int32(0)

    def step_impact(carry):
        """A stay where one is due, a flight and the impact at its end, or, after all impacts, the flight to the end."""
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
    """(x, v) of the lanes that hit after the impact, of others as it is."""
    wall_side = choose(is_impact, side, lax.full_like(side, float(coeffs.walls[0].sign)))
    wall_position, wall_velocity = wall_surface(coeffs, wall_side, cosine, sine)[:2]
    x, v = xv
    return choose(is_impact, wall_position, x), choose(is_impact, wall_velocity - restitution_coeff * side * speed, v)


def saltation_entries(coeffs, side, speed, cosine, sine):
    """R and the lower left entry of Q, of an impact on a side with this speed; side 0: of none, any numbers."""
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
