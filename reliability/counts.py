"""Count the errors of each method in each case, with bounds on the rates."""

from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest

from benchmarks import page

from . import methods
from .cases import DOUBT, WHOLE
from .flights import SLACK

BATCH = 1 << 17
MILLION = 8  # batches of this package; one batch of flights certified piece by piece, and of doubtful ones
LEVEL = 0.95
APART = 0.05  # difference, relative to the time to `until`, beyond which a contact is another one


NOTES = (
    "Wrong flights per million, with Clopper-Pearson bounds at 95 %. A flight is wrong if a contact is missed, "
    "spurious, at the wrong wall or at the wrong time.",
    "The true contacts are known by construction and are decided in 80-bit floats for the given doubles; whole flights "
    "are certified step by step.",
    "jaxvibro computes the whole period, the other methods only the evaluated part.",
    f"A flight is in doubt if it has a turning point within {SLACK} ulp (of the largest length) of a wall. Flights in "
    "doubt are excluded, except for jaxvibro in the last case.",
    "A flight that begins on a wall stands for a user's restart at an event. heyoka finds no root of an event function "
    "that is 0 at the start, unless its own callback reverses the velocity. SciPy detects the start as an event again.",
)


class Count(NamedTuple):
    """Numbers of flights, of missed, spurious and wrong contacts (wall or time), and of excluded flights in doubt."""

    flights: int
    missed: int
    invented: int
    wrong: int
    doubtful: int = 0

    @property
    def bad(self):
        """Number of all errors."""
        return self.missed + self.invented + self.wrong

    def added(self, other):
        """Add two counts."""
        return Count(*(one + two for one, two in zip(self, other, strict=True)))

    @property
    def bounds(self):
        """Return the Clopper-Pearson bounds on the rate."""
        found = binomtest(self.bad, self.flights).proportion_ci(LEVEL, "exact")
        return found.low, found.high


def judged(flights, met, doubtful=0):
    """Return the `Count` of a method's result: a contact at another time is wrong."""
    true, seen = flights.side != 0, met.side != 0
    with np.errstate(invalid="ignore"):
        astray = abs(met.time - flights.time) > APART * flights.until
    other = true & seen & ((met.side != flights.side) | astray)
    return Count(len(true), int((true & ~seen).sum()), int((~true & seen).sum()), int(other.sum()), doubtful)


def of_case(case, size):
    """Return {method: Count} of a case: this package on all batches, the others on the first flights."""
    few, found = case in (WHOLE, DOUBT), {}
    width = size.states(BATCH // len(case.shapes) if few else BATCH)
    for k in range(len(case.shapes) if few or size.quick else MILLION):
        batch, doubtful = case.batch(width, k)
        counts = {methods.OURS: judged(batch, methods.ours(batch), doubtful)}
        for rival in methods.RIVALS if k < len(case.shapes) else ():
            some = batch.some(slice(size.states(rival.lanes) // len(case.shapes)))
            counts[rival.name] = judged(some, rival.met(some))
        for name, count in counts.items():
            found[name] = count.added(found[name]) if name in found else count
    return found


def by_speed(case, size):
    """Return {decade: {method: Count}} of a case that varies a speed; this package on `BATCH` flights per shape."""
    found = {}
    for k in range(len(case.shapes)):
        batch, _ = case.batch(size.states(BATCH), k)
        answers = {methods.OURS: (batch, methods.ours(batch))}
        for rival in methods.RIVALS:
            some = batch.some(slice(size.states(rival.lanes)))
            answers[rival.name] = some, rival.met(some)
        for name, (some, met) in answers.items():
            decade = np.floor(np.log10(some.measure)).astype(int)
            for each in np.unique(decade):
                here, own = decade == each, found.setdefault(int(each), {})
                count = judged(some.some(here), methods.Met(met.side[here], met.time[here]))
                own[name] = count.added(own[name]) if name in own else count
    return dict(sorted(found.items(), reverse=True))


def speeds_table(found):
    """Format {case: {decade: {method: Count}}} as Markdown."""
    names = (methods.OURS, *(rival.name for rival in methods.RIVALS))
    lines = []
    for case, decades in found.items():
        for decade, counts in decades.items():
            cells = (per_million(counts[name]) if name in counts else "no sample" for name in names)
            lines.append((case, f"1e{decade} to 1e{decade + 1}", *cells))
    return page.table(("case", "speed", *names), lines)


def per_million(count):
    """Format the rate, in bold if it is not zero."""
    low, high = (1e6 * bound for bound in count.bounds)
    rate = 1e6 * count.bad / count.flights
    if not count.bad:
        return f"0 (to {page.short(high)})"
    return f"**{page.short(rate)}** ({page.short(low)} to {page.short(high)})"


def table(found):
    """Format {case: {method: Count}} as Markdown: wrong flights per million."""
    head = ("case", methods.OURS, *(rival.name for rival in methods.RIVALS))
    lines = [(case.name, *map(per_million, counts.values())) for case, counts in found.items()]
    return page.table(head, lines)


def described(found):
    """Markdown of what the cases are: what is drawn, on how many flights of ours, how many in doubt, what was wrong."""
    head = ("case", "sample", "flights of jaxvibro", "in doubt, excluded", "jaxvibro: missed, spurious, wrong")
    lines = []
    for case, counts in found.items():
        own = counts[methods.OURS]
        wrong = f"{own.missed}, {own.invented}, {own.wrong}"
        lines.append((case.name, case.words, f"{own.flights:,}", f"{own.doubtful:,}", wrong))
    return page.table(head, lines)
