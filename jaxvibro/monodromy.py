"""The monodromy matrix as a product (paper, (37)): P for each flight, Q for each impact, never by autodiff.

P(t) is the matrix of the free flow. Q follows from the impact law and from when the wall is met: with u = v- - v_b,

    Q = ((-R, 0), ((a+ + R a- - (1 + R) a_b) / u, -R)),

a-, a+ the accelerations before and after, v_b, a_b the wall's velocity and acceleration. A mass that rests on a wall
forgets where it came from: M = 0.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax import lax

from . import check, flow
from .frame import frame
from .impact import STUCK
from .path import accelerations
from .strobe import CAP, FULL, real_state, strobe
from .wall import chosen, course, picked, press

SLOTS = 32  # impacts of a period


def monodromy(scene, state, periods=1):
    """The derivative of `strobe`'s (x, v) by the given (x, v): shape (..., 2, 2), rows x and v of the end.

    scene, state, periods as for `strobe`. nan where the strobe has no end (status from CAP on) or, without a chatter,
    more than 32 impacts a period; zero where the mass comes to rest on a wall. On an impact without speed the
    derivative does not exist: inf or nan.

    Raises SceneError as `strobe` does.
    """
    periods = check.whole("periods", periods, 1)
    return _product(scene, real_state(scene, state), periods)


@partial(jax.jit, static_argnums=2)
def _product(scene, state, periods):
    end, impacts = strobe(scene, state, periods, SLOTS * periods)
    built, shape = frame(scene), impacts.status.shape
    spread = partial(jnp.broadcast_to, shape=shape)
    none = jnp.zeros(shape, scene.dtype)
    force, frequency, damping = map(spread, (built.force, built.frequency, built.damping))

    def fly(x, v, phase, matrix, time):
        """The state and the matrix after a flight."""
        ways = flow.responses(frequency, damping, time)
        x, v = flow.flown(ways, force * jnp.cos(phase), force * jnp.sin(phase), x, v)
        p00, p01, p11 = ways[0]
        return x, v, phase + frequency * time, _times((p00, p01, -p01, p11), matrix)

    def meet(carry, impact):
        """A flight and the impact at its end; an empty slot changes nothing."""
        (*before, past, rests), (time, side) = carry, impact
        hit = side != 0
        x, v, phase, matrix = fly(*before, jnp.where(hit, time - past, 0.0))
        saltation, where, after, stays = _saltation(built, side, x, v, phase)
        matrix = tuple(jnp.where(hit, a, b) for a, b in zip(_times(saltation, matrix), matrix, strict=True))
        x, v = jnp.where(hit, where, x), jnp.where(hit, after, v)
        return (x, v, phase, matrix, jnp.where(hit, time, past), rests | (hit & stays)), None

    rests = spread((abs(state.contact) == STUCK) | (abs(end.contact) == STUCK) | (impacts.least_speed == 0))
    carry = (*map(spread, (state.x, state.v, state.phase)), (none + 1.0, none, none, none + 1.0), none, rests)
    if built.walls:
        carry, _ = lax.scan(meet, carry, (jnp.moveaxis(impacts.time, -1, 0), jnp.moveaxis(impacts.side, -1, 0)))
    *before, past, rests = carry
    matrix = fly(*before, periods * built.period - past)[3]
    lost = (impacts.status >= CAP) | ((impacts.status == FULL) & (impacts.least_speed > 0))
    values = [jnp.where(lost, jnp.nan, jnp.where(rests, 0.0, each)) for each in matrix]
    return jnp.stack(values, -1).reshape(*shape, 2, 2)


def _times(left, right):
    """The product of two matrices, each by rows."""
    (a, b, c, d), (e, f, g, h) = left, right
    return a * e + b * g, a * f + b * h, c * e + d * g, c * f + d * h


def _saltation(frame, side, x, v, phase):
    """(Q by rows, the wall's position, v after, whether the mass then rests) of an impact; side 0: of none."""
    side = jnp.where(side < 0, -1.0, 1.0)
    cosine, sine = jnp.cos(phase), jnp.sin(phase)
    walls, values = frame.walls, (frame.force, frame.frequency, frame.damping, cosine, sine)
    courses = [course(wall, frame.frequency, cosine, sine, 2) for wall in walls]
    where, speed, bend = (0.0 if each is None else each for each in picked(side, walls, courses))
    bounce = chosen(side, walls, [wall.restitution for wall in walls])
    push = side * picked(side, walls, [press(wall, *values, 0) for wall in walls])[0]
    closing = v - speed
    after = speed - bounce * closing
    before_pull, _ = accelerations(frame, where, v, cosine, sine)
    after_pull, _ = accelerations(frame, where, after, cosine, sine)
    turn = (after_pull + bounce * before_pull - (1.0 + bounce) * bend) / closing
    stays = (bounce * closing == 0) & (push >= 0)
    return (-bounce, 0.0, turn, -bounce), where, after, stays
