"""Where orbits that rest end: a chatter that just does not complete (CH), a wall that lets go in the midst of a rest.

At a CH the speed of the last hop's row is the critical one (`orbits.chatter`): an equation beside those of the orbit,
smooth through the point, whose orbits on the other side leave the wall after some last hops. The press on the wall that
is least within a rest is another: where it comes to zero the mass is let go there.
"""

import numpy as np

from continuation.persistent_jit import SOON, persistent_jit

from ..compiled.kernels import one_kernel
from ..flight.coefficients import framed
from ..orbits import impact_equations, releases
from ..orbits.flight_clearance import TOUCH
from .diagnostics import diagnose
from .equations import cycle_at, there
from .touches import zero_near


def _each(z, along, measure):
    built, given = framed(there(along, z)), cycle_at(along, z)
    return releases.of_each(measure, built, given, impact_equations.flights(built, given))


@persistent_jit(static_argnums=0, compiler_options=SOON)
def _measured(measure, z, along):
    return one_kernel(_each, z, along, measure=measure)


def excesses(along, z):
    """By how much the speed in each row is too large for a rest, (rows,), inf of rows that no release follows; see
    `releases.too_fast`."""
    return np.asarray(_measured(releases.too_fast, z, along))


def presses(along, z):
    """The least press between two falls of it on the way from each row to a release, or how hard the mass is drawn off
    the wall that it leaves without speed, (rows,), inf elsewhere."""
    return np.asarray(diagnose(along, z[None]).hold)[0]


def lifted(along, z, length):
    """The equations with the mass drawn off its wall before a rest where it just is not, or the other way round; None
    where the press is not about to begin at an impact."""
    if along.cycle.releases is None:
        return None
    rows = np.flatnonzero(abs(np.asarray(_measured(releases.beginning, z, along))) < TOUCH * length)
    if not len(rows):
        return None
    marks = np.array(along.cycle.releases)
    ends = (rows + 1) % np.count_nonzero(along.cycle.sides)
    marks[ends] = 3.0 - marks[ends]
    return along._replace(cycle=along.cycle._replace(releases=marks))


def located(along, z, row, measure):
    """The point near z where a measure of a row, of `excesses` or `presses`, is zero: `locate.Located`."""
    return zero_near(along, z, lambda z: measure(along, z)[row], _known_by(along, z, row))


def _known_by(along, z, row):
    """The places in z of what a measure of a row depends on: its impact, the one that follows, and the parameters."""
    rows, after = len(along.cycle.sides), (row + 1) % np.count_nonzero(along.cycle.sides)
    return [*sorted({row, after, rows + row, rows + after}), *range(2 * rows, len(z))]


def kind_at(along, z, length):
    """ "CH" or "RL" where a rest of the orbit just is one, or its wall just holds; "" elsewhere."""
    slack, marks = TOUCH * length, along.cycle.releases
    rows = np.flatnonzero(abs(presses(along, z)) < slack)
    if marks is None:
        return "CH" if len(rows) else ""
    follows = marks[(rows + 1) % np.count_nonzero(along.cycle.sides)]
    if (follows == 0).any() or (abs(excesses(along, z)) < slack).any():
        return "CH"
    return "RL" if len(rows) else ""
