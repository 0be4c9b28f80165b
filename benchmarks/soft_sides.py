"""Who takes part between soft walls, at which settings and on how many states."""

import functools

from benchmarks import ours, soft_diffrax, soft_heyoka_batch, soft_heyoka_scalar, soft_ours, soft_scipy
from benchmarks.harness import Side
from benchmarks.sides import OURS, read
from benchmarks.soft_work import held

COARSE, FINE = (1e-4, 1e-6, 1e-8, 1e-10), (1e-6, 1e-9, 1e-12, 1e-15)
PLAIN = "SciPy LSODA, no events"
# method: its strobe, how many states it is given, the tolerances
RIVALS = {
    "heyoka, batch": (soft_heyoka_batch.strobe, 2048, FINE),
    "heyoka, scalar": (soft_heyoka_scalar.strobe, 2048, FINE),
    "diffrax Tsit5": (functools.partial(soft_diffrax.strobe, solver="Tsit5"), 512, COARSE),
    "diffrax Kvaerno5": (functools.partial(soft_diffrax.strobe, solver="Kvaerno5"), 128, COARSE),
    "SciPy RK45": (functools.partial(soft_scipy.strobe, method="RK45"), 64, COARSE),
    "SciPy LSODA": (functools.partial(soft_scipy.strobe, method="LSODA"), 64, COARSE),
    PLAIN: (functools.partial(soft_scipy.plain, method="LSODA"), 64, COARSE),
    "SciPy Radau": (functools.partial(soft_scipy.strobe, method="Radau"), 64, COARSE[:3]),
}
STATES = 32_768  # ours, beside the rivals


def rival(method, stiffness, share, tolerance):
    """A Side for a rival at one tolerance."""
    strobe, states, _ = RIVALS[method]

    def prepare(rows):
        return functools.partial(strobe, rows, stiffness, tolerance)

    reader = (lambda ends: (ends, None)) if method == PLAIN else read
    return Side(method, f"tol {tolerance:g}", states // share, prepare, reader)


def assemble(stiffness, share):
    """Ours and the others (a list) at a stiffness. share: the part of the usual states to give."""

    def prepare(rows):
        return soft_ours.prepare(rows, stiffness, held(stiffness))

    own = Side(OURS, "", STATES // share, prepare, lambda answer: read(ours.read(answer)))
    return own, [
        rival(method, stiffness, share, tolerance)
        for method, (_, _, tolerances) in RIVALS.items()
        for tolerance in tolerances
    ]
