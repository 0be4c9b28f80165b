"""Orbits that rest, by their impacts: from where a wall lets the mass go, to the hops by which it comes to rest again.

A rest forgets its past, so that an orbit is known from a release on. Its rows (`impact_equations.Cycle`) are a release,
the impacts up to a hop from which on all hops are short and under one press, and the next release. What those hops do
is asked of `chatter`: whether they end in rest, how long that lasts, and where the mass is meanwhile.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float

from continuation.arrays import Array
from continuation.persistent_jit import SOON, persistent_jit

from ..compiled.kernels import one_kernel
from ..flight import flow
from ..flight.coefficients import framed
from ..flight.soft_contact import bounce
from ..scene.codes import Contact
from . import chatter
from .meeting_wall import pressed

TURN = 0.2  # of `Frame.reach`: between two looks at the press
ROUNDS = 5  # of Newton's steps to where the press is least
ROOM = 0.5  # of `chatter.LONGEST`: so long a first hop may be where its row is chosen
MORE = 64  # hops that are flown to find such a row
LEAST = 0.1  # of `chatter.LONGEST`: where a shorter flight of a mass without speed is a row, it is none


class Tails(NamedTuple):
    """Of each row that a release follows, inf of others. rest: how long the mass rests, negative: it does not; hold:
    the least press on the way to the release, inf: it only falls; plain: positive while the hops from this row on are
    all short, and pressed; of a row that the mass is drawn off from without speed, while it is not back too soon.
    height, pace: (rows, times), over the wall and away from it, at times asked for."""

    rest: Float[Array, "*rows"]
    hold: Float[Array, "*rows"]
    plain: Float[Array, "*rows"]
    height: Float[Array, "*rows times"]
    pace: Float[Array, "*rows times"]


class Tail(NamedTuple):
    """What a series of hops begins with. side: of the wall; cosine, sine: of the drive at the release; tau: before it;
    speed: of leaving the wall; lifts: where R is 0, whether the mass is drawn away at once, to come back and rest."""

    side: Float[Array, "*rows"]
    cosine: Float[Array, "*rows"]
    sine: Float[Array, "*rows"]
    tau: Float[Array, "*rows"]
    speed: Float[Array, "*rows"]
    lifts: Bool[Array, "*rows"]


def tails_of(frame, cycle, found):
    """(the `Tail` of each row, those that a release follows); of others one that ends at once. found: the cycle's
    `impact_equations.Flights`."""
    ends = (cycle.sides != 0) & (cycle.releases[found.follows] > 0)
    last = jnp.sum(cycle.sides != 0) - 1
    again = jnp.where(jnp.arange(len(cycle.sides)) == last, cycle.periods * frame.period, 0.0)
    tau = cycle.times - (cycle.times[found.follows] + again)
    cosine, sine = (found.sign * each[found.follows] for each in (found.met.cosine, found.met.sine))
    speed = found.met.bounce * cycle.speeds
    none = jnp.zeros_like(tau)
    blank = Tail(none + cycle.sides[0], cosine, sine, none - 1.0, none, none > 0)
    there = Tail(cycle.sides, cosine, sine, tau, speed, cycle.releases[found.follows] > 1)
    return jax.tree.map(lambda new, old: jnp.where(ends, new, old), there, blank), ends


def tails(frame, cycle, found, times):
    """The `Tails` of a cycle that rests; times: since the section's phase, (times,)."""
    every, ends = tails_of(frame, cycle, found)
    span = cycle.periods * frame.period
    since = times - cycle.times[:, None]
    since = since - span * jnp.floor(since / span)
    look = jax.vmap(partial(_looked, frame))(every, since)
    blank = Tails(*(jnp.full_like(each, jnp.inf) for each in look[:3]), *(jnp.zeros_like(each) for each in look[3:]))
    look = jax.tree.map(lambda new, old: jnp.where(ends.reshape(-1, *(1,) * (new.ndim - 1)), new, old), look, blank)
    back = ~ends & (found.met.bounce == 0) & (cycle.sides[found.follows] * found.sign == cycle.sides)
    back = back & (cycle.sides != 0) & (cycle.releases == 0)
    return look._replace(plain=jnp.where(back, found.time / (LEAST * chatter.LONGEST * frame.reach) - 1.0, look.plain))


def _looked(frame, tail, since):
    """The `Tails` of one row."""
    release = tail.cosine, tail.sine
    found = chatter.ending(frame, tail.side, release, tail.tau, tail.speed, since)
    push, change, _ = _press(frame, tail, tail.tau)
    first = 1.0 - found.first / (chatter.LONGEST * frame.reach)
    held = push / (abs(push) + jnp.maximum(change, 0.0) * found.first)
    plain = jnp.where(bounce(frame, tail.side) > 0, jnp.minimum(first, held), first)
    return Tails(found.rest, least_press(frame, tail), plain, found.height, found.pace)


def _press(frame, tail, tau):
    """The press on the wall, its change, and how that changes."""
    phasor = flow.rotated(tail.cosine, tail.sine, frame.frequency * tau)
    return [tail.side * each for each in pressed(frame, tail.side, phasor, 2)]


def least_press(frame, tail):
    """The least press between two falls of it, inf: it only falls; also that of `beginning`, its sign turned where the
    mass `lifts`."""
    cells = jnp.ceil(abs(tail.tau) / (TURN * frame.reach)).astype(int) + 2
    span = abs(tail.tau) / cells

    def look(k, carry):
        change, least = carry
        late = tail.tau + span * (k + 1.0)
        after = _press(frame, tail, late)[1]
        turns = (change < 0) & (after > 0)

        def nearer(_, late):
            _, slope, bend = _press(frame, tail, late)
            step = slope / jnp.where(bend == 0, 1.0, bend)
            return jnp.clip(late - step, tail.tau + span * k, tail.tau + span * (k + 1.0))

        lowest = lax.fori_loop(0, ROUNDS, nearer, late - 0.5 * span)
        return after, jnp.where(turns, jnp.minimum(least, _press(frame, tail, lowest)[0]), least)

    begun = beginning(frame, tail)
    least = jnp.where(tail.lifts & jnp.isfinite(begun), -begun, begun)
    return lax.fori_loop(0, cells, look, (_press(frame, tail, tail.tau)[1], least))[1]


def draws(frame, cycle, found):
    """How hard the mass is drawn off the wall of each row where R is 0 and no release follows, (rows,), inf of others:
    below zero it is pressed on it, and would rest."""
    push, _ = pressed(frame, cycle.sides, (found.met.cosine, found.met.sine))
    leaves = (cycle.sides != 0) & (found.met.bounce == 0)
    if cycle.releases is not None:
        leaves = leaves & (cycle.releases == 0) & (cycle.releases[found.follows] == 0)
    return jnp.where(leaves, -cycle.sides * push, jnp.inf)


def beginning(frame, tail):
    """The press at the impact where R is 0 and it rises: below zero the mass is drawn off its wall; inf elsewhere."""
    push, change, _ = _press(frame, tail, tail.tau)
    return jnp.where((bounce(frame, tail.side) == 0) & (change > 0), push, jnp.inf)


def of_each(measure, frame, cycle, found):
    """A measure of a `Tail`, as `too_fast`, of each row, (rows,); inf of rows that no release follows."""

    def one(row):
        tail, ends = row
        return lax.cond(ends, partial(measure, frame), lambda tail: jnp.full_like(tail.tau, jnp.inf), tail)

    return lax.map(one, tails_of(frame, cycle, found))  # side by side, each would take as long as all of them


def too_fast(frame, tail):
    """By how much the speed is too large for the hops to end in rest, after those that are far from the release; where
    R is 0 how long after it the impact is, or that to which the mass comes back that is drawn off."""
    release = tail.cosine, tail.sine
    phasor = flow.rotated(*release, frame.frequency * tail.tau)
    back = tail.tau + chatter.hop(frame, tail.side, phasor, jnp.zeros_like(tail.tau)).time
    tau, speed = chatter.late(frame, tail.side, release, tail.tau, tail.speed)
    over = speed - chatter.critical(frame, tail.side, release, tau)
    return jnp.where(bounce(frame, tail.side) > 0, over, back)


def _examine(scene, side, phase, tau, speed):
    frame = framed(scene)
    release = jnp.cos(phase), jnp.sin(phase)
    push = side * pressed(frame, side, flow.rotated(*release, frame.frequency * tau))[0]
    lifts = (bounce(frame, side) == 0) & (push < 0)
    tail = Tail(side, *release, tau, bounce(frame, side) * speed, lifts)
    look = _looked(frame, tail, jnp.zeros(0, tau.dtype))

    def fly(k, carry):
        late, pace, times, speeds = carry
        found = chatter.hop(frame, side, flow.rotated(tail.cosine, tail.sine, frame.frequency * late), pace)
        late = late + found.time
        at = jnp.arange(MORE) == k
        return (
            late,
            bounce(frame, side) * found.landing,
            jnp.where(at, late, times),
            jnp.where(at, found.landing, speeds),
        )

    blank = jnp.zeros(MORE, tau.dtype)
    _, _, times, speeds = lax.fori_loop(0, MORE, fly, (tau, tail.speed, blank, blank))
    return look.rest, look.hold, look.plain, times, speeds, lifts


@persistent_jit(compiler_options=SOON)
def _examined(scene, side, phase, tau, speed):
    """(rest, hold, plain; times before the release and speeds of the impacts that follow; whether it lifts) of an
    impact at tau with a speed; phase: the drive's at the release."""
    return one_kernel(_examine, scene, side, phase, tau, speed)


def rows_of(scene, phase, times, speeds, sides, spans, periods, slack=0.0):
    """(times, speeds, sides) of an orbit that rests, in order of travel, with the sides of `Contact.STUCK` at releases,
    and one more where the mass lifts before its rest.

    phase: the section's; times, speeds, sides: of its impacts since then; spans: of its rests, as `rests.Rests` has
    them. An impact is a row up to the first from which on all hops on its wall are short and pressed. slack: of speeds
    and presses, by which a rest that just is one may be none.
    """
    length, rate = periods * 2.0 * np.pi / float(scene.frequency), float(scene.frequency)
    order = np.argsort(times)
    every = [(times[k], speeds[k], int(sides[k])) for k in order]
    begun = [
        int(np.argmin([abs(time - begin) + length * (own != side) for time, _, own in every]))
        for side, begin, _ in spans
    ]
    rows, gone = [], set()
    for (side, _, end), last in zip(spans, begun, strict=True):
        chain = []  # the impacts on this wall alone, back from the last
        for k in range(len(every)):
            place = (last - k) % len(every)
            if every[place][2] != side or (k and place in begun):
                break
            chain.insert(0, place)
        taken, more, lifts = _cut(scene, phase + rate * end, end, length, [every[k] for k in chain], slack)
        gone |= set(chain[taken:])
        rows += [*more, (end, 0.0, (Contact.STUCK + lifts) * int(side))]
    rows += [each for k, each in enumerate(every) if k not in gone]
    rows = sorted((time % length, speed, side) for time, speed, side in rows)
    return tuple(np.array(column, float) for column in zip(*rows, strict=True))


def _cut(scene, phase, end, length, chain, slack):
    """(how many of a chain of impacts are rows, impacts that are rows besides, whether the last of them lifts)."""
    numbers = partial(np.asarray, dtype=scene.dtype)
    for k, (time, speed, side) in enumerate(chain):
        tau = (time - end) % -length
        given = (numbers(each) for each in (side, phase, tau, speed * (1.0 - slack)))
        rest, hold, plain, later, paces, lifts = _examined(scene, *given)
        if rest > 0 and hold > -slack and plain > 1.0 - ROOM:
            return k + 1, [], bool(lifts)
    more = []
    for time, speed in zip(later, paces, strict=True):
        more.append((end + float(time), float(speed), side))
        given = (numbers(each) for each in (side, phase, time, speed))
        if _examined(scene, *given)[2] > 1.0 - ROOM:
            return len(chain), more, False
    return len(chain), [], False
