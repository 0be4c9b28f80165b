"""The next event of a lean step: the wall that is met and when, or a step without contact.

Both are certified by the first Taylor coefficients of a lane's progress towards a wall and a bound on the rest, with
margins that are far wider than any rounding of a flight (docs/numbers.md). Times are in longest steps.
"""

from jax import lax

from ..compiled.compiler_hints import choose, least, most, positive, stage
from . import event
from .drive import wave
from .event import TERMS, Progress
from .lean_numbers import GIVEN_UP
from .wall import chosen, less

MARGIN = 2.0**-36  # of a lane's largest length: what is nearer to a wall than this is in doubt
LATE = 2.0**-16  # of the longest step: more than what is left to an event where a step lands
SHORT = 2.0**-10  # of it: a lane that would take a shorter step, but to an event, is in doubt
BEYOND = 2.0**-6  # of it: up to so far beyond an event the mass provably goes on into the wall
JUMP = 0.9375  # of the way to an event that is certain, but too far to land on


def ahead(numbers, lanes, drive):
    """(the side of the wall that is met, 0: none, when, how long there is no contact else, GIVEN_UP: too short; a bound
    on what the Taylor polynomial of x leaves out)."""
    swung = waves(numbers, lanes)
    side = stage(_side, numbers, lanes, drive, swung)
    remainder = stage(_remainder, numbers, lanes, drive)
    aimed = _progress(numbers, lanes, drive, swung, side, remainder)
    behind = None
    if len(numbers.walls) == 2:
        if numbers.still:
            behind = stage(_behind, numbers, aimed, stage(_tail, aimed, way=-1.0), lanes.largest)
        else:
            other = _progress(numbers, lanes, drive, swung, -side, remainder)
            behind = stage(_away, other, stage(_tail, other, way=1.0), lanes.largest)
    guess = stage(_guess, aimed)
    root = stage(_root, aimed, guess)
    known = stage(_known, aimed, guess, root)
    hit = stage(_hits, lanes, root, known, side, behind)
    short = stage(_short, lanes, aimed, stage(_tail, aimed, way=1.0), lanes.largest, guess, root, known, behind)
    return hit, root, short, remainder


def waves(numbers, lanes):
    """Cosine and sine of the angle that each wall swings by, None of one that stands still."""
    return [
        None if swing is None else stage(wave, wall, lanes.cosine, lanes.sine)
        for wall, swing in zip(numbers.walls, numbers.swings, strict=True)
    ]


def _free(numbers, lanes, drive, k):
    """The k-th Taylor coefficient of x in free flight."""
    if k < 2:
        return lanes.v if k else lanes.x
    series = numbers.series
    total = series.stay[k - 2] * lanes.x + series.move[k - 1] * lanes.v + series.lift[k - 2] * drive[0]
    return total - series.lag[k - 3] * drive[1] if k > 2 else total


def _way(wall, swings, wave, k):
    """The k-th Taylor coefficient of a wall's position, None for zero."""
    if swings is None:
        return None if k else wall.position
    part = swings[k] * wave[k % 2]
    part = -part if k % 4 in (1, 2) else part
    return part if k else wall.position + part


def _ways(numbers, waves, side, k):
    walls = zip(numbers.walls, numbers.swings, waves, strict=True)
    return chosen(side, numbers.walls, [_way(*each, k) for each in walls])


def term(numbers, lanes, drive, waves, side, k):
    """The k-th Taylor coefficient of the progress towards the wall on a side."""
    return side * less(_free(numbers, lanes, drive, k), _ways(numbers, waves, side, k))


def _remainder(numbers, lanes, drive):
    """A bound on abs x^(7) / 7! over a step, by the energy of x^(6), which the damping lessens."""
    sixth, seventh = (_free(numbers, lanes, drive, k) for k in (TERMS - 1, TERMS))
    return lax.abs(seventh) + numbers.inertia * lax.abs(sixth) + numbers.forcing


def _progress(numbers, lanes, drive, waves, side, remainder):
    """The `event.Progress` towards the wall on a side."""
    terms = tuple(stage(term, numbers, lanes, drive, waves, side, k=k) for k in range(TERMS))
    if not numbers.still:
        remainder = stage(_swaying, numbers, side, remainder)
    return Progress(terms, remainder)


def _swaying(numbers, side, remainder):
    return remainder + chosen(side, numbers.walls, numbers.sway)


def _side(numbers, lanes, drive, waves):
    """The wall to aim at: that which is reached first at the present speed."""
    if len(numbers.walls) == 1:
        return lax.full_like(lanes.x, float(numbers.walls[0].sign))
    if numbers.still:
        way = choose(lanes.v == 0, drive[0] - numbers.stiffness * lanes.x, lanes.v)
        return choose(way < 0, lax.full_like(way, -1.0), 1.0)
    walls = zip(numbers.walls, numbers.swings, waves, strict=True)
    (left, right) = ([_way(*each, k) for k in (0, 1)] for each in walls)
    clear, other = lanes.x - left[0], right[0] - lanes.x
    right_first = less(lanes.v, right[1]) * clear > -less(lanes.v, left[1]) * other
    return choose(right_first, lax.full_like(clear, 1.0), -1.0)


def _tail(progress, way):
    """K >= 0 with way G <= way (g0 + g1 t + g2 t^2) + K t^3."""
    total = progress.remainder
    for term in progress.terms[:2:-1]:
        total = positive(way * term + total)
    return total


def _safe(clear, slope, bend, tail, far):
    """(n, d), a step of n / d, at most far, without contact where G <= -clear + slope t + bend t^2 + tail t^3."""
    steep = bend + tail * far
    rise, ahead = positive(steep), slope >= 0
    never = (clear >= far * (slope + rise * far)) | ((steep < 0) & (slope * slope <= -4.0 * steep * clear))
    over = choose(ahead, clear, most(clear, -slope * far))
    under = choose(ahead, slope, 0.0) + rise * far
    return choose(never, far, over), choose(never, 1.0, under)


def _away(progress, tail, largest):
    """`_safe` from the wall that is not aimed at."""
    g = progress.terms
    return _safe(positive(-g[0] - MARGIN * largest), g[1], g[2], tail, lax.full_like(tail, 1.0))


def _behind(numbers, ahead, tail, largest):
    """As `_away`, of still walls, by the progress towards the other."""
    g = ahead.terms
    return _safe(positive(numbers.gap + g[0] - MARGIN * largest), -g[1], -g[2], tail, lax.full_like(tail, 1.0))


def _guess(progress):
    """The first root of the first three terms; where they have none, minus the time that they are nearest at."""
    g = progress.terms
    ahead, inside = g[1] > 0, g[1] * g[1] - 4.0 * g[2] * g[0]
    total = lax.abs(g[1]) + lax.sqrt(positive(inside))
    time = choose(ahead, -2.0 * g[0], total) / choose(ahead, total, 2.0 * g[2])
    return choose((inside >= 0) & (ahead | (g[2] > 0)), time, -lax.abs(time))


def _root(progress, guess):
    """A root from the quadratic's, by one of Halley's steps and one of Newton's with the slope of before."""
    value, slope, half = _bent(progress.terms, guess)
    inverse = slope / (slope * slope - value * half)
    root = guess - value * inverse
    return root - event.horner(progress.terms, root)[0] * inverse


def _bent(g, time):
    """The polynomial with these coefficients, its slope and half its second derivative at a time."""
    value, slope, half = g[-1] * time + g[-2], g[-1], lax.full_like(time, 0.0)
    for coefficient in g[-3::-1]:
        half = half * time + slope
        slope = slope * time + value
        value = value * time + coefficient
    return value, slope, half


def _known(progress, guess, root):
    """2 where a step may land on the root, 1 where it is certain and known to a 16th of the way, 0 elsewhere.

    Certain: G rises at a fifth of its slope at least up to BEYOND it, so that there is no other before, and the true
    one is as near as what is left of the polynomial there says, but for rounding.
    """
    g, remainder = progress.terms, progress.remainder
    far = root * event.MARGIN + BEYOND
    rise = event.rising(progress, far)
    cube, (left, _) = root * root * root, event.horner(g, root)
    noise = event.NOISE * event.rounding(root.dtype) * (g[1] * root - g[0])
    error = remainder * (cube * cube) + positive(lax.abs(left) - noise)
    sure = (guess >= 0) & (far <= 1.0) & (g[1] > 0) & (rise > 0.2 * g[1]) & (root >= 0)
    close = error * (lax.abs(g[2]) + g[1]) < event.landing(root.dtype) * g[1] * rise
    one = lax.full_like(root, 1.0)
    return choose(sure & close, 2.0, choose(sure & (error < (1.0 - JUMP) * rise * root), one, 0.0))


def _hits(lanes, root, known, side, behind):
    """The side of the wall that is met at the root, 0 where it is not near enough or not the next event."""
    hits = (known > 1.5) & (root + LATE <= lanes.left)
    if behind is not None:
        hits &= root * behind[1] <= behind[0]
    return choose(hits, side, 0.0)


def _short(lanes, progress, tail, largest, guess, root, known, behind):
    """A step without contact, GIVEN_UP where it is too short: from one division."""
    g = progress.terms
    size = 2.0 * lax.abs(guess)
    over, under = _safe(positive(-g[0] - MARGIN * largest), g[1], g[2], tail, choose(size < 1.0, size, 1.0))
    jumps = known > 0.5
    over = choose(jumps, choose(known > 1.5, root - LATE, JUMP * root), over)
    under = choose(jumps, 1.0, under)
    if behind is not None:
        first = over * behind[1] < behind[0] * under
        over, under = choose(first, over, behind[0]), choose(first, under, behind[1])
    time = least(over / under, lanes.left)
    return choose((time >= SHORT) | (time >= lanes.left), time, GIVEN_UP)
