"""Who takes part between rigid walls and between soft ones, at which settings and on how many states."""

import functools
from collections.abc import Callable
from typing import NamedTuple

from benchmarks import diffrax_event, heyoka_batch, heyoka_scalar, ours, rk4, scipy_ivp
from benchmarks.harness import Side
from benchmarks.work import CAP, CUBIC, held

FINE, COARSE = (1e-6, 1e-9, 1e-12, 1e-15), (1e-4, 1e-6, 1e-8, 1e-10)
OURS = "jaxvibro"
VMAP = "jaxvibro, user's vmap"
BY_SOLVER = "jaxvibro by Dopri8"
YARDSTICK = "yardstick"
PLAIN = "SciPy LSODA, no events"
STATES = 98_304
SLOTS = (0, 4, CAP)  # recorded by ours; the first stands beside the rivals
BESIDE = 32_768  # ours, beside the rivals between soft walls


class Rival(NamedTuple):
    """A method: its strobe, how many states it is given, its settings and how one reads."""

    strobe: Callable
    states: int
    settings: tuple
    words: str = "tol {:g}"


# On one core more lanes at once are no faster.
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
TOLERANCES = (1e-13, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14)  # of ours under a force of one's own, the default first
MANY = 10_000  # states of ours there
BY_DOPRI8, FEW = (1e-6, 1e-9, 1e-12), 512  # tolerances and states of ours by a solver


def read(answer):
    """Ends and sides of Strobes."""
    return answer.ends, answer.sides


def rivals(table, size, **more):
    """The Sides of a table's rivals, each at its settings. size: a `Size`; more: the stiffness of soft walls, the cubic
    of a spring."""

    def side(method, rival, setting):
        def prepare(rows):
            return functools.partial(rival.strobe, rows, setting, **more)

        return Side(method, rival.words.format(setting), size.states(rival.states), prepare, read)

    return [side(method, rival, setting) for method, rival in table.items() for setting in rival.settings]


def own(method, setting, prepare, states):
    """A Side for a way to call our own strobe."""
    return Side(method, setting, states, prepare, ours.read)


def recording(slots):
    """The setting with so many impacts recorded, in words."""
    return f"{slots} impacts recorded" if slots else "nothing recorded"


def rigid(yardstick, size):
    """Ours with nothing recorded, and the others (a list), the yardstick's strobe among them unless it is None."""
    states = size.states(STATES)
    us, *more = (own(OURS, recording(s), functools.partial(ours.prepare_batch, slots=s), states) for s in SLOTS)
    others = [*more, own(VMAP, recording(0), ours.prepare_vmap, states)]
    if yardstick:

        def prepare(rows):
            return functools.partial(yardstick, rows)

        others.append(Side(YARDSTICK, "", states, prepare, lambda ends: (ends, None)))
    return us, others + rivals(RIGID, size)


def soft(stiffness, size):
    """Ours and the others (a list) at a stiffness."""
    prepare = functools.partial(ours.prepare_batch, stiffness=stiffness, damping=held(stiffness))
    return own(OURS, "", prepare, size.states(BESIDE)), rivals(SOFT, size, stiffness=stiffness)


def duffing(size):
    """Ours at its default tolerance, and the others (a list), of Duffing's oscillator; nothing recorded by ours."""
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
