"""From a state on the section to an `Orbit` by Newton's method on the strobe: any orbit, also one that rests on a wall
or meets none. Near grazing it is worse than the equations of the impacts (`by_impacts`)."""

import jax
import numpy as np

from continuation import newton
from continuation.linear import solve
from continuation.persistent_jit import SOON, persistent_jit

from ..compiled.compiler_hints import OPTIONS
from ..compiled.kernels import one_kernel
from ..maps import itinerary as words
from ..maps.monodromy import with_strobe
from ..maps.one_period import SLOTS
from ..maps.rests import NO_RESTS, may_rest, rests
from ..scene.codes import Status
from ..scene.state import Impacts, State, real_state
from .orbit import OrbitError, described, multipliers

ROUNDS = 12  # of Newton's steps
MANY = 512  # impacts of a period that are recorded where there are more than usual


def by_state(scene, state, periods):
    """The orbit near a state, numbers at its phase. Raises OrbitError."""
    eps, step = float(np.finfo(scene.dtype).eps), np.inf
    for _ in range(ROUNDS):
        points, told, matrix = _round(scene, state, periods)
        miss = points[-1] - points[0]
        scale = 1.0 + abs(points).max()
        if step <= eps**0.7 * scale or not miss.any():
            break
        state, step = _stepped(state, told[-1][0], miss, matrix)
    if miss.any() and (step > eps**0.7 * scale or abs(miss).max() > eps**0.4 * scale):
        raise OrbitError(newton.STATUS[newton.SLOW], float(abs(miss).max()), newton.ADVICE[newton.SLOW])
    least = next((n for n in range(1, periods) if periods % n == 0 and _near(points[n], points[0], scale)), periods)
    if least < periods:
        return by_state(scene, state, least)
    walls = tuple(words.words(each.side[None])[0] for _, each in told)
    turn = words.first(walls, points[:-1])
    state = told[turn - 1][0] if turn else state
    impacts = _joined(words.turned([each for _, each in told], turn), 2.0 * np.pi / float(scene.frequency))
    roots = multipliers(float(np.trace(matrix)), float(np.linalg.det(matrix)))
    state = jax.tree.map(float, state)
    may = may_rest(scene, [each.status for _, each in told], [end.contact for end, _ in told])
    resting = rests(scene, state, periods) if may else NO_RESTS
    return described(scene, state, impacts, words.turned(walls, turn), roots, float(abs(miss).max()), "state", resting)


def _near(point, other, scale):
    return abs(point - other).max() <= 1e-8 * scale


def period(scene, state):
    """(State, Impacts with their least clearance, M) a drive period later, of a state of numbers: NumPy's."""
    state = real_state(scene, state)
    end, impacts, (a, b, c, d) = _period(scene, state)
    if impacts.count > SLOTS:
        end, impacts, (a, b, c, d) = jax.device_get(_full_period(scene, state))
    return end, impacts, np.array([[a, b], [c, d]])


@persistent_jit(compiler_options=OPTIONS, numpy_first=True)
def _period(scene, state):
    return one_kernel(with_strobe, scene, state, periods=1, slots=SLOTS, clearance=True)


@persistent_jit(compiler_options=OPTIONS)
def _full_period(scene, state):
    return one_kernel(with_strobe, scene, state, periods=1, slots=MANY, clearance=True)


_solved = persistent_jit(solve, compiler_options=SOON, numpy_first=True)


def _round(scene, state, periods):
    """(points on the section, shape (periods + 1, 2); (state, impacts) of each period; the monodromy matrix)."""
    points, told, matrix = [(float(state.x), float(state.v))], [], np.eye(2)
    for _ in range(periods):
        state, impacts, slope = period(scene, state)
        matrix = slope @ matrix
        if impacts.status >= Status.CAP:
            what = f"the state cannot be followed ({Status(int(impacts.status)).word})"
            raise OrbitError(what, np.nan, "start between the walls, nearer to an orbit")
        points.append((float(state.x), float(state.v)))
        told.append((state, impacts))
    return np.array(points), told, matrix


def _stepped(state, end, miss, matrix):
    """(the next state, how far it is from the last): where the start is forgotten the end itself."""
    if not matrix.any():
        return end, float(abs(miss).max())
    step, worst, _ = _solved(np.eye(2) - matrix, miss)
    if not worst > newton.SINGULAR_BELOW * np.finfo(step.dtype).eps:
        status = newton.SINGULAR
        raise OrbitError(newton.STATUS[status], float(abs(miss).max()), newton.ADVICE[status])
    return State(float(state.x) + step[0], float(state.v) + step[1], state.phase, 0.0), float(abs(step).max())


def _joined(parts, length):
    """The impacts of some periods as those of one, without empty slots."""
    rows = [(each.time + k * length, each.side, each.speed) for k, each in enumerate(parts)]
    hit = np.concatenate([side != 0 for _, side, _ in rows])
    time, side, speed = (np.concatenate(row)[hit] for row in zip(*rows, strict=True))
    least, clear = (min(float(getattr(each, name)) for each in parts) for name in ("least_speed", "least_clearance"))
    status = max(int(each.status) for each in parts)
    return Impacts(time, side, speed, sum(int(each.count) for each in parts), least, clear, status)
