"""What each method gets wrong in each case, and the bounds on its rate."""

from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest

from benchmarks import page

from . import methods
from .cases import DOUBT, WHOLE
from .flights import SLACK

BATCH = 1 << 17
MILLION = 8  # batches of ours; of flights that are certified piece by piece, and of those in doubt, one
LEVEL = 0.95
APART = 0.05  # of the time to `until`: a contact that is so far off is another one


NOTES = (
    "Wrong flights a million, with Clopper and Pearson's bounds at 95 %: a contact missed, invented, at another wall "
    "or time. The truth is laid down by construction and decided in 80-bit floats for the doubles that are given; "
    "whole flights are certified piece by piece.",
    f"Ours flies the whole period, the others as far as is judged. In doubt is what turns back within {SLACK} ulp of "
    "the largest length of a wall: the last case counts ours there too.",
    "A flight that begins on a wall is a user's restart at an event. heyoka finds no root of an event that is 0 at the "
    "start; where its own callback turns the mass round it does. SciPy finds the start again.",
)


class Count(NamedTuple):
    """Of so many flights: contacts missed, invented, wrong (another wall or time); and flights in doubt, which nobody
    is judged on."""

    flights: int
    missed: int
    invented: int
    wrong: int
    doubtful: int = 0

    @property
    def bad(self):
        """All that is wrong."""
        return self.missed + self.invented + self.wrong

    def added(self, other):
        """Both together."""
        return Count(*(one + two for one, two in zip(self, other, strict=True)))

    @property
    def bounds(self):
        """Clopper and Pearson's bounds on the rate."""
        found = binomtest(self.bad, self.flights).proportion_ci(LEVEL, "exact")
        return found.low, found.high


def judged(flights, met, doubtful=0):
    """The `Count` of a method's answer: a contact at another time is a wrong one."""
    true, seen = flights.side != 0, met.side != 0
    with np.errstate(invalid="ignore"):
        astray = abs(met.time - flights.time) > APART * flights.until
    other = true & seen & ((met.side != flights.side) | astray)
    return Count(len(true), int((true & ~seen).sum()), int((~true & seen).sum()), int(other.sum()), doubtful)


def of_case(case, size):
    """{method: Count} of a case: ours on all batches, the others on the first of the flights."""
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
    """{decade: {method: Count}} of a case that varies a speed; ours on as many flights as `BATCH` for each shape."""
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
    """Markdown of {case: {decade: {method: Count}}}."""
    names = (methods.OURS, *(rival.name for rival in methods.RIVALS))
    lines = []
    for case, decades in found.items():
        for decade, counts in decades.items():
            cells = (per_million(counts[name]) if name in counts else "none drawn" for name in names)
            lines.append((case, f"1e{decade} to 1e{decade + 1}", *cells))
    return page.table(("case", "speed", *names), lines)


def per_million(count):
    """The rate as text, in bold where there is one."""
    low, high = (1e6 * bound for bound in count.bounds)
    rate = 1e6 * count.bad / count.flights
    if not count.bad:
        return f"0 (to {page.short(high)})"
    return f"**{page.short(rate)}** ({page.short(low)} to {page.short(high)})"


def table(found):
    """Markdown of {case: {method: Count}}: wrong flights a million."""
    head = ("case", methods.OURS, *(rival.name for rival in methods.RIVALS))
    lines = [(case.name, *map(per_million, counts.values())) for case, counts in found.items()]
    return page.table(head, lines)


def described(found):
    """Markdown of what the cases are: what is drawn, on how many flights of ours, how many in doubt, what was wrong."""
    head = ("case", "what is drawn", "flights of ours", "in doubt, left out", "ours: missed, invented, wrong")
    lines = []
    for case, counts in found.items():
        own = counts[methods.OURS]
        wrong = f"{own.missed}, {own.invented}, {own.wrong}"
        lines.append((case.name, case.words, f"{own.flights:,}", f"{own.doubtful:,}", wrong))
    return page.table(head, lines)
