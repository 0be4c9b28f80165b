"""Many solutions of the equations of the impacts from one guess each: Newton's method, led away from those it has met.

Where r are met, F is multiplied by prod (1 + 1 / |u - r|^2), which has no zero at any r: from the same guess Newton's
method then comes to another solution, or to none (Farrell, Birkisson and Funke, SIAM J. Sci. Comput. 37, A2026, 2015).
Its step is the old one times a number, as what multiplies F is one. The distance counts phases and speeds, from
whichever impact or period they are counted.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from continuation import newton
from continuation.arrays import Array
from continuation.persistent_jit import persistent_jit

from ..flight.coefficients import framed
from . import flight_clearance, impact_equations

ROUNDS = 3  # solutions from one guess
MOST = 60  # of Newton's steps
LEAST = 1e-3  # of what a step is divided by: less, and it is without a bound


class Deflated(NamedTuple):
    """Solutions from one guess after the other: times and speeds of the impacts, in order, and whether they are an
    orbit's: impacts have speeds, and flights keep to their walls."""

    times: Float[Array, "*lanes rows"]
    speeds: Float[Array, "*lanes rows"]
    real: Bool[Array, "*lanes"]


def deflated(scenes, guesses, fast):
    """The `Deflated` of lanes, for each of `ROUNDS` in turn: (rounds, lanes). scenes: with a number for each lane;
    guesses: `Cycle`s of the lanes; fast: a speed that is large, by lane."""
    lanes, rows = guesses.times.shape
    met, count = np.zeros((lanes, ROUNDS, 2, rows)), np.zeros((lanes, ROUNDS))
    found = []
    for k in range(ROUNDS):
        one, solved = jax.device_get(_deflated(scenes, guesses, met, count, fast))
        found.append(one)
        met[:, k, 0], met[:, k, 1], count[:, k] = one.times, one.speeds, solved
    return Deflated(*(np.stack(each) for each in zip(*found, strict=True)))


@persistent_jit
@jax.vmap
def _deflated(scene, guess, met, count, fast):
    """(the `Deflated`, whether Newton's method came to it)."""
    built, rows = framed(scene), len(guess.sides)
    longest = jnp.repeat(
        jnp.array([impact_equations.LONGEST * built.period, jnp.inf]), rows, total_repeat_length=2 * rows
    )
    repelled = jax.grad(partial(_size, built, guess.sides, met, count, fast))

    def function(u):
        return impact_equations.equations(built, guess._replace(times=u[:rows], speeds=u[rows:])), repelled(u)

    def solve(slopes, value):
        (slopes, away) = slopes
        change, worst = impact_equations.solve(slopes, value)
        share = 1.0 + jnp.sum(away * change)
        return change / jnp.where(abs(share) < LEAST, jnp.where(share < 0, -LEAST, LEAST), share), worst

    def both(u):
        (value, slopes), away = function(u)
        return value, (slopes, away)

    solved = newton.newton(both, jnp.concatenate([guess.times, guess.speeds]), longest, MOST, solve)
    found = impact_equations.ordered(scene, guess, solved.unknowns)
    flown, hit = impact_equations.flights(built, found), found.sides != 0
    clear, _ = flight_clearance.clearances(built, flown, flight_clearance.samples(built, flown))
    real = jnp.all(~hit | ((found.speeds > 0) & (flown.time > 0))) & jnp.all(~hit[:, None] | (clear >= 0))
    good = solved.status == newton.OK
    same = jnp.all(found.sides == guess.sides)
    return Deflated(found.times, found.speeds, good & same & real), good


def _size(built, sides, met, count, fast, u):
    """The logarithm of what F is multiplied by."""
    rows, hit = len(sides), sides != 0
    total, place = jnp.sum(hit), jnp.arange(len(sides))
    phase, speed = built.frequency * u[:rows], u[rows:]
    sizes = []
    for turn in range(rows):
        at = (place + turn) % total
        others = met[:, :, jnp.where(hit, at, place)]
        apart = 2.0 - 2.0 * jnp.cos(phase - built.frequency * others[:, 0]) + ((speed - others[:, 1]) / fast) ** 2
        square = jnp.sum(jnp.where(hit, apart, 0.0), axis=1)
        sizes.append(jnp.where((count > 0) & (turn < total), jnp.log1p(1.0 / jnp.maximum(square, 1e-30)), 0.0))
    return jnp.sum(jnp.stack(sizes))
