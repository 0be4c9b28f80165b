"""The first coefficient of the normal form at a special point, whose sign says on which side the others are.

(Kuznetsov, Elements of Applied Bifurcation Theory: SN 5.24 and 5.4, HB 5.4, PD and NS 5.4.) B and C are the second and
third derivatives of the function by u, q and p the null vectors of the matrix and its transpose, p q = 1.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from .persistent_jit import SOON, persistent_jit
from .problem import matrix_at, residual_at


def _derived(function, direction, u):
    return jax.jvp(function, (u,), (direction,))[1]


def _derivatives(system, names, z, given, directions):
    size = len(z) - len(names)

    def along(each):
        function = lambda u: residual_at(system, names, jnp.concatenate([u, z[size:]]), given)  # noqa: E731
        for one in each:
            function = partial(_derived, function, one)
        return function(z[:size])

    return jax.vmap(along)(directions)


@persistent_jit(static_argnums=(0, 1), compiler_options=SOON, numpy_first=True)
def derivatives(system, names, z, given, directions):
    """The derivatives of F by u, each along some directions; directions: (count, order, n)."""
    return _derivatives(system, names, z, given, directions)


def border(matrix):
    """(b, c): the nearly null vectors of a matrix's transpose and of the matrix."""
    left, _, right = np.linalg.svd(np.asarray(matrix))
    return left[:, -1], right[-1]


def bent(system, kind, names, z, given, reference):
    """p B(q, q) at SN, p (C(q, q, q) - 3 B(q, A^-1 B(q, q))) / (6 p q) at PD and SB, A the derivative of F, at SB on
    what the symmetry keeps; (p, q) by the bordered systems with a reference (b, c), so that it is a smooth function of
    z."""
    matrix = matrix_at(system, kind, names, z, given)
    b, c = reference
    whole = np.block([[matrix, b[:, None]], [c[None], np.zeros((1, 1))]])
    unit = np.append(np.zeros(len(c)), 1.0)
    q, p = np.linalg.solve(whole, unit)[:-1], np.linalg.solve(whole.T, unit)[:-1]
    plain, kept = system._replace(within=False), 2.0 * np.eye(len(q)) - matrix  # -A at PD, where the matrix is A + 2
    (second,) = derivatives(plain, names, z, given, np.array([[q, q]]))
    if kind == "SN":
        return float(p @ second)
    if kind == "SB":
        kept = -matrix_at(system._replace(within=True), "SN", names, z, given)
    h = np.linalg.solve(kept, second)
    (mixed,), (third,) = (derivatives(plain, names, z, given, np.array([each])) for each in ([q, h], [q, q, q]))
    return float(p @ (third + 3.0 * mixed) / (6.0 * (p @ q)))


def critical(kind, values):
    """Of eigenvalues that of the pair which is at an event, HB or NS, the imaginary part positive; the nearest. NaN
    where none is complex."""
    pairs = values[values.imag > 0]
    off = abs(pairs.real) if kind == "HB" else abs(abs(pairs) - 1.0)
    return pairs[int(np.argmin(off))] if len(pairs) else complex(np.nan, np.nan)


def lyapunov(system, kind, names, z, given):
    """The first Lyapunov coefficient of a Hopf point, Re(g) / (2 frequency), and that of a Neimark-Sacker point,
    Re(conj(value) g) / 2: negative where what is born is stable; with q of length 1, p q = 1.

    g = p (C(q, q, q*) + 2 B(q, (s - A)^-1 B(q, q*)) + B(q*, (r - A)^-1 B(q, q))), s = 0 and r = 2 value at HB, s = 1
    and r = value^2 at NS, A the matrix with the eigenvalue value, * the conjugate.
    """
    matrix = matrix_at(system, "", names, z, given)
    value, unit = critical(kind, np.linalg.eigvals(matrix).astype(complex)), np.eye(len(matrix))
    if not np.isfinite(value):
        return np.nan
    left, _, right = np.linalg.svd(matrix - value * unit)
    q, p = right[-1].conj(), left[:, -1].conj()
    a, b = q.real, q.imag
    aa, ab, bb = derivatives(system, names, z, given, np.array([[a, a], [a, b], [b, b]]))
    level, twice = (0.0, 2.0 * value) if kind == "HB" else (1.0, value * value)
    mean = np.linalg.solve(level * unit - matrix, aa + bb)
    double = np.linalg.solve(twice * unit - matrix, aa - bb + 2j * ab)
    pairs = [(a, mean), (b, mean), (a, double.real), (b, double.imag), (a, double.imag), (b, double.real)]
    am, bm, *rest = derivatives(system, names, z, given, np.array(pairs))
    aaa, aab, abb, bbb = derivatives(system, names, z, given, np.array([[a, a, a], [a, a, b], [a, b, b], [b, b, b]]))
    cubic, mixed = aaa + abb + 1j * (aab + bbb), 2.0 * (am + 1j * bm)
    g = p @ (cubic + mixed + rest[0] + rest[1] + 1j * (rest[2] - rest[3])) / (p @ q)
    return float(g.real / (2.0 * value.imag) if kind == "HB" else 0.5 * (value.conjugate() * g).real)
