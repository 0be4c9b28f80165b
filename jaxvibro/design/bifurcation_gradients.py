"""Differentiate the test functions of an orbit with respect to free parameters, to predict its nearest bifurcation.

A test function T(z, q) depends on the numbers q of the scene and on the orbit z(q), which satisfies F(z, q) = 0. The
derivative ``T_q - T_z F_z^-1 F_q`` is approximated by central differences in q, which suffices for a search direction.
The test functions are those of `parameter_rays`:

- the determinants that vanish at a fold and at a period doubling, which remain finite at an impact with zero speed;
- the smallest clearance;
- the smallest impact speed.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax import lax

from continuation.hostcall import FAST_COMPILE
from continuation.implicit_function import make_lane_loop_function

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..orbits import impact_equations
from .parameter_rays import bifurcation_test_values, impact_free_state, sequence_at

FOLD, FLIP, TOUCH, ZERO_SPEED = range(4)
DIFFERENCE_STEP = 1e-5  # in units: step of central differences


@partial(jax.jit, static_argnums=0, compiler_options=FAST_COMPILE)
def evaluate_test_gradients(scene_treedef, sequences, scene_vectors, unit_changes):
    """Evaluate the four test functions of orbits and their derivatives with respect to the free parameters.

    Parameters
    ----------
    scene_treedef : jax.tree_util.PyTreeDef
        Tree structure of the scene.
    sequences : ImpactSequence
        Impacts of the orbits without empty rows. The first axis is that of the orbits.
    scene_vectors : jax.Array
        Numbers of the scene of each orbit. Array of shape (orbits, numbers).
    unit_changes : jax.Array
        Change of these numbers for one unit of each free parameter. Array of shape (free, numbers).

    Returns
    -------
    tests : jax.Array
        Values of the test functions. Array of shape (orbits, 4).
    gradients : jax.Array
        Derivatives per unit of each free parameter. Array of shape (orbits, 4, free).
    """
    differentiate_orbits = make_lane_loop_function(partial(_orbit_test_gradients, scene_treedef), call_as_kernel)
    test_values, test_gradients = jax.vmap(differentiate_orbits, in_axes=(0, 0, None))(
        sequences, scene_vectors, unit_changes
    )
    return test_values, jnp.moveaxis(test_gradients, 2, 1)


def _orbit_test_gradients(scene_treedef, sequence, scene_vector, unit_changes):
    has_impacts = bool(len(sequence.sides))
    orbit_unknowns = jnp.concatenate([sequence.times, sequence.speeds])

    def coeffs_at(scene_vector):
        return flow_coefficients(scene_treedef.unflatten(list(scene_vector)))

    def test_values_at(scene_vector, unknowns):
        coeffs = coeffs_at(scene_vector)
        if not has_impacts:
            return bifurcation_test_values(coeffs, sequence, impact_free_state(coeffs, sequence))
        return bifurcation_test_values(coeffs, sequence_at(sequence, unknowns), unknowns)

    def residual_at(scene_vector):
        return impact_equations.residual_and_jacobian(coeffs_at(scene_vector), sequence)[0]

    def test_derivatives(unit_change):
        scene_vector_step, unknowns_change = DIFFERENCE_STEP * unit_change, jnp.zeros_like(orbit_unknowns)
        if has_impacts:
            unknowns_change = (
                -0.5
                * impact_equations.solve_cyclic(
                    jacobian,
                    residual_at(scene_vector + scene_vector_step) - residual_at(scene_vector - scene_vector_step),
                )[0]
            )
        return (
            0.5
            / DIFFERENCE_STEP
            * (
                test_values_at(scene_vector + scene_vector_step, orbit_unknowns + unknowns_change)
                - test_values_at(scene_vector - scene_vector_step, orbit_unknowns - unknowns_change)
            )
        )

    jacobian = impact_equations.residual_and_jacobian(coeffs_at(scene_vector), sequence)[1] if has_impacts else None
    return test_values_at(scene_vector, orbit_unknowns), lax.map(test_derivatives, unit_changes)
