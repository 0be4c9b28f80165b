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

MOST = 64  # returns: after as many a sign of C M^n E is rounding
NONE = 1e-8  # of the root times M's largest entry, or of what C M^n E may be: as small has no sign


class OneImpactWindow(NamedTuple):
    """Orbits with one impact in n returns, each s = sqrt(depth) at it, mu = s^2 - q s: they exist from s = 0 to touch,
    where they meet the wall once more, inf if they do not; stable from stable on, nan where none is. fold, doubling: s
    where a multiplier is 1, or -1, nan if not between."""

    q: float
    touch: float
    stable: float
    fold: float
    doubling: float

    def depth(self, s: float) -> float:
        """mu."""
        return s * s - self.q * s


class SquareRootMap(NamedTuple):
    """root: how much the velocity jumps by, over the root of the depth; matrix: M."""

    root: float
    matrix: Float[np.ndarray, "2 2"]

    @property
    def multipliers(self) -> Complex[np.ndarray, "2"]:
        """M's, the larger first: (2,) complex."""
        found = np.linalg.eigvals(self.matrix).astype(complex)
        return found[np.argsort(-abs(found), kind="stable")]

    def powers(self, count: int) -> Float[np.ndarray, "powers 2 2"]:
        """M^n for n = 0 to count: (count + 1, 2, 2)."""
        found = [np.eye(2)]
        for _ in range(count):
            found.append(self.matrix @ found[-1])
        return np.stack(found)

    def responses(self, count: int) -> Float[np.ndarray, " powers"]:
        """C M^n E for n = 0 to count: (count + 1,)."""
        return -self.root * self.powers(count)[:, 0, 1]

    def first_deeper(self) -> int | None:
        """The first n for which C M^n E > 0, 0 where there is none up to MOST, None where one before has no sign."""
        found, size = self.responses(MOST), abs(self.multipliers[0])
        if abs(found[1]) <= NONE * self.root * abs(self.matrix).max():
            return None
        for n in range(1, MOST + 1):
            if abs(found[n]) <= NONE * abs(found[1]) * size ** (n - 1):
                return None
            if found[n] > 0:
                return n
        return 0

    def window(self, n: int) -> OneImpactWindow:
        """The `OneImpactWindow` of n returns, of an orbit that is stable itself."""
        found, shrink = self.responses(n), np.linalg.det(self.matrix)
        trace = np.trace(self.powers(n)[n])
        closed, turned = 1.0 - trace + shrink**n, 1.0 + trace + shrink**n
        q = found[n] / closed
        later = np.array([(found[k] + shrink**k * found[n - k]) / closed for k in range(1, n)])
        touch = float((q - later).min(initial=np.inf))
        fold, doubling = (s if 0.0 < s < touch else np.nan for s in (0.5 * q, -0.5 * found[n] / turned))
        stable = np.nanmin([fold, doubling]) if touch > 0 and not np.isnan([fold, doubling]).all() else np.nan
        return OneImpactWindow(float(q), touch, float(stable), float(fold), float(doubling))
