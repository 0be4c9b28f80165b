"""What lasts in a scene, for verdicts: all attractors, and what stays unresolved, which may be anything."""

import numpy as np

from ..attractors.spectrum import spectrum
from ..maps.initial_conditions import random_starts
from ..scene.state import State

DOUBT = 3.0  # standard errors by which an exponent is above 0
STEP, STARTS, ERROR, MOST = 0.02, 16, 0.03, 2**14  # of the look for where chaos begins
LONG = 3000  # drive periods after which what is found there must still be chaotic


def shares(motions):
    """Motions and their shares of the starts, in words."""
    return ", ".join(f"{one.label} ({100 * one.share:.0f} %)" for one in motions)


def more(motions):
    """How many more there may be: any number where some starts are unresolved."""
    return np.inf if any(one.kind == "unresolved" for one in motions) else 0.0


def largest(scene, attractors):
    """((exponent, error), more): the largest Lyapunov exponent of all that lasts, of one of the unresolved starts too.

    more: how much larger another's may be: of the unresolved starts only one is looked at."""
    value = float(scene.amplitude)
    x, v, contact = (np.array([getattr(one.state, key) for one in attractors], float) for key in ("x", "v", "contact"))
    found = spectrum(scene, "amplitude", np.full(len(x), value), State(x, v, 0.0, contact))
    exponent, error = (found[key].values[:, 0] for key in ("exponent", "error"))
    if np.isnan(exponent).all():
        return (np.nan, np.nan), more(attractors)
    place = int(np.nanargmax(exponent))
    return (float(exponent[place]), float(error[place])), more(attractors)


def onset(scene, low, high):
    """(amplitude, its doubt, number of chaotic starts, largest exponent): the lowest amplitude of those looked at, a
    `STEP` apart, at which one of some starts settles on chaos; nan where none does. Chaos begins there or below."""
    values = np.arange(high, low, -STEP)[::-1]
    starts = random_starts(scene, len(values) * STARTS, 0)
    lanes = np.repeat(values, STARTS)
    wild, _ = _chaotic(scene, lanes, starts, error=ERROR, most=MOST)
    for value in values[wild.reshape(-1, STARTS).any(axis=1)]:
        here = wild & (lanes == value)
        sure, rates = _chaotic(scene, lanes[here], State(starts.x[here], starts.v[here]), settle=LONG)
        if sure.any():
            return float(value), STEP, int(sure.sum()), float(rates[sure].max())
    return np.nan, np.nan, 0, np.nan


def _chaotic(scene, values, starts, **asked):
    """(whether the largest exponent from each start is positive beyond doubt, the exponents)."""
    found = spectrum(scene, "amplitude", values, starts, **asked)
    exponent, error = (found[key].values[:, 0] for key in ("exponent", "error"))
    return (exponent - DOUBT * error > 0) & (found["periods"].values == 0), exponent


def stable_at(branches, value):
    """The labels of the stable orbits on branches at a value of their parameter, one for each time they come by."""
    found = []
    for branch in branches:
        for part in branch.segments:
            places = slice(part.first, part.last + 1)
            ahead, stable = branch.values[places] - value, branch.stable[places]
            met = (ahead[:-1] * ahead[1:] <= 0) & (ahead[:-1] != 0) & stable[:-1] & stable[1:]
            found += [part.label] * int(met.sum())
    return found
