"""Who takes part, at which settings and on how many states."""

import functools

from benchmarks import diffrax_event, heyoka_batch, heyoka_scalar, limit, ours, rk4, scipy_dop853
from benchmarks.harness import Side

# method: its strobe, how many states it is given, how a setting reads, the settings
RIVALS = {
    "heyoka, batch": (heyoka_batch.strobe, 4096, "tol {:g}", (1e-6, 1e-9, 1e-12, 1e-15)),
    "heyoka, scalar": (heyoka_scalar.strobe, 4096, "tol {:g}", (1e-6, 1e-9, 1e-12, 1e-15)),
    "paper's RK4": (rk4.strobe, 4096, "{} steps", (50, 100, 200, 400, 800)),
    "diffrax Tsit5": (diffrax_event.strobe, 2048, "tol {:g}", (1e-6, 1e-9, 1e-11)),
    "SciPy DOP853": (scipy_dop853.strobe, 256, "tol {:g}", (1e-6, 1e-9, 1e-12)),
}
OURS = "jaxvibro"
VMAP = "jaxvibro, user's vmap"
YARDSTICK = "yardstick"
STATES = 100_000


def read(answer):
    """Ends and sides of Strobes."""
    return answer.ends, answer.sides


def rival(method, strobe, states, words, setting):
    """A Side for a rival's strobe at one setting."""

    def prepare(rows):
        return functools.partial(strobe, rows, setting)

    return Side(method, words.format(setting), states, prepare, read)


def own(method, prepare, states):
    """A Side for a way to call our own strobe."""
    return Side(method, "", states, prepare, lambda answer: read(ours.read(answer)))


def yardstick(directory, states):
    """A Side for the yardstick in a directory, and how it describes itself."""
    strobe, words = limit.load(directory)
    return Side(YARDSTICK, "", states, lambda rows: functools.partial(strobe, rows), lambda ends: (ends, None)), words


def assemble(directory, share):
    """Ours, the others (a list), and a line on the yardstick. share: the part of the usual states to give."""
    line = limit.refusal(directory)
    others = [own(VMAP, ours.prepare_vmap, STATES // share)]
    if line is None:
        side, line = yardstick(directory, STATES // share)
        others.append(side)
    for method, (strobe, states, words, settings) in RIVALS.items():
        others += [rival(method, strobe, states // share, words, setting) for setting in settings]
    return own(OURS, ours.prepare_batch, STATES // share), others, line
