"""Where the nearest change of an orbit lies, as the gradients of the tests say that become zero there.

A test T(z, q) is followed along the orbit z(q), F(z, q) = 0, as the scene's numbers q change: its derivative is
T_q - T_z F_z^-1 F_q, here by differences in q, which only point the way. The tests are those of `rays`: the
determinants that vanish at a fold and at a period doubling, of the equations in times and speeds, finite also where an
impact loses its speed; the least clearance; the least speed.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax import lax

from continuation.implicit import in_turn
from continuation.persistent_jit import SOON

from ..compiled.kernels import one_kernel
from ..flight.coefficients import framed
from ..orbits import impact_equations
from .rays import at_unknowns, free_response, tests_of

FOLD, FLIP, TOUCH, SLOW = range(4)
APART = 1e-5  # units: the points of a difference


@partial(jax.jit, static_argnums=0, compiler_options=SOON)
def aims(tree, cycles, numbers, units):
    """(the four tests, (orbits, 4), their derivatives by the free numbers in their units, (orbits, 4, free)) of orbits,
    `Cycle`s without empty rows, of scenes with these numbers, (orbits, numbers). units: (free, numbers)."""
    look = in_turn(partial(_aim, tree), one_kernel)
    tests, slopes = jax.vmap(look, in_axes=(0, 0, None))(cycles, numbers, units)
    return tests, jnp.moveaxis(slopes, 2, 1)


def _aim(tree, cycle, numbers, units):
    hits = bool(len(cycle.sides))
    start = jnp.concatenate([cycle.times, cycle.speeds])

    def built(numbers):
        return framed(tree.unflatten(list(numbers)))

    def tests(numbers, unknowns):
        frame = built(numbers)
        if not hits:
            return tests_of(frame, cycle, free_response(frame, cycle))
        return tests_of(frame, at_unknowns(cycle, unknowns), unknowns)

    def left(numbers):
        return impact_equations.equations(built(numbers), cycle)[0]

    def slope(unit):
        step, change = APART * unit, jnp.zeros_like(start)
        if hits:
            change = -0.5 * impact_equations.solve(slopes, left(numbers + step) - left(numbers - step))[0]
        return 0.5 / APART * (tests(numbers + step, start + change) - tests(numbers - step, start - change))

    slopes = impact_equations.equations(built(numbers), cycle)[1] if hits else None
    return tests(numbers, start), lax.map(slope, units)
