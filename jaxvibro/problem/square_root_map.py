"""Nordmark's map near a grazing of a rigid wall, and orbits of this map with one impact in n returns.

At the grazing contact, let y be the difference between (x, v) and the state of the orbit that omits the contact. Let d
be the depth of a contact. From one contact to the next

    y -> M (y + E sqrt(d)),  d = C y + mu,    C y = side x,  E = -side root (0, 1),

without the root if d < 0 (Nordmark, J. Sound Vib. 145, 279, 1991). mu is the depth of the orbit that omits the contact,
and root is `GrazingJump.root`. An orbit with one impact in n returns and s = sqrt(d) at this impact satisfies

    s^2 - q s = mu,  q = C (I - M^n)^-1 M^n E,    and k returns later  d = mu + g_k s,  g_k = C M^k (I - M^n)^-1 E.

The orbit does not reach the wall k returns later while s < q - g_k. With the determinant of M and c_n = C M^n E,

    q = c_n / det(I - M^n),    g_k = (c_k + det(M)^k c_(n-k)) / det(I - M^n).

The multipliers of the orbit are the eigenvalues of M^n (I + E C / 2 s). A multiplier is 1 at s = q / 2, and -1 at s =
-c_n / 2 det(I + M^n).

- If c_n < 0 for all n, the motion remains near the grazing orbit. For real multipliers 0 <= m < l of M and large n, the
  stable orbits with one impact in n returns have windows from s = ``|c_n|`` / 2 to ``|c_(n-1)| - |c_n|``. There are no
  windows if l > 2/3, and each window overlaps the next window if l < 1/4 (Chin, Ott, Nusse and Grebogi, Phys. Rev. E
  50, 4427, 1994). The windows end at values of mu proportional to l^(2 n).
- Let n be the first number with c_n > 0, if there is one. An impact with a small s is then followed by an impact with
  the larger value sqrt(c_n s), until s is about q of this n. The motion leaves the neighbourhood of the grazing orbit,
  and the orbit with one impact in n returns exists on both sides of the grazing.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

MAX_RETURNS = 64  # beyond this many returns the sign of C M^n E is rounding
ZERO_RESPONSE = 1e-8  # relative to the size that C M^n E may have; smaller responses have no sign


class AddedImpactWindow(NamedTuple):
    """Window of the orbits with one impact in n returns, in terms of s = sqrt(depth) at the impact.

    The depth of the orbit that omits the contact is mu = s^2 - `linear_coefficient` s.

    Attributes
    ----------
    linear_coefficient : float
        Coefficient q.
    next_grazing_root : float
        Value of s at the next grazing of the orbits, inf without a next grazing. The orbits exist from s = 0 to this
        value.
    min_stable_root : float
        Value of s above which the orbits are stable, nan if no orbit is stable.
    fold_root, doubling_root : float
        Values of s at which a multiplier is 1 and -1, nan outside the window.
    """

    linear_coefficient: float
    next_grazing_root: float
    min_stable_root: float
    fold_root: float
    doubling_root: float

    def depth(self, depth_root: float) -> float:
        """Return mu for a value of s, the depth of the orbit that omits the contact."""
        return depth_root * depth_root - self.linear_coefficient * depth_root


class SquareRootMap(NamedTuple):
    """Square-root map at a grazing.

    Parameters
    ----------
    jump_coefficient : float
        Jump of the velocity divided by the square root of the depth.
    matrix : ndarray
        Derivative M of a return, array of shape (2, 2).
    """

    jump_coefficient: float
    matrix: Float[np.ndarray, "2 2"]

    @property
    def multipliers(self) -> Complex[np.ndarray, "2"]:
        """Eigenvalues of M, complex array of shape (2,), the larger first."""
        eigenvalues = np.linalg.eigvals(self.matrix).astype(complex)
        return eigenvalues[np.argsort(-abs(eigenvalues), kind="stable")]

    def matrix_powers(self, max_power: int) -> Float[np.ndarray, "powers 2 2"]:
        """Return M^n for n = 0 to `max_power`, array of shape (max_power + 1, 2, 2)."""
        power_matrices = [np.eye(2)]
        for _ in range(max_power):
            power_matrices.append(self.matrix @ power_matrices[-1])
        return np.stack(power_matrices)

    def impact_responses(self, max_power: int) -> Float[np.ndarray, " powers"]:
        """Return C M^n E for n = 0 to `max_power`, array of shape (max_power + 1,)."""
        return -self.jump_coefficient * self.matrix_powers(max_power)[:, 0, 1]

    def first_positive_response(self) -> int | None:
        """Return the first n with C M^n E > 0; 0 without one up to `MAX_RETURNS`, None if rounding hides a sign."""
        responses, spectral_radius = self.impact_responses(MAX_RETURNS), abs(self.multipliers[0])
        if abs(responses[1]) <= ZERO_RESPONSE * self.jump_coefficient * abs(self.matrix).max():
            return None
        for n_returns in range(1, MAX_RETURNS + 1):
            if abs(responses[n_returns]) <= ZERO_RESPONSE * abs(responses[1]) * spectral_radius ** (n_returns - 1):
                return None
            if responses[n_returns] > 0:
                return n_returns
        return 0

    def added_impact_window(self, n_returns: int) -> AddedImpactWindow:
        """Return the `AddedImpactWindow` of n returns, for a stable grazing orbit."""
        responses, determinant = self.impact_responses(n_returns), np.linalg.det(self.matrix)
        trace = np.trace(self.matrix_powers(n_returns)[n_returns])
        fold_determinant, flip_determinant = 1.0 - trace + determinant**n_returns, 1.0 + trace + determinant**n_returns
        linear_coefficient = responses[n_returns] / fold_determinant
        later_return_responses = np.array(
            [(responses[k] + determinant**k * responses[n_returns - k]) / fold_determinant for k in range(1, n_returns)]
        )
        grazing_root = float((linear_coefficient - later_return_responses).min(initial=np.inf))
        fold_root, doubling_root = (
            root if 0.0 < root < grazing_root else np.nan
            for root in (0.5 * linear_coefficient, -0.5 * responses[n_returns] / flip_determinant)
        )
        min_stable_root = (
            np.nanmin([fold_root, doubling_root])
            if grazing_root > 0 and not np.isnan([fold_root, doubling_root]).all()
            else np.nan
        )
        return AddedImpactWindow(
            float(linear_coefficient), grazing_root, float(min_stable_root), float(fold_root), float(doubling_root)
        )
