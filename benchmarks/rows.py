"""What is measured, as rows: each is described once, in the file that measures it."""

from typing import Any, NamedTuple

import numpy as np

Spread = tuple[float, float, float]  # median, lower and upper quartile


class Row(NamedTuple):
    """One measured number. what: in words; unit: what the number is, as "over the yardstick"; asked: the bound that it
    is to keep, None where it is printed alone; least: whether it is to be that at least; found: median and quartiles,
    None where it could not be measured; remark: said beside the number."""

    what: str
    unit: str
    asked: float | None = None
    least: bool = False
    found: Spread | None = None
    remark: str = ""

    def of(self, values, remark=""):
        """The row with what was found in each round, or in one."""
        return self._replace(found=spread(values), remark=remark)

    @property
    def kept(self):
        """Whether what is asked is kept; None where nothing is asked or measured."""
        if self.asked is None or self.found is None:
            return None
        return self.found[0] >= self.asked if self.least else self.found[0] <= self.asked


class Topic(NamedTuple):
    """A part of the page. part: its name; rows; tables: in Markdown; notes: lines; pictures: {file: (what it shows,
    function of a path that draws it)}."""

    part: str
    rows: list[Row]
    tables: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    pictures: dict[str, tuple[str, Any]] = {}  # noqa: RUF012  # never changed


class Size(NamedTuple):
    """How much is measured: all, or where quick the whole in small, to see that it runs."""

    quick: bool

    def states(self, usual):
        return max(4, usual // 16) if self.quick else usual

    def few(self, usual):
        """All of a list, or its first and last."""
        return [usual[0], usual[-1]] if self.quick else list(usual)

    def rounds(self, usual):
        return 2 if self.quick else usual


def spread(values):
    """Median and quartiles."""
    return tuple(float(q) for q in np.quantile(np.atleast_1d(values), [0.5, 0.25, 0.75]))
