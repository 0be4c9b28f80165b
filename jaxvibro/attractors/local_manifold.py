"""The germ of a manifold: the curve near its saddle, as a graph over the eigenvector's line.

Near saddle + a e the curve is saddle + a e + g(a) n, n across e. g, a polynomial, is the fixed point of the graph
transform (Hadamard): F leads the points of the curve near a / r to those near a, r being the multiplier, and draws in
across the curve. They tell the way back along it too: F leads its point at p(a) to that at a. g belongs to the curve
alone, so that no rounding along the curve enters it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import ArrayLike, Float
from numpy.polynomial import chebyshev

from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import OPTIONS
from ..compiled.kernels import WIDTH
from ..maps import two_tiers
from ..maps.inverse import backward
from ..scene.codes import Status
from ..scene.state import State

LANES = 1 << 12  # of one compiled call
LEAST = 1e-6  # of the scene's size: so far from the saddle the line is the curve, to the square of it
MOST = 0.1  # of the scene's size: the longest germ that is tried
NODES, DEGREE = 32, 14  # of the polynomial
TURNS = 30  # of the graph transform, at most
SETTLED, EXACT = 5, 500  # roundings of the scene's size: g changes no more; g is the curve, and a germ may be as long


class Germ(NamedTuple):
    """reach: as far along the line, to both sides, g (across) and p (before) hold: Chebyshev series in a / reach."""

    saddle: Float[np.ndarray, "2"]
    heading: Float[np.ndarray, "2"]
    reach: float
    across: Float[np.ndarray, " across"]
    before: Float[np.ndarray, " before"]

    def at(self, along: Float[np.ndarray, " lanes"]) -> Float[np.ndarray, "lanes 2"]:
        """The curve's points (lanes, 2) so far along the line, of either sign."""
        normal = np.array([-self.heading[1], self.heading[0]])
        off = chebyshev.chebval(along / self.reach, self.across)
        return self.saddle + along[:, None] * self.heading + off[:, None] * normal

    def back(self, along: Float[ArrayLike, "*lanes"]) -> Float[ArrayLike, "*lanes"]:
        """How far along are the points that the map leads to those so far along."""
        return chebyshev.chebval(along / self.reach, self.before)


def mapped(scene, z, phase, steps, back):
    """(z, impacts, good): F^steps of states (lanes, 2) at a phase, or of the inverse where `back`."""
    parts = []
    for first in range(0, len(z), LANES):
        some = z[first : first + LANES]
        padded = np.pad(some, ((0, LANES - len(some)), (0, 0)))
        found = _run(scene, *padded.T, scene.dtype.type(phase), steps, -(-len(some) // WIDTH), back)
        parts.append([each[: len(some)] for each in jax.device_get(found)])
    x, v, count, status = (np.concatenate(each) for each in zip(*parts, strict=True))
    return np.stack([x, v], -1), count, status < Status.CAP


@persistent_jit(static_argnames="back", compiler_options=OPTIONS)
def _run(scene, x, v, phase, steps, blocks, back):
    def one(_, carry):
        x, v, contact, count, status = carry
        state = State(x, v, phase, contact)
        end, impacts = backward(scene, state, WIDTH) if back else two_tiers.strobe(scene, state, 1, 0, WIDTH)
        return end.x, end.v, end.contact, count + impacts.count, jnp.maximum(status, impacts.status)

    def block(k, whole):
        start = k * WIDTH
        x, v = (lax.dynamic_slice_in_dim(each, start, WIDTH) for each in whole[:2])
        none = jnp.zeros(WIDTH, jnp.int32)
        x, v, _, count, status = lax.fori_loop(0, steps, one, (x, v, 0.0 * x, none, none))
        new = (x, v, count, status)
        return [lax.dynamic_update_slice_in_dim(old, part, start, 0) for old, part in zip(whole, new, strict=True)]

    none = jnp.zeros(x.shape, jnp.int32)
    return lax.fori_loop(0, blocks, block, [x, v, none, none])


def germ(scene, saddle, heading, rate, periods, phase, back, size):
    """The longest `Germ` that is the curve to rounding; where none is, the line itself.

    saddle (2,); heading: the eigenvector, of length 1; rate: how much `periods` drive periods (those of the inverse
    where `back`) stretch it, beyond 1 or -1; size: a length of the scene.
    """
    rounding, axes = size * np.finfo(scene.dtype).eps, np.array([heading, [-heading[1], heading[0]]])

    def move(germ, along):
        """(along, across) of the images of a germ's points, or None: between them is a corner, a wall or a fold."""
        z, count, good = mapped(scene, germ.at(along), phase, periods, back)
        moved = axes @ (z - saddle).T
        folded = not (np.diff(moved[0]) > 0).all()
        return None if folded or not good.all() or (count != count[0]).any() else moved

    reach = MOST * size
    while reach > LEAST * size:
        found = _settled(Germ(saddle, heading, reach, np.zeros(1), np.array([0.0, reach / rate])), move, rounding)
        if found is not None:
            return found
        reach *= 0.5
    return Germ(saddle, heading, LEAST * size, np.zeros(1), np.array([0.0, LEAST * size / rate]))


def _settled(germ, move, rounding):
    """The germ with its series found, or None: the curve is no polynomial of this degree as far as that."""
    nodes = germ.reach * chebyshev.chebpts2(NODES)
    for _ in range(TURNS):
        begun = germ.back(nodes)
        moved = move(germ, begun)
        if moved is None:
            return None
        across, before = chebyshev.chebfit(moved[0] / germ.reach, np.stack([moved[1], begun], -1), DEGREE).T
        change = abs(chebyshev.chebval(nodes / germ.reach, across) - chebyshev.chebval(nodes / germ.reach, germ.across))
        germ = germ._replace(across=across, before=before)
        if change.max() <= SETTLED * rounding:
            break
    moved = move(germ, germ.back(0.5 * (nodes[1:] + nodes[:-1])))
    if moved is None:
        return None
    apart = moved[1] - chebyshev.chebval(moved[0] / germ.reach, germ.across)
    return germ if abs(apart).max() <= EXACT * rounding else None
