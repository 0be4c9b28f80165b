"""Follow a branch through a known orbit with jaxcont: shooting on this package's map, whose derivatives are exact.

jaxcont reports only folds of fixed points, and none if it is compiled; otherwise it takes a minute per direction. Folds
are therefore detected as its `Fold` does, and interpolated: its refinement takes second derivatives, minutes to
compile.
"""

import functools

import jax
import jax.numpy as jnp
import jaxcont
import numpy as np

import jaxvibro as jv
from benchmarks.scipy_arclength import Point
from reliability.scipy_branch import between

MOST = 200  # largest number of points in each direction


def followed(family, bounds, place, step):
    """Follow a branch in both directions to the bounds of A.

    Returns (points (points, 3), x, v and A in order along the branch; [("SN", A)]). `step` is the first step, arclength
    in (x, v, A); the largest is four times that.
    """
    kind, numbers = (family.symmetric, family.periods), (family.omega, family.gamma, family.restitution)
    ways = [one_way(kind, numbers, place, end, step) for end in bounds]
    found = [("SN", fold(*way, k)) for way in ways for k in np.flatnonzero(way[1][:-1, -1] * way[1][1:, -1] < 0)]
    return np.concatenate([ways[0][0][:0:-1], ways[1][0]]), found


def one_way(kind, numbers, place, end, step):
    """Return (points, tangents) from a point towards a value of A, as far as jaxcont succeeds."""
    states, values, tangents, there = traced(kind, numbers, place[:2], place[2], end, step)
    there = np.asarray(there)
    return np.column_stack([states, values])[there], np.asarray(tangents)[there]


@functools.cache
def residual(kind):
    """Make the function of (u, A, numbers) that is 0 at a fixed point u = (x, v) of the map."""
    symmetric, periods = kind

    def apart(u, amplitude, numbers):
        scene = jv.make_scene(amplitude, *numbers, (-1.0 if symmetric else None, 1.0))
        end, _ = jv.strobe(scene, jv.State(u[0], u[1]), periods, 0)
        return jnp.stack([end.x - u[0], end.v - u[1]])

    return apart


@functools.partial(jax.jit, static_argnums=0)
def traced(kind, numbers, state, begin, end, step):
    """Return states, values, tangents and validity mask of a continuation; compiled once per kind."""
    problem = jaxcont.bif_problem(residual(kind), state, begin, args=numbers)
    settings = jaxcont.ContinuationPar(step, 1e-4 * step, 4 * step, MOST, newton_tol=1e-9, compute_stability=False)
    branch = jaxcont.continuation(problem, p_span=(begin, end), settings=settings).branch
    return branch.states, branch.params, branch.tangents, branch.valid


def fold(places, tangents, k):
    """Return A of the fold between two points."""
    one, other = (Point(places[j], None, tangents[j]) for j in (k, k + 1))
    slopes = one.tangent[2], other.tangent[2]
    return between(one, other, slopes[0] / (slopes[0] - slopes[1]))
