"""Measure the cost of soft walls: this package's map between soft walls over that between rigid ones, in turn."""

import numpy as np

from benchmarks import ours, page
from benchmarks.harness import clock
from benchmarks.rows import spread
from benchmarks.work import held, words

STATES = 98_304
STIFFNESSES = (1.0, 10.0, 1e2, 1e4, 1e6, 1e8, 1e10)
DAMPING = 0.1  # gamma2 where R is not held
HEAD = ("k2", "gamma2 for R = 0.7", "soft relative to rigid", "gamma2", "soft relative to rigid")


def compare(states, rounds):
    """Return {(k2, gamma2): soft over rigid in each round} for (n, 3) states x, x', A."""
    rigid = ours.prepare_batch(states)
    given = [(stiffness, damping) for stiffness in STIFFNESSES for damping in (held(stiffness), DAMPING)]
    calls = {each: ours.prepare_batch(states, *each) for each in given}
    for call in (rigid, *calls.values()):
        call()
    ratios = {each: [] for each in calls}
    for _ in range(rounds):
        for each, call in calls.items():
            before, _ = clock(rigid)
            between, _ = clock(call)
            after, _ = clock(rigid)
            ratios[each].append(2.0 * between / (before + after))
    return {each: np.array(found) for each, found in ratios.items()}


def table(ratios):
    """Format the ratios as Markdown, medians and quartiles."""
    lines = []
    for stiffness in STIFFNESSES:
        damping = held(stiffness)
        own, same = (page.spread(spread(ratios[stiffness, each])) for each in (damping, DAMPING))
        lines.append((words(stiffness), f"{damping:.4g}", own, f"{DAMPING:g}", same))
    return page.table(HEAD, lines)


def worst(ratios):
    """Return the ratios with the largest median, and their stiffness and damping."""
    each = max(ratios, key=lambda one: np.median(ratios[one]))
    return ratios[each], each
