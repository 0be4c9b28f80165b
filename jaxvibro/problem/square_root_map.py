"""What follows a grazing of a rigid wall: Nordmark's map near it, and its orbits with one impact in n returns.

Let y be how far (x, v) is, at the touch, from where the orbit that leaves it out would be, and d the depth that a
contact would have there. From touch to touch

    y -> M (y + E sqrt(d)),  d = C y + mu,    C y = side x,  E = -side root (0, 1),

without the root where d < 0 (Nordmark, J. Sound Vib. 145, 279, 1991): mu is how deep the orbit itself would go, root
`Depth.root`. With s = sqrt(d) at its impact an orbit with one in n returns has

    s^2 - q s = mu,  q = C (I - M^n)^-1 M^n E,    and k returns later  d = mu + g_k s,  g_k = C M^k (I - M^n)^-1 E,

so that it keeps off the wall there while s < q - g_k. By M's trace and determinant, with c_n = C M^n E,

    q = c_n / det(I - M^n),    g_k = (c_k + det(M)^k c_(n-k)) / det(I - M^n).

Its multipliers are those of M^n (I + E C / 2 s): one is 1 at s = q / 2, one is -1 at s = -c_n / 2 det(I + M^n).

Where c_n < 0 for all n, the motion stays near. For real multipliers 0 <= m < l the orbits with one impact in n returns
have windows from s = |c_n| / 2 to |c_(n-1)| - |c_n| for large n: none where l > 2/3, and one overlaps the next where
l < 1/4, as in Chin, Ott, Nusse and Grebogi, Phys. Rev. E 50, 4427, 1994; the windows end at mu in proportion to
l^(2 n). Where c_n > 0 first for some n, an impact with a small s is followed by one with sqrt(c_n s), which is larger,
until s is about q of that n: nothing stays near, and the orbit with one impact in n returns is there on both sides.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

MAX_RETURNS = 64  # returns: after as many a sign of C M^n E is rounding
ZERO_RESPONSE = 1e-8  # of the root times M's largest entry, or of what C M^n E may be: as small has no sign


class OneImpactWindow(NamedTuple):
    """Orbits with one impact in n returns, each s = sqrt(depth) at it, mu = s^2 - q s: they exist from s = 0 to touch,
    where they meet the wall once more, inf if they do not; stable from stable on, nan where none is. fold_root,
    doubling_root: s where a multiplier is 1, or -1, nan if not between."""

    linear_coefficient: float
    grazing_root: float
    min_stable_root: float
    fold_root: float
    doubling_root: float

    def depth(self, depth_root: float) -> float:
        """mu."""
        return depth_root * depth_root - self.linear_coefficient * depth_root


class SquareRootMap(NamedTuple):
    """jump_coefficient: how much the velocity jumps by, over the root of the depth; matrix: M."""

    jump_coefficient: float
    matrix: Float[np.ndarray, "2 2"]

    @property
    def multipliers(self) -> Complex[np.ndarray, "2"]:
        """M's, the larger first: (2,) complex."""
        eigenvalues = np.linalg.eigvals(self.matrix).astype(complex)
        return eigenvalues[np.argsort(-abs(eigenvalues), kind="stable")]

    def powers(self, max_power: int) -> Float[np.ndarray, "powers 2 2"]:
        """M^n for n = 0 to max_power: (count + 1, 2, 2)."""
        powers = [np.eye(2)]
        for _ in range(max_power):
            powers.append(self.matrix @ powers[-1])
        return np.stack(powers)

    def responses(self, max_power: int) -> Float[np.ndarray, " powers"]:
        """C M^n E for n = 0 to max_power: (count + 1,)."""
        return -self.jump_coefficient * self.powers(max_power)[:, 0, 1]

    def first_positive_response(self) -> int | None:
        """The first n for which C M^n E > 0, 0 where there is none up to MOST, None where one before has no sign."""
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
        """The `OneImpactWindow` of n returns, of an orbit that is stable itself."""
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
