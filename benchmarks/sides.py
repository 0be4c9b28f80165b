"""Define the methods between rigid and soft walls, their settings and numbers of states."""

import functools
from collections.abc import Callable
from typing import NamedTuple

from benchmarks import diffrax_event, heyoka_batch, heyoka_scalar, ours, rk4, scipy_ivp
from benchmarks.harness import Side
from benchmarks.work import CAP, CUBIC, held

FINE, COARSE = (1e-6, 1e-9, 1e-12, 1e-15), (1e-4, 1e-6, 1e-8, 1e-10)
OURS = "jaxvibro"
VMAP = "jaxvibro, jit(vmap)"
BY_SOLVER = "jaxvibro with Dopri8"
YARDSTICK = "hand-written kernel"
PLAIN = "SciPy LSODA without events"
STATES = 98_304
SLOTS = (0, 4, CAP)  # numbers of impacts that this package records; the first is compared with the rivals
BESIDE = 32_768  # number of states of this package beside the rivals between soft walls


class Rival(NamedTuple):
    """Method: its map, number of states, settings and how to print one."""

    strobe: Callable
    states: int
    settings: tuple
    words: str = "tol {:g}"


# On one core larger batches are not faster.
diffrax_in_blocks = functools.partial(diffrax_event.strobe, block=32)
RIGID = {
    "heyoka, batch": Rival(heyoka_batch.strobe, 4096, FINE),
    "heyoka, scalar": Rival(heyoka_scalar.strobe, 4096, FINE),
    "paper's RK4": Rival(rk4.strobe, 4096, (50, 100, 200, 400, 800), "{} steps"),
    "diffrax Tsit5": Rival(diffrax_in_blocks, 2048, (1e-6, 1e-9, 1e-11)),
    "SciPy DOP853": Rival(scipy_ivp.strobe, 256, (1e-6, 1e-9, 1e-12)),
}
SOFT = {
    "heyoka, batch": Rival(heyoka_batch.strobe, 2048, FINE),
    "heyoka, scalar": Rival(heyoka_scalar.strobe, 2048, FINE),
    "diffrax Tsit5": Rival(diffrax_in_blocks, 512, COARSE),
    "diffrax Kvaerno5": Rival(functools.partial(diffrax_in_blocks, solver="Kvaerno5"), 128, COARSE),
    "SciPy RK45": Rival(functools.partial(scipy_ivp.strobe, method="RK45"), 64, COARSE),
    "SciPy LSODA": Rival(functools.partial(scipy_ivp.strobe, method="LSODA"), 64, COARSE),
    PLAIN: Rival(functools.partial(scipy_ivp.plain, method="LSODA"), 64, COARSE),
    "SciPy Radau": Rival(functools.partial(scipy_ivp.strobe, method="Radau"), 64, COARSE[:3]),
}


DUFFING = {
    "heyoka, batch": Rival(heyoka_batch.strobe, 2048, FINE),
    "heyoka, scalar": Rival(heyoka_scalar.strobe, 1024, FINE),
    "diffrax Tsit5": Rival(diffrax_in_blocks, 512, (1e-6, 1e-9, 1e-11)),
    "diffrax Dopri8": Rival(functools.partial(diffrax_in_blocks, solver="Dopri8"), 256, (1e-6, 1e-9, 1e-11)),
    "SciPy DOP853": Rival(scipy_ivp.strobe, 64, (1e-6, 1e-9, 1e-12)),
}
# Tolerances of this package under a user-defined force, the default first.
TOLERANCES = (1e-13, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14)
MANY = 10_000  # number of states of this package under this force
BY_DOPRI8, FEW = (1e-6, 1e-9, 1e-12), 512  # tolerances and number of states of this package with another solver


def read(answer):
    """Return the ends and sides of Strobes."""
    return answer.ends, answer.sides


def rivals(table, size, **more):
    """Make the Sides of a table's rivals, one per setting.

    `size` is a `Size`; further arguments are the stiffness of soft walls and the cubic term of a spring.
    """

    def side(method, rival, setting):
        def prepare(rows):
            return functools.partial(rival.strobe, rows, setting, **more)

        return Side(method, rival.words.format(setting), size.states(rival.states), prepare, read)

    return [side(method, rival, setting) for method, rival in table.items() for setting in rival.settings]


def own(method, setting, prepare, states):
    """Make a Side for a way to call this package's map."""
    return Side(method, setting, states, prepare, ours.read)


def recording(slots):
    """The setting with so many impacts recorded, in words."""
    return f"{slots} impacts recorded" if slots else "no impacts recorded"


def rigid(yardstick, size):
    """Return this package without record, and the others (a list) with the hand-written kernel unless it is None."""
    states = size.states(STATES)
    us, *more = (own(OURS, recording(s), functools.partial(ours.prepare_batch, slots=s), states) for s in SLOTS)
    others = [*more, own(VMAP, recording(0), ours.prepare_vmap, states)]
    if yardstick:

        def prepare(rows):
            return functools.partial(yardstick, rows)

        others.append(Side(YARDSTICK, "", states, prepare, lambda ends: (ends, None)))
    return us, others + rivals(RIGID, size)


def soft(stiffness, size):
    """Return this package and the others (a list) at a stiffness."""
    prepare = functools.partial(ours.prepare_batch, stiffness=stiffness, damping=held(stiffness))
    return own(OURS, "", prepare, size.states(BESIDE)), rivals(SOFT, size, stiffness=stiffness)


def duffing(size):
    """Return this package at its default tolerance, and the others, for Duffing's oscillator without record."""
    us, *more = (
        own(OURS, f"tol {each:g}", functools.partial(ours.prepare_duffing, tolerance=each, slots=0), size.states(MANY))
        for each in TOLERANCES
    )
    more += [
        own(
            BY_SOLVER,
            f"tol {each:g}",
            functools.partial(ours.prepare_duffing, tolerance=each, solver="Dopri8", slots=0),
            size.states(FEW),
        )
        for each in BY_DOPRI8
    ]
    return us, more + rivals(DUFFING, size, cubic=CUBIC)
