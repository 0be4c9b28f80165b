"""Define the rows of measured numbers; the file that measures a row describes it."""

from typing import Any, NamedTuple

import numpy as np

Spread = tuple[float, float, float]  # median, lower and upper quartile


class Row(NamedTuple):
    """One measured number.

    `what` describes it; `unit` is its unit, as "over the yardstick"; `asked` is the required bound, None without
    requirement; `least` makes it a lower bound; `found` contains median and quartiles, None if it could not be
    measured; `remark` is printed beside the number.
    """

    what: str
    unit: str
    asked: float | None = None
    least: bool = False
    found: Spread | None = None
    remark: str = ""

    def of(self, values, remark=""):
        """Return the row with the values of the rounds, or of one."""
        return self._replace(found=spread(values), remark=remark)

    @property
    def kept(self):
        """Return True if the requirement is met; None without requirement or measurement."""
        if self.asked is None or self.found is None:
            return None
        return self.found[0] >= self.asked if self.least else self.found[0] <= self.asked


class Topic(NamedTuple):
    """Part of the page.

    `part` is its name, `tables` are Markdown, `notes` are lines, `pictures` are {file: (description, function of a path
    that draws it)}.
    """

    part: str
    rows: list[Row]
    tables: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    pictures: dict[str, tuple[str, Any]] = {}  # noqa: RUF012  # not modified


class Size(NamedTuple):
    """Amount of work: all, or a small version (`quick`) that checks that everything runs."""

    quick: bool

    def states(self, usual):
        return max(4, usual // 16) if self.quick else usual

    def few(self, usual):
        """Return all of a list, or its first and last entry."""
        return [usual[0], usual[-1]] if self.quick else list(usual)

    def rounds(self, usual):
        return 2 if self.quick else usual


def spread(values):
    """Compute median and quartiles."""
    return tuple(float(q) for q in np.quantile(np.atleast_1d(values), [0.5, 0.25, 0.75]))
