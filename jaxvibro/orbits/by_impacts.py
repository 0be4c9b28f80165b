"""From a guess of the impacts to an `Orbit` by Newton's method, or to the reason why there is none.

Times and speeds are the unknowns, for walls hit in a given order. What solves their equations is an orbit only if no
flight passes through a wall, and if certified flights from each impact meet the next wall next.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation import newton
from continuation.arrays import Array
from continuation.persistent_jit import SOON, persistent_jit
from continuation.problem import plainly

from ..compiled.kernels import one_kernel
from ..flight.coefficients import framed
from ..maps import itinerary as words
from ..maps.iterate import KEEP, iterate
from ..scene.codes import Status
from ..scene.state import Impacts, State
from . import flight_clearance, impact_equations
from .impact_equations import Cycle
from .orbit import OrbitError, described, multipliers
from .orbit_comparison import meetings, times_round

NEAR = 1e-3  # of a drive period: so near an impact the section is moved
ENDED = "start nearer to another orbit: this one may be on a branch that has ended by grazing"
GUESSES = 64  # of the impacts, where only the itinerary is known
SAME = 1e-8  # of 1 + the largest speed: two impacts as near are one
TIMELY = 1e-6  # of a drive period: so well must a certified flight end at the impact


class Solution(NamedTuple):
    """A cycle after Newton's method, and what is known of it. start: (x, v) at the section, of KEEP periods; calls:
    clearance and time of each flight's closest call to each wall; trace and determinant: of the monodromy matrix."""

    cycle: Cycle
    solved: newton.Solved
    flights: impact_equations.Flights
    start: tuple[Float[Array, " periods"], Float[Array, " periods"]]
    halfway: tuple[Float[Array, " rows"], Float[Array, " rows"]]
    calls: tuple[Float[Array, "rows walls"], Float[Array, "rows walls"]]
    trace: Float[Array, ""]
    determinant: Float[Array, ""]


def _solution(scene, guess, run=plainly):
    solved = run(impact_equations.solved, scene, guess)
    return run(_measured, scene, impact_equations.ordered(scene, guess, solved.unknowns), solved)


@persistent_jit(compiler_options=SOON, numpy_first=_solution)
def solution(scene, guess):
    """The `Solution` that Newton's method reaches from a cycle."""
    return _solution(scene, guess, one_kernel)


def _measured(scene, found, solved):
    built = framed(scene)
    flown = impact_equations.flights(built, found)
    start = impact_equations.at(built, found, flown, built.period * jnp.arange(KEEP, dtype=found.times.dtype))
    calls = flight_clearance.clearances(built, flown, flight_clearance.samples(built, flown))
    halfway = flight_clearance.place(built, flown, 0.5 * flown.time)[:2]
    return Solution(
        found, solved, flown, start, halfway, calls, *impact_equations.invariants(built, flown, found.sides)
    )


def padded(scene, times, speeds, sides, phase, periods):
    """A `Cycle` with 2, 8, 32, ... rows, so that few shapes are compiled."""
    rows = 2
    while rows < len(times):
        rows *= 4
    more = rows - len(times)
    rows = (np.pad(np.asarray(each, scene.dtype), (0, more)) for each in (times, speeds, sides))
    return Cycle(*rows, *(np.asarray(each, scene.dtype) for each in (phase, periods)))


def by_impacts(scene, times, speeds, sides, phase, periods):
    """The orbit with impacts near these times since the section's phase. Raises OrbitError."""
    length = 2.0 * np.pi / float(scene.frequency)
    found = jax.device_get(solution(scene, padded(scene, times, speeds, sides, phase, periods)))
    _refuse_unsolved(found)
    count = len(times)
    times, speeds, sides = (each[:count] for each in found.cycle[:3])
    least = _least_period(times, speeds, sides, periods, length)
    if least < periods:
        keep = count * least // periods
        return by_impacts(scene, times[:keep], speeds[:keep], sides[:keep], phase, least)
    later = _section(times, length)
    if later:
        turned = np.mod(times - later, periods * length)
        order = np.argsort(turned)
        phase = float(np.mod(phase + float(scene.frequency) * later, 2.0 * np.pi))
        return by_impacts(scene, turned[order], speeds[order], sides[order], phase, periods)
    _refuse_passing(scene, found, count)
    _refuse_uncertain(scene, found, count, length)
    return _described(scene, found, count, length)


def by_section(scene, times, speeds, sides, periods, residual):
    """The orbit that has exactly these impacts, times since phase 0, with this residual; its section where it may be.
    Nothing is solved and nothing refused."""
    length = 2.0 * np.pi / float(scene.frequency)
    later = _section(np.mod(times, periods * length), length)
    turned = np.mod(times - later, periods * length)
    order = np.argsort(turned)
    phase = np.mod(float(scene.frequency) * later, 2.0 * np.pi)
    return _read(scene, turned[order], speeds[order], sides[order], phase, periods, residual)


def from_phase_0(orbit, itinerary):
    """An orbit that was solved by its impacts, read from phase 0 of its first drive period on.

    An impact that is not told from phase 0 is put to the period, before or after, in which this itinerary has it.
    """
    scene, impacts, n = orbit.scene, orbit.impacts, orbit.periods
    length = 2.0 * np.pi / float(scene.frequency)
    span, tiny = n * length, float(np.finfo(scene.dtype).eps) * length
    times, near = np.mod(impacts.time + orbit.state.phase / float(scene.frequency), span), TIMELY * length
    choices = [times, np.where(times < near, span, times), np.where(times > span - near, tiny, times)]
    orders = [np.argsort(late, kind="stable") for late in choices]
    alike = (
        k
        for k, (late, order) in enumerate(zip(choices, orders, strict=True))
        if words.split(late[order], impacts.side[order], n, length) == itinerary
    )
    k = next(alike, 0)
    times, order = choices[k], orders[k]
    return _read(scene, times[order], impacts.speed[order], impacts.side[order], 0.0, n, orbit.residual)


def _read(scene, times, speeds, sides, phase, periods, residual):
    """The orbit with these impacts, times since the section's phase; nothing is solved."""
    given = padded(scene, times, speeds, sides, phase, periods)
    numbers = (np.asarray(each, scene.dtype) for each in ([], residual, 0.0, 1.0))
    solved = newton.Solved(*numbers, np.asarray(newton.OK))
    length = 2.0 * np.pi / float(scene.frequency)
    return _described(scene, jax.device_get(_known(scene, given, solved)), len(times), length)


_known = persistent_jit(_measured, compiler_options=SOON, numpy_first=True)


def _described(scene, found, count, length):
    times, speeds, sides, phase, periods = found.cycle[:5]
    walls, points = words.split(times[:count], sides[:count], int(periods), length), np.stack(found.start, 1)
    turn = words.first(walls, points[: int(periods)])
    late = np.mod(times[:count] - turn * length, float(periods) * length)
    order = np.argsort(late)
    rows = late[order], sides[order].astype(np.int8), speeds[order]
    clear = float(found.calls[0][:count].min(initial=np.inf))
    impacts = Impacts(*rows, count, float(rows[2].min()), clear, Status.OK)
    state = State(*points[turn].tolist(), float(phase), 0.0)
    roots = multipliers(float(found.trace), float(found.determinant))
    return described(scene, state, impacts, words.turned(walls, turn), roots, float(found.solved.residual), "impacts")


def _refuse_unsolved(found):
    status, residual = int(found.solved.status), float(found.solved.residual)
    if status != newton.OK:
        raise OrbitError(newton.STATUS[status], residual, newton.ADVICE[status])


def _least_period(times, speeds, sides, periods, length):
    """The least number of periods after which these impacts come again."""
    points = meetings(2.0 * np.pi / length, times, sides, speeds, 1.0 + speeds.max())
    return periods // times_round(points, periods, SAME)


def _section(times, length):
    """How long after the section's phase the section is to be: 0 where no impact is near it, else the middle of the
    widest gap, of equal ones that which comes first."""
    phases = np.sort(np.mod(times, length))
    if min(phases[0], length - phases[-1]) >= NEAR * length:
        return 0.0
    gaps = np.diff(phases, append=phases[0] + length)
    middles = np.mod(phases + 0.5 * gaps, length)
    return float(middles[gaps >= gaps.max() - NEAR * length].min())


def _refuse_passing(scene, found, count):
    """Refuse impacts without speed, and flights behind a wall: which, where, how deep."""
    speeds, (clear, late) = found.cycle.speeds[:count], (each[:count] for each in found.calls)
    residual, slowest = float(found.solved.residual), int(np.argmin(speeds))
    if not speeds[slowest] > 0:
        told = f"impact {slowest + 1} of {count} would have the speed {speeds[slowest]:.3g}"
        raise OrbitError(f"not admissible: {told}", residual, ENDED)
    flight, wall = np.unravel_index(int(np.argmin(clear)), clear.shape)
    if clear[flight, wall] < 0:
        side = list(scene.walls)[wall]
        told = f"flight {flight + 1} of {count} passes through the {side} wall, {-clear[flight, wall]:.3g} deep"
        told += f", {late[flight, wall]:.6g} after its start"
        raise OrbitError(f"not admissible: {told}", residual, ENDED)


def _refuse_uncertain(scene, found, count, length):
    """Refuse what certified flights do not confirm: one from halfway along each flight to the end of the next, so that
    none begins or ends on a wall."""
    times, _, sides, phase = found.cycle[:4]
    flights, follows = found.flights, found.flights.follows[:count]
    spans = flights.time[:count]
    stays = np.zeros_like(spans) if flights.met.stay is None else flights.met.stay[:count]
    begin = phase + np.asarray(scene.frequency) * (times[:count] + stays + 0.5 * spans)
    starts = State(found.halfway[0][:count], found.halfway[1][:count], begin, np.zeros_like(begin))
    ends = 0.5 * spans
    ends = np.stack([ends, ends + (stays + spans)[follows]], axis=1)
    kept = iterate(scene, starts, max(1, int(np.ceil(ends.max() / length + TIMELY))))
    after = kept.time + length * np.arange(len(kept.time))[:, None, None]
    after = np.where(kept.side != 0, after, np.inf).transpose(1, 0, 2).reshape(count, -1)
    first = after.argsort(axis=1)[:, :2]
    met = np.take_along_axis(kept.side.transpose(1, 0, 2).reshape(count, -1), first, 1)
    late = abs(np.take_along_axis(after, first, 1) - ends) > TIMELY * length
    wrong = np.flatnonzero((late | (met != sides[np.stack([follows, follows[follows]], axis=1)])).any(axis=1))
    if wrong.size:
        told = f"the flight after impact {wrong[0] + 1} of {count} meets another wall, or none, or not then"
        raise OrbitError(f"not admissible: {told}", float(found.solved.residual), "start nearer to an orbit")


def solutions(scene, guesses):
    """The cycle that Newton's method reaches from each of many: (cycles, `newton.Solved`), arrays with a row each."""
    return jax.device_get(_many(scene, guesses))


@persistent_jit
@partial(jax.vmap, in_axes=(None, 0))
def _many(scene, guess):
    solved = impact_equations.solved(scene, guess)
    return impact_equations.ordered(scene, guess, solved.unknowns), solved


def guessed(scene, itinerary, state, fast):
    """An orbit with this itinerary, from guesses of its impacts at random: of those found the nearest to the state.

    fast: a speed that is large for the scene. Raises OrbitError: the last reason met, where no guess leads to an orbit.
    """
    flat, periods = "".join(itinerary), len(itinerary)
    if not flat:
        raise OrbitError("the state does meet walls", np.nan, "start where the motion meets none")
    length = 2.0 * np.pi / float(scene.frequency)
    rng = np.random.default_rng(0)
    begins = np.repeat(np.arange(periods), [len(word) for word in itinerary])
    times = np.sort(begins + rng.random((GUESSES, len(flat))), axis=1) * length
    speeds = fast * rng.random(times.shape)
    sides = np.broadcast_to(words.sides(itinerary), times.shape)
    rows = [padded(scene, *each, state.phase, periods) for each in zip(times, speeds, sides, strict=True)]
    found, solved = solutions(scene, jax.tree.map(lambda *each: np.stack(each), *rows))
    why = OrbitError("no guess leads to a solution with this itinerary", np.nan, "give a state near the orbit")
    seen, orbits = set(), []
    for k in np.flatnonzero(solved.status == newton.OK):
        key = tuple(np.round(found.times[k], 6))
        if key not in seen:
            seen.add(key)
            try:
                orbit = by_impacts(scene, *(each[k][: len(flat)] for each in found[:3]), state.phase, periods)
            except OrbitError as error:
                why = error
                continue
            if words.same(orbit.itinerary * (periods // orbit.periods), itinerary):
                orbits.append(orbit)
    if not orbits:
        raise why
    return min(orbits, key=lambda one: abs(one.state.x - state.x) + abs(one.state.v - state.v))
