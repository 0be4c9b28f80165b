"""Nordmark's map near a grazing of a rigid wall, and its orbits with one impact in n returns.

Let y be the distance of (x, v), at the grazing contact, from the orbit that omits the contact, and d the depth that a
contact would have. From one contact to the next

    y -> M (y + E sqrt(d)),  d = C y + mu,    C y = side x,  E = -side root (0, 1),

without the root if d < 0 (Nordmark, J. Sound Vib. 145, 279, 1991). mu is the depth of the orbit itself and root is
`Depth.root`. An orbit with one impact in n returns and s = sqrt(d) at its impact satisfies

    s^2 - q s = mu,  q = C (I - M^n)^-1 M^n E,    and k returns later  d = mu + g_k s,  g_k = C M^k (I - M^n)^-1 E.

It stays off the wall there while s < q - g_k. With the trace and the determinant of M and c_n = C M^n E,

    q = c_n / det(I - M^n),    g_k = (c_k + det(M)^k c_(n-k)) / det(I - M^n).

Its multipliers are those of M^n (I + E C / 2 s): one is 1 at s = q / 2, one is -1 at s = -c_n / 2 det(I + M^n).

If c_n < 0 for all n, the motion stays near. For real multipliers 0 <= m < l the orbits with one impact in n returns
have windows from s = ``|c_n|`` / 2 to ``|c_(n-1)| - |c_n|`` for large n: none if l > 2/3; each window overlaps the next
if l < 1/4 (Chin, Ott, Nusse and Grebogi, Phys. Rev. E 50, 4427, 1994). The windows end at mu in proportion to l^(2 n).
If c_n > 0 first for some n, an impact with a small s is followed by one with sqrt(c_n s), which is larger, until s is
about q of that n. Then nothing stays near, and the orbit with one impact in n returns exists on both sides.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

MAX_RETURNS = 64  # beyond this many returns the sign of C M^n E is rounding
ZERO_RESPONSE = 1e-8  # relative to the size that C M^n E may have; smaller responses have no sign


class OneImpactWindow(NamedTuple):
    """Window of the orbits with one impact in n returns, in s = sqrt(depth) at the impact.

    mu = s^2 - `linear_coefficient` s.

    Attributes
    ----------
    linear_coefficient : float
        q.
    grazing_root : float
        s at the next grazing of the orbits, inf if there is none. The orbits exist from s = 0 to this value.
    min_stable_root : float
        s from which they are stable, nan if none is stable.
    fold_root, doubling_root : float
        s at which a multiplier is 1 or -1, nan if outside the window.
    """

    linear_coefficient: float
    grazing_root: float
    min_stable_root: float
    fold_root: float
    doubling_root: float

    def depth(self, depth_root: float) -> float:
        """Return mu at s."""
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

    def powers(self, max_power: int) -> Float[np.ndarray, "powers 2 2"]:
        """Return M^n for n = 0 to `max_power`, array of shape (max_power + 1, 2, 2)."""
        powers = [np.eye(2)]
        for _ in range(max_power):
            powers.append(self.matrix @ powers[-1])
        return np.stack(powers)

    def responses(self, max_power: int) -> Float[np.ndarray, " powers"]:
        """Return C M^n E for n = 0 to `max_power`, array of shape (max_power + 1,)."""
        return -self.jump_coefficient * self.powers(max_power)[:, 0, 1]

    def first_positive_response(self) -> int | None:
        """Return the first n with C M^n E > 0; 0 if none up to `MAX_RETURNS`, None if an earlier sign is open."""
        responses, spectral_radius = self.responses(MAX_RETURNS), abs(self.multipliers[0])
        if abs(responses[1]) <= ZERO_RESPONSE * self.jump_coefficient * abs(self.matrix).max():
            return None
        for n in range(1, MAX_RETURNS + 1):
            if abs(responses[n]) <= ZERO_RESPONSE * abs(responses[1]) * spectral_radius ** (n - 1):
                return None
            if responses[n] > 0:
                return n
        return 0

    def window(self, n: int) -> OneImpactWindow:
        """Return the `OneImpactWindow` of n returns, for a stable grazing orbit."""
        responses, determinant = self.responses(n), np.linalg.det(self.matrix)
        trace = np.trace(self.powers(n)[n])
        fold_determinant, flip_determinant = 1.0 - trace + determinant**n, 1.0 + trace + determinant**n
        linear_coefficient = responses[n] / fold_determinant
        later_responses = np.array(
            [(responses[k] + determinant**k * responses[n - k]) / fold_determinant for k in range(1, n)]
        )
        grazing_root = float((linear_coefficient - later_responses).min(initial=np.inf))
        fold_root, doubling_root = (
            root if 0.0 < root < grazing_root else np.nan
            for root in (0.5 * linear_coefficient, -0.5 * responses[n] / flip_determinant)
        )
        min_stable_root = (
            np.nanmin([fold_root, doubling_root])
            if grazing_root > 0 and not np.isnan([fold_root, doubling_root]).all()
            else np.nan
        )
        return OneImpactWindow(
            float(linear_coefficient), grazing_root, float(min_stable_root), float(fold_root), float(doubling_root)
        )
