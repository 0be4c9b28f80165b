"""Solutions of F(u, p, fixed) = 0 as functions of p: found in whatever way, differentiated as roots, not as iterations.

Of u(p) only F is known: u' = -F_u^-1 F_p (implicit function theorem). Differentiated again this gives the derivatives
of any order. They are taken forward alone (`smooth`), so that F may hold loops whose length its numbers decide. fixed
is a pytree of what is not differentiated by.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import sequential_vmap
from jaxtyping import Float

from .arrays import Array
from .linear import solve
from .problem import plainly

Unknowns = Float[Array, " unknowns"]
Numbers = Float[Array, " numbers"]
Run = Callable[..., Any]  # of (function, *arrays): its result, as the compiler likes it (`problem.Problem.run`)


def in_turn(function: Callable[..., Any], run: Run = plainly) -> Callable[..., Any]:
    """The function of one lane, of which a vmap is a loop over lanes: none waits for another, and what is compiled is
    small."""
    return sequential_vmap(lambda *arrays: run(function, *arrays))


def smooth(function: Callable[[Numbers, Any], Any], run: Run = plainly) -> Callable[[Numbers, Any], Any]:
    """The function of (vector, fixed) whose derivatives by the vector are whole arrays, of any order: whatever asks for
    them, and be it in reverse mode, goes through the function forward."""
    value = jax.custom_jvp(in_turn(function, run))

    @value.defjvp
    def _(primals, tangents):
        (z, fixed), (change, _) = primals, tangents
        slopes = smooth(jax.jacfwd(function), run)(z, fixed)
        return value(z, fixed), jax.tree.map(lambda slope: slope @ change, slopes)

    return value


def root(
    function: Callable[[Unknowns, Numbers, Any], Unknowns],
    find: Callable[[Numbers, Any], tuple[Unknowns, Any]],
    run: Run = plainly,
) -> Callable[[Numbers, Any], tuple[Unknowns, Any]]:
    """(p, fixed) -> (u, told), u with its derivatives by p of any order, forward and reverse.

    function: F of (u, p, fixed), as many numbers as u has; find: (p, fixed) -> (u, told), u a root of F where it is one
    at all, told a pytree of real numbers, which count as constants.
    """
    solved = jax.custom_jvp(in_turn(find, run))

    @solved.defjvp
    def _(primals, tangents):
        (p, fixed), (change, _) = primals, tangents
        u, told = solved(p, fixed)

        def by(z, fixed):
            size = len(u)
            slopes = jax.jacfwd(lambda z: function(z[:size], z[size:], fixed))(z)
            return -solve(slopes[:, :size], slopes[:, size:]).x

        change = smooth(by, run)(jnp.concatenate([u, p]), fixed) @ change
        return (u, told), (change, jax.tree.map(jnp.zeros_like, told))

    return solved


class Carried(NamedTuple):
    """u; residual: the largest number left in F there; kind: FOLLOWED, JUMPED: Newton's method has led to u from where
    the way was lost, so that it may be another root, or LOST: none was found."""

    u: Unknowns
    residual: Float[Array, ""]
    kind: Float[Array, ""]


ON_WAY, FROM_AFAR, FOLLOWED, JUMPED, LOST = range(5)
SHORTEST = 1.0 / 64.0  # of the way: a stride as short that fails is its end
WARY = 0.5  # of the change that the tangent foretells: a larger correction is not followed
SMALL = 1e-2  # of 1 + the largest unknown: but one as small is
MOST = 12  # of Newton's steps after a stride; three times as many from afar


class _Way(NamedTuple):
    """u: where Newton's method is, from a guess, at the place ahead; tried, step: of its steps, the last one's size;
    base, tangent: the root at the place share, and its derivative by the place; residual, kind: as of `Carried`."""

    u: Unknowns
    guess: Unknowns
    ahead: Float[Array, ""]
    tried: Float[Array, ""]
    step: Float[Array, ""]
    base: Unknowns
    tangent: Unknowns
    share: Float[Array, ""]
    residual: Float[Array, ""]
    kind: Float[Array, ""]


def carried(
    function: Callable[[Unknowns, Numbers, Any], Unknowns], start: Unknowns, begin: Numbers, end: Numbers, fixed: Any
) -> Carried:
    """The root of F at p = end that the root start at p = begin becomes on the straight way there.

    Where one stride along the tangent is enough it is one; it is halved where Newton's method does not follow, or only
    with a correction that the tangent did not foretell; where it becomes too short Newton's method begins there and
    looks for a root at the end of the way. F stands once in one loop: it is compiled once, and lanes do not wait.
    """
    size, eps = len(start), jnp.finfo(start.dtype).eps

    def twice(z):
        value = function(z[:size], begin + z[size] * (end - begin), fixed)
        return value, value

    def advance(way):
        slopes, value = jax.jacfwd(twice, has_aux=True)(jnp.append(way.u, way.ahead))
        found = solve(slopes[:, :size], jnp.stack([value, slopes[:, size]], 1)).x
        u, step, scale = way.u - found[:, 0], jnp.max(abs(found[:, 0])), 1.0 + jnp.max(abs(way.base))
        on, met, tried = way.kind == ON_WAY, way.step <= eps**0.7 * scale, way.tried + 1.0
        foretold = WARY * jnp.max(abs(way.guess - way.base)) + SMALL * scale
        over = ~jnp.isfinite(step) | met | (tried >= jnp.where(on, MOST, 3 * MOST))
        good = met & jnp.isfinite(step) & (~on | (jnp.max(abs(u - way.guess)) <= foretold))
        stride = jnp.where(
            good, jnp.where(way.ahead > 0, 2.0 * (way.ahead - way.share), 1.0), 0.5 * (way.ahead - way.share)
        )
        base, tangent = (jnp.where(good, *each) for each in ((u, way.base), (-found[:, 1], way.tangent)))
        share = jnp.where(good, way.ahead, way.share)
        ended = jnp.where(on, jnp.where(good, FOLLOWED, FROM_AFAR), jnp.where(good, JUMPED, LOST))
        goes_on = on & jnp.where(good, share < 1.0, stride >= SHORTEST)
        kind = jnp.where(over & ~goes_on, ended, way.kind)
        ahead = jnp.where(goes_on, jnp.minimum(1.0, share + stride), 1.0)
        guess = base + jnp.where(goes_on, ahead - share, 0.0) * tangent
        new = _Way(guess, guess, ahead, 0.0 * tried, jnp.inf * tried, base, tangent, share, jnp.max(abs(value)), kind)
        same = way._replace(u=u, tried=tried, step=step)
        return jax.tree.map(lambda new, same: jnp.where(over, new, same), new, same)

    zero = jnp.zeros((), start.dtype)
    begun = _Way(start, start, zero, zero, zero + jnp.inf, start, 0.0 * start, zero, zero + jnp.nan, zero + ON_WAY)
    way = lax.while_loop(lambda way: way.kind < FOLLOWED, advance, begun)
    return Carried(way.base, way.residual, way.kind)
