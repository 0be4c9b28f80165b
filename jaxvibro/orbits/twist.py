"""How the rotation around an orbit changes with the distance from it, where areas are kept: `twist`."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from continuation.persistent_jit import persistent_jit

from ..maps.strobe import strobe
from ..scene import check
from .orbit import Orbit, is_area_preserving

RESONANCE_TOLERANCE = 1e-6  # of a multiplier from a third root of 1


@check.host_only("use strobe and its derivatives")
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
    multiplier = orbit.multipliers[0]
    preserves_area = is_area_preserving(np.sum(orbit.multipliers), np.prod(orbit.multipliers))
    if orbit.rests or not preserves_area or not multiplier.imag:
        raise check.ArgumentError("orbit", "must be elliptic, its multipliers on the unit circle", orbit.multipliers)
    if abs(multiplier**3 - 1.0) < RESONANCE_TOLERANCE:
        raise check.ArgumentError("orbit", "must be none of the resonance 1:3", orbit.multipliers)
    point = np.array([np.asarray(orbit.state.x), np.asarray(orbit.state.v)])
    return _birkhoff_coefficient(
        *(np.asarray(tensor) for tensor in _return_derivatives(orbit.scene, orbit.state, point, orbit.periods))
    )


@persistent_jit(static_argnums=3)
def _return_derivatives(scene, state, point, periods):
    """The first, second and third derivatives of a return by (x, v)."""

    def return_map(start):
        end, _ = strobe(scene, replace(state, x=start[0], v=start[1]), periods, 0)
        return jnp.stack([end.x, end.v])

    derivatives = [return_map]
    for _ in range(3):
        derivatives.append(jax.jacfwd(derivatives[-1]))
    return [derivative(point) for derivative in derivatives[1:]]


def _birkhoff_coefficient(matrix, second_derivs, third_derivs):
    eigenvalues, eigenvectors = np.linalg.eig(matrix)
    left_eigenvalues, left_eigenvectors = np.linalg.eig(matrix.T)
    multiplier, q, p = (
        eigenvalues[eigenvalues.imag > 0][0],
        eigenvectors[:, eigenvalues.imag > 0][:, 0],
        left_eigenvectors[:, left_eigenvalues.imag < 0][:, 0],
    )
    p = p / np.vdot(q, p)

    def multilinear_form(tensor, *vectors):
        for vector in vectors:
            tensor = tensor @ vector
        return np.vdot(p, tensor)

    conjugate = multiplier.conjugate()
    g20, g11, g02 = (
        multilinear_form(second_derivs, q, q),
        multilinear_form(second_derivs, q, q.conj()),
        multilinear_form(second_derivs, q.conj(), q.conj()),
    )
    cubic = multilinear_form(third_derivs, q, q, q.conj()) / 2.0
    cubic += g20 * g11 * (conjugate - 3.0 + 2.0 * multiplier) / (2.0 * (multiplier**2 - multiplier) * (conjugate - 1.0))
    cubic += abs(g11) ** 2 / (1.0 - conjugate) + abs(g02) ** 2 / (2.0 * (multiplier**2 - conjugate))
    area = 2.0 * abs(np.linalg.det(np.stack([q.real, q.imag])))
    return float((conjugate * cubic).imag / area)
