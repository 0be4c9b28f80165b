"""Differentiate the test functions of an orbit with respect to free parameters, to predict its nearest bifurcation.

A test function T(z, q) is differentiated along the orbit z(q), F(z, q) = 0, with the numbers q of the scene. Its
derivative ``T_q - T_z F_z^-1 F_q`` is a difference in q, which only determines the search direction. The test functions
are those of `rays`: the determinants of the equations in times and speeds that vanish at a fold and at a period
doubling, which remain finite where an impact loses its speed; the smallest clearance; the smallest speed.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax import lax

from continuation.implicit_function import loop_over_lanes
from continuation.persistent_jit import FAST_COMPILE

from ..compiled.kernels import call_as_kernel
from ..flight.coefficients import flow_coefficients
from ..orbits import impact_equations
from .rays import bifurcation_tests, free_response, sequence_at

FOLD, FLIP, TOUCH, ZERO_SPEED = range(4)
DIFFERENCE_STEP = 1e-5  # in units: step of central differences


@partial(jax.jit, static_argnums=0, compiler_options=FAST_COMPILE)
def differentiate_tests(treedef, sequences, scene_vectors, unit_vectors):
    """Return the four tests of orbits, (orbits, 4), and their derivatives with respect to the free parameters.

    The derivatives have shape (orbits, 4, free), in units of the free parameters. `sequences` are `ImpactSequence`
    without empty rows, `scene_vectors` has shape (orbits, numbers), and `unit_vectors` has shape (free, numbers).
    """
    differentiate = loop_over_lanes(partial(_differentiate_orbit, treedef), call_as_kernel)
    tests, gradients = jax.vmap(differentiate, in_axes=(0, 0, None))(sequences, scene_vectors, unit_vectors)
    return tests, jnp.moveaxis(gradients, 2, 1)


def _differentiate_orbit(treedef, sequence, scene_vector, unit_vectors):
    has_impacts = bool(len(sequence.sides))
    orbit_unknowns = jnp.concatenate([sequence.times, sequence.speeds])

    def coeffs_at(scene_vector):
        return flow_coefficients(treedef.unflatten(list(scene_vector)))

    def tests_at(scene_vector, unknowns):
        coeffs = coeffs_at(scene_vector)
        if not has_impacts:
            return bifurcation_tests(coeffs, sequence, free_response(coeffs, sequence))
        return bifurcation_tests(coeffs, sequence_at(sequence, unknowns), unknowns)

    def residual_at(scene_vector):
        return impact_equations.residual_and_jacobian(coeffs_at(scene_vector), sequence)[0]

    def derivative_along(unit_vector):
        vector_step, orbit_change = DIFFERENCE_STEP * unit_vector, jnp.zeros_like(orbit_unknowns)
        if has_impacts:
            orbit_change = (
                -0.5
                * impact_equations.solve_cyclic(
                    jacobian, residual_at(scene_vector + vector_step) - residual_at(scene_vector - vector_step)
                )[0]
            )
        return (
            0.5
            / DIFFERENCE_STEP
            * (
                tests_at(scene_vector + vector_step, orbit_unknowns + orbit_change)
                - tests_at(scene_vector - vector_step, orbit_unknowns - orbit_change)
            )
        )

    jacobian = impact_equations.residual_and_jacobian(coeffs_at(scene_vector), sequence)[1] if has_impacts else None
    return tests_at(scene_vector, orbit_unknowns), lax.map(derivative_along, unit_vectors)
