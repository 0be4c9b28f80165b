"""Compute the twist of an elliptic orbit: the change of its rotation angle with the action."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from continuation.persistent_jit import persistent_jit

from ..maps.strobe import strobe
from ..scene import check
from .orbit import Orbit, is_area_preserving

RESONANCE_TOLERANCE = 1e-6  # of the multiplier's cube from 1, at the resonance 1:3


@check.host_only("use strobe and its derivatives")
def twist(orbit: Orbit) -> float:
    """Compute the twist of an elliptic orbit.

    The twist is the derivative of the rotation angle per return with respect to the action, at the orbit.

    Parameters
    ----------
    orbit : Orbit
        Orbit with multipliers exp(+-i angle), 0 < angle < pi, in a scene without damping and with R = 1.

    Returns
    -------
    float
        Twist in rad per action, the action in lengths squared per t.

    Raises
    ------
    ArgumentError
        If the orbit is not elliptic, or is close to the resonance 1:3, where the twist does not exist.

    See Also
    --------
    find_orbit : Find the orbit near a state.
    monodromy : Linear part of the return map.

    Notes
    -----
    A return is n drive periods. Near the orbit, apart from resonances, motions stay on invariant curves in the plane of
    (x, v) at a phase. On such a curve a return turns by ``angle + twist * J``, where J, the action, is the enclosed
    area divided by 2 pi. The curves persist if the twist is not 0 (Moser's twist theorem).

    The twist is the first coefficient of the Birkhoff normal form, computed from the third derivatives of the map [1]_.

    References
    ----------
    .. [1] Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory, Springer, section 4.7.

    Examples
    --------
    >>> scene = jv.make_scene(amplitude=1.5, frequency=3.2, damping=0.0, restitution=1.0, walls=(None, 0.5))
    >>> orbit = jv.find_orbit(scene, jv.State(x=-0.8, v=-1.44, phase=np.pi), periods=2, settle=0)
    >>> round(jv.twist(orbit), 4)
    -0.402
    """
    multiplier = orbit.multipliers[0]
    preserves_area = is_area_preserving(np.sum(orbit.multipliers), np.prod(orbit.multipliers))
    if orbit.rests or not preserves_area or not multiplier.imag:
        raise check.ArgumentError("orbit", "must be elliptic, its multipliers on the unit circle", orbit.multipliers)
    if abs(multiplier**3 - 1.0) < RESONANCE_TOLERANCE:
        raise check.ArgumentError("orbit", "must not be at the resonance 1:3", orbit.multipliers)
    point = np.array([np.asarray(orbit.state.x), np.asarray(orbit.state.v)])
    return _birkhoff_coefficient(
        *(np.asarray(tensor) for tensor in _return_derivatives(orbit.scene, orbit.state, point, orbit.periods))
    )


@persistent_jit(static_argnums=3)
def _return_derivatives(scene, state, point, periods):
    """Compute the first, second and third derivatives of the return map with respect to (x, v)."""

    def return_map(start):
        end, _ = strobe(scene, replace(state, x=start[0], v=start[1]), periods, 0)
        return jnp.stack([end.x, end.v])

    derivatives = [return_map]
    for _ in range(3):
        derivatives.append(jax.jacfwd(derivatives[-1]))
    return [derivative(point) for derivative in derivatives[1:]]


def _birkhoff_coefficient(matrix, second_derivs, third_derivs):
    """Compute the first Birkhoff coefficient from the derivatives of the return map."""
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
