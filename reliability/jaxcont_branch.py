"""A branch through a known orbit as a jaxcont user follows it: shooting on our strobe, whose derivatives are exact.

Of fixed points jaxcont tells folds alone, and where it is compiled, which else takes a minute each way, none: they are
looked for as its `Fold` does, and interpolated: its refinement would take second derivatives, minutes to compile.
"""

import functools

import jax
import jax.numpy as jnp
import jaxcont
import numpy as np

import jaxvibro as jv
from benchmarks.scipy_arclength import Point
from reliability.scipy_branch import between

MOST = 200  # points each way


def followed(family, bounds, place, step):
    """(places (points, 3), x, v and A in order along the branch; [("SN", A)]): both ways from a place on it to the
    bounds of A; step: the first, arclength in (x, v, A), of which four times are taken at most."""
    kind, numbers = (family.symmetric, family.periods), (family.omega, family.gamma, family.restitution)
    ways = [one_way(kind, numbers, place, end, step) for end in bounds]
    found = [("SN", fold(*way, k)) for way in ways for k in np.flatnonzero(way[1][:-1, -1] * way[1][1:, -1] < 0)]
    return np.concatenate([ways[0][0][:0:-1], ways[1][0]]), found


def one_way(kind, numbers, place, end, step):
    """(places, tangents) from a place to a value of A, as far as jaxcont comes."""
    states, values, tangents, there = traced(kind, numbers, place[:2], place[2], end, step)
    there = np.asarray(there)
    return np.column_stack([states, values])[there], np.asarray(tangents)[there]


@functools.cache
def residual(kind):
    """The function of (u, A, numbers) that is 0 at a fixed point u = (x, v) of the map."""
    symmetric, periods = kind

    def apart(u, amplitude, numbers):
        scene = jv.make_scene(amplitude, *numbers, (-1.0 if symmetric else None, 1.0))
        end, _ = jv.strobe(scene, jv.State(u[0], u[1]), periods, 0)
        return jnp.stack([end.x - u[0], end.v - u[1]])

    return apart


@functools.partial(jax.jit, static_argnums=0)
def traced(kind, numbers, state, begin, end, step):
    """States, values, tangents of a continuation, and which of them there are; compiled once a kind."""
    problem = jaxcont.bif_problem(residual(kind), state, begin, args=numbers)
    settings = jaxcont.ContinuationPar(step, 1e-4 * step, 4 * step, MOST, newton_tol=1e-9, compute_stability=False)
    branch = jaxcont.continuation(problem, p_span=(begin, end), settings=settings).branch
    return branch.states, branch.params, branch.tangents, branch.valid


def fold(places, tangents, k):
    """A where it turns between two places."""
    one, other = (Point(places[j], None, tangents[j]) for j in (k, k + 1))
    slopes = one.tangent[2], other.tangent[2]
    return between(one, other, slopes[0] / (slopes[0] - slopes[1]))
