"""How the rotation around an orbit changes with the distance from it, where areas are kept: `twist`."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from continuation.persistent_jit import persistent_jit

from ..maps.strobe import strobe
from ..scene import check
from .orbit import Orbit, areas_kept

RESONANT = 1e-6  # of a multiplier from a third root of 1


@check.host("use strobe and its derivatives")
def twist(orbit: Orbit) -> float:
    """The twist of an elliptic orbit: how the angle by which a return turns changes with the action.

    orbit: with multipliers exp(+-i angle), 0 < angle < pi, of a scene without damping and with R = 1. A return is n
    drive periods. Near the orbit motions stay, but for the resonances, on curves in the plane of (x, v) at a phase; on
    one of them a return turns by angle + twist J, with J its area over 2 pi, the action (lengths squared per t). The
    curves persist where the twist is not 0 (Moser's twist theorem).

    The first coefficient of Birkhoff's normal form, from the third derivatives of the strobe (Kuznetsov, Elements of
    Applied Bifurcation Theory, 4.7). Raises ArgumentError for an orbit that is not elliptic, and next to the resonance
    1:3, where there is none.
    """
    first = orbit.multipliers[0]
    kept = areas_kept(np.sum(orbit.multipliers), np.prod(orbit.multipliers))
    if orbit.rests or not kept or not first.imag:
        raise check.ArgumentError("orbit", "must be elliptic, its multipliers on the unit circle", orbit.multipliers)
    if abs(first**3 - 1.0) < RESONANT:
        raise check.ArgumentError("orbit", "must be none of the resonance 1:3", orbit.multipliers)
    here = np.array([np.asarray(orbit.state.x), np.asarray(orbit.state.v)])
    return _coefficient(*(np.asarray(each) for each in _derivatives(orbit.scene, orbit.state, here, orbit.periods)))


@persistent_jit(static_argnums=3)
def _derivatives(scene, state, here, periods):
    """The first, second and third derivatives of a return by (x, v)."""

    def back(start):
        end, _ = strobe(scene, replace(state, x=start[0], v=start[1]), periods, 0)
        return jnp.stack([end.x, end.v])

    ways = [back]
    for _ in range(3):
        ways.append(jax.jacfwd(ways[-1]))
    return [way(here) for way in ways[1:]]


def _coefficient(matrix, second, third):
    values, vectors = np.linalg.eig(matrix)
    others, lefts = np.linalg.eig(matrix.T)
    root, q, p = values[values.imag > 0][0], vectors[:, values.imag > 0][:, 0], lefts[:, others.imag < 0][:, 0]
    p = p / np.vdot(q, p)

    def along(tensor, *ways):
        for way in ways:
            tensor = tensor @ way
        return np.vdot(p, tensor)

    bar = root.conjugate()
    twice, mixed, back = along(second, q, q), along(second, q, q.conj()), along(second, q.conj(), q.conj())
    cubic = along(third, q, q, q.conj()) / 2.0
    cubic += twice * mixed * (bar - 3.0 + 2.0 * root) / (2.0 * (root**2 - root) * (bar - 1.0))
    cubic += abs(mixed) ** 2 / (1.0 - bar) + abs(back) ** 2 / (2.0 * (root**2 - bar))
    area = 2.0 * abs(np.linalg.det(np.stack([q.real, q.imag])))
    return float((bar * cubic).imag / area)
