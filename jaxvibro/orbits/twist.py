"""Compute the twist of an elliptic orbit: the change of its rotation angle with the action."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from continuation.hostcall import persistent_jit

from ..maps.strobe import strobe
from ..scene import check
from .orbit import Orbit, has_unit_determinants

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

    The twist is the first coefficient of the Birkhoff normal form, computed from the derivatives of the map up to order
    three [1]_.

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
    preserves_area = has_unit_determinants(np.sum(orbit.multipliers), np.prod(orbit.multipliers))
    if orbit.rests or not preserves_area or not multiplier.imag:
        raise check.ArgumentError("orbit", "must be elliptic, its multipliers on the unit circle", orbit.multipliers)
    if abs(multiplier**3 - 1.0) < RESONANCE_TOLERANCE:
        raise check.ArgumentError("orbit", "must not be at the resonance 1:3", orbit.multipliers)
    section_point = np.array([np.asarray(orbit.state.x), np.asarray(orbit.state.v)])
    return _birkhoff_coefficient(
        *(np.asarray(tensor) for tensor in _return_derivatives(orbit.scene, orbit.state, section_point, orbit.periods))
    )


@persistent_jit(static_argnums=3)
def _return_derivatives(scene, state, section_point, periods):
    """Compute the first, second and third derivatives of the return map with respect to (x, v)."""

    def return_map(start_point):
        end_state, _ = strobe(scene, replace(state, x=start_point[0], v=start_point[1]), periods, 0)
        return jnp.stack([end_state.x, end_state.v])

    derivative_functions = [return_map]
    for _ in range(3):
        derivative_functions.append(jax.jacfwd(derivative_functions[-1]))
    return [derivative_function(section_point) for derivative_function in derivative_functions[1:]]


def _birkhoff_coefficient(return_matrix, second_derivs, third_derivs):
    """Compute the first Birkhoff coefficient from the derivatives of the return map."""
    eigenvalues, eigenvectors = np.linalg.eig(return_matrix)
    left_eigenvalues, left_eigenvectors = np.linalg.eig(return_matrix.T)
    multiplier, right_eigenvector, left_eigenvector = (
        eigenvalues[eigenvalues.imag > 0][0],
        eigenvectors[:, eigenvalues.imag > 0][:, 0],
        left_eigenvectors[:, left_eigenvalues.imag < 0][:, 0],
    )
    left_eigenvector = left_eigenvector / np.vdot(right_eigenvector, left_eigenvector)

    def multilinear_form(tensor, *vectors):
        for vector in vectors:
            tensor = tensor @ vector
        return np.vdot(left_eigenvector, tensor)

    conjugate_multiplier = multiplier.conjugate()
    g20, g11, g02 = (
        multilinear_form(second_derivs, right_eigenvector, right_eigenvector),
        multilinear_form(second_derivs, right_eigenvector, right_eigenvector.conj()),
        multilinear_form(second_derivs, right_eigenvector.conj(), right_eigenvector.conj()),
    )
    cubic_coefficient = (
        multilinear_form(third_derivs, right_eigenvector, right_eigenvector, right_eigenvector.conj()) / 2.0
    )
    cubic_coefficient += (
        g20
        * g11
        * (conjugate_multiplier - 3.0 + 2.0 * multiplier)
        / (2.0 * (multiplier**2 - multiplier) * (conjugate_multiplier - 1.0))
    )
    cubic_coefficient += abs(g11) ** 2 / (1.0 - conjugate_multiplier) + abs(g02) ** 2 / (
        2.0 * (multiplier**2 - conjugate_multiplier)
    )
    eigenvector_area = 2.0 * abs(np.linalg.det(np.stack([right_eigenvector.real, right_eigenvector.imag])))
    return float((conjugate_multiplier * cubic_coefficient).imag / eigenvector_area)
