"""The largest abs x of orbits: where a flight, or a stay within a soft wall, turns back, or at a wall that is hit.

Each flight and stay is looked at in cells; where v changes its sign in one, the turning point is found by false
position. Whatever is compared is a value of x on the orbit, so that a cell without a turning point does no harm.
"""

import jax
import jax.numpy as jnp
import numpy as np

from ..flight import soft_contact
from ..flight.coefficients import framed
from ..flight.flows import flow_of
from ..orbits import flight_clearance, impact_equations, saltation
from ..problem.diagnostics import each_of, flight
from ..problem.equations import cycle_at, there
from ..problem.orbit_on_branch import place_orbit
from ..problem.orbit_rows import row_of, spot_of

MOST = 50_000  # cells
ROUNDS = 6  # of false position: x at a turning point is right to the square of its time's error


def largest_of(branch):
    """The largest abs x on the orbit of each point of a branch, (points,)."""
    found = np.zeros(len(branch))
    for one in branch.segments:
        rows = branch.data.isel(point=slice(one.first, one.last + 1))
        spot = spot_of(row_of(rows, 0), branch.name)
        along, z = place_orbit(branch.scene, branch.name, spot)
        found[one.first : one.last + 1] = largest(along, _unknowns(rows, branch.name, along, z))
    return found


def _unknowns(rows, name, along, z):
    """The unknowns z at the rows of a branch's data that have one itinerary."""
    wide, count = len(along.cycle.sides), int(np.sum(along.cycle.sides != 0))
    found = np.zeros((rows.sizes["point"], len(z)))
    found[:, -1] = rows[name].values
    if not wide:
        found[:, 0], found[:, 1] = rows["x"].values[:, 0], rows["v"].values[:, 0]
        return found
    hit = rows["side"].values[0] != 0
    found[:, :count], found[:, wide : wide + count] = rows["time"].values[:, hit], rows["speed"].values[:, hit]
    return found


def largest(along, zs):
    """The same at points z of orbits of one itinerary."""
    return each_of(_hitting if len(along.cycle.sides) else _free, along, zs, 1)[0]


def _hitting(along, z, _):
    """(the largest abs x,) at one point of orbits with impacts."""
    return (of_cycle(framed(there(along, z)), cycle_at(along, z)),)


def of_cycle(built, given):
    """The largest abs x of a cycle with impacts."""
    found, hit = impact_equations.flights(built, given), given.sides != 0

    def at(time):
        return impact_equations.at(built, given, found, time)

    best = jnp.where(hit, abs(found.met.where), 0.0)
    begin, span = given.times, found.time
    if found.met.stay is not None:
        inside = soft_contact.gives(built, given.sides)
        stay = jnp.where(inside & hit, jnp.maximum(found.met.stay, 0.0), 0.0)
        best = _highest(at, begin, stay, saltation.reach(built, found.met, given.sides), best)
        begin = begin + stay

    def free(time):  # no stay is compiled for it again
        return flow_of(built).fly(built, found.x, found.v, found.cosine, found.sine, time - begin)[:2]

    best = _highest(free, begin, span, built.reach, best)
    return jnp.max(jnp.where(hit, best, 0.0))


def _free(along, z, _):
    return (of_flight(*flight(along, z)),)


def of_flight(built, found):
    """The largest abs x of the flight of a motion without impacts."""

    def at(time):
        return flow_of(built).fly(built, found.x, found.v, found.cosine, found.sine, time)[:2]

    none = jnp.zeros_like(found.x)
    return jnp.max(_highest(at, none, found.time, built.reach, none))


def _highest(at, begin, span, reach, best):
    """The largest abs x of rows from a time on, over a span, if it is larger than the best so far; at: time -> (x, v);
    reach: of a step of the flow, of which a cell is a small part. It is nan where there would be too many cells, as
    where Newton's method goes astray."""
    wanted = jnp.max(span) / (flight_clearance.TURN * reach)
    known = wanted <= MOST
    cells = jnp.ceil(jnp.where(known, wanted, 0.0)).astype(int) + 8
    step = span / cells

    def look(k, carry):
        best, before = carry
        low, high = begin + k * step, begin + (k + 1.0) * step
        x, v = at(high)
        turned, _ = at(_turn(at, low, high, before, v))
        turns = before * v < 0
        best = jnp.maximum(best, abs(x))
        return jnp.maximum(best, jnp.where(turns, abs(turned), 0.0)), v

    x, v = at(begin)
    return jnp.where(known, jax.lax.fori_loop(0, cells, look, (jnp.maximum(best, abs(x)), v))[0], jnp.nan)


def _turn(at, low, high, first, last):
    """Where v is zero between two times with these v: false position, an end that stays once more counted half
    (Illinois)."""

    def narrow(_, carry):
        (low, high), (first, last), stayed = carry  # stayed: 1 where the high end did last time, -1 where the low one
        gap = jnp.where(first == last, 1.0, first - last)
        middle = low + (high - low) * jnp.clip(first / gap, 0.0, 1.0)
        _, v = at(middle)
        after = v * last < 0  # the zero lies between the middle and the high end
        low, high = jnp.where(after, middle, low), jnp.where(after, high, middle)
        first, last = first * jnp.where(stayed < 0, 0.5, 1.0), last * jnp.where(stayed > 0, 0.5, 1.0)
        first, last = jnp.where(after, v, first), jnp.where(after, last, v)
        return (low, high), (first, last), jnp.where(after, 1.0, -1.0)

    start = (low, high), (first, last), 0.0 * first
    (low, high), (first, last), _ = jax.lax.fori_loop(0, ROUNDS, narrow, start)
    gap = jnp.where(first == last, 1.0, first - last)
    return low + (high - low) * jnp.clip(first / gap, 0.0, 1.0)
