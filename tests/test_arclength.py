"""Branches whose points and events are known numbers: folds, crossings, doublings and Neimark-Sacker points."""

from typing import NamedTuple

import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from continuation import arclength, follow, locate, problem, switch
from tests.reference import maps

MIX = np.array([[1.0, 0.3, -0.2], [0.5, 1.0, 0.4], [-0.1, 0.6, 1.0]])
MIDDLE = np.array([1.0, 2.0, -1.0])
ROWS = np.array([[1.0, 0.4], [-0.3, 2.0]])
LIMITS = {"largest": 0.1, "tolerance": 1e-10, "low": -3.0, "high": 3.0}


def two_knots(u, p, args):
    """u'' + p exp(u) = 0, u(0) = u(1) = 0, by differences at 1/3 and 2/3; mixed, so that no slopes are symmetric.

    With equal knots p = 9 u exp(-u), which turns at u = 1; at u = 3 the eigenvalue of (1, -1), 9 u - 27, is zero.
    """
    return ROWS @ (9 * (u[::-1] - 2 * u) + p * jnp.exp(u))


def henon_map(u, p, b):
    return jnp.stack([p - u[0] ** 2 + b * u[1], u[0]])


def henon_twice(u, p, b):
    return henon_map(henon_map(u, p, b), p, b)


def delayed_map(u, p, args):
    return jnp.stack([p * u[0] * (1 - u[1]), u[0]])


def swirl_map(u, p, args):
    """Rotation by 0.9 times sqrt(p + 1/2) in a plane, contraction by 1/2 across it, about p MIDDLE, and bent."""
    (x, y, w) = np.linalg.inv(MIX) @ (u - p * MIDDLE)
    size, cos, sin = jnp.sqrt(0.5 + p), np.cos(0.9), np.sin(0.9)
    turned = jnp.stack([size * (cos * x - sin * y), size * (sin * x + cos * y), 0.5 * w + x * x])
    return p * MIDDLE + MIX @ turned


CIRCLE = problem.equilibria(lambda u, p, square: u * u + p * p - square)
PARABOLA = problem.equilibria(lambda u, p, args: p - u * u)
WAVE = problem.equilibria(lambda u, p, args: p - jnp.sin(4 * u))
RIPPLE = problem.equilibria(lambda u, p, args: u - 0.03 * jnp.sin(20 * p))
TWICE = problem.equilibria(lambda u, p, args: (u - p * p) ** 2)
CUSP = problem.equilibria(lambda u, p, a: p + a * u - u**3)
PITCHFORK = problem.equilibria(lambda u, p, e: p * u - u**3 + e)
TRANSCRITICAL = problem.equilibria(lambda u, p, args: p * u - u * u)
KNOTS = problem.equilibria(two_knots)
ENDING = problem.equilibria(lambda u, p, args: u - jnp.sqrt(1 - p))
BROKEN = problem.equilibria(lambda u, p, args: u - jnp.where(p < 0.5, p, jnp.nan))
DIAGONAL = problem.fixed_points(lambda u, p, other: jnp.stack([p * u[0], other * u[1]]))
CUBIC = problem.fixed_points(lambda u, p, args: p * u - u**3)
HENON = problem.fixed_points(henon_map)
HENON_TWICE = problem.fixed_points(henon_twice)
DELAYED = problem.fixed_points(delayed_map)
SWIRL = problem.fixed_points(swirl_map)


class Walk(NamedTuple):
    """What a branch gave, up to its end or back to its start; closed: the length from the last point to the start."""

    z: np.ndarray
    events: list
    status: int
    closed: float | None = None

    @property
    def kinds(self):
        return [one.kind for one in self.events]

    @property
    def met(self):
        return [one.z for one in self.events]


def control_of(size, scale=None, **limits):
    numbers = {key: np.float64(value) for key, value in (LIMITS | limits).items()}
    return arclength.Control(scale=np.ones(size) if scale is None else scale, smallest=np.float64(1e-7), **numbers)


def place_of(z, tangent, first=0.05):
    z, tangent = np.asarray(z, float), np.asarray(tangent, float)
    return arclength.Place(z, tangent, np.float64(first), np.int32(arclength.ON))


def walk(what, z, args=None, along=None, tangent=None, first=0.05, **limits):
    """From z, as near as can be to a direction or else towards greater parameters, or with a tangent: `Walk`."""
    z = np.asarray(z, float)
    control = control_of(len(z), **limits)
    tangent = follow.tangent(what, z, control.scale, args, along) if tangent is None else tangent
    zs, events = [z[None]], []
    for points, status in follow.stretches(what, place_of(z, tangent, first), control, args):
        seen = follow.events(what, points, follow.watched(what, points, args), control, args)
        closed = follow.passes_mark(what, points, z[None], control, args)
        if closed:
            zs.append(points.z[1 : closed[0] + 1])
            events += [one for one in seen if (one.after, one.length) < closed]
            return Walk(np.concatenate(zs), events, status, closed[1])
        zs.append(points.z[1:])
        events += seen
        if len(zs) > 12:
            break
    return Walk(np.concatenate(zs), events, status)


def leaving(what, z, tangent, args=None, **limits):
    """The `Walk`s both ways from a crossing, less what is seen in the crossing itself."""
    both = [walk(what, z, args, tangent=sign * tangent, **limits) for sign in (1, -1)]
    return [each._replace(events=[one for one in each.events if np.linalg.norm(one.z - z) > 1e-6]) for each in both]


def close(found, true, tolerance):
    return np.allclose(np.asarray(found, float), np.asarray(true, float), rtol=0, atol=tolerance)


@pytest.mark.parametrize("tolerance", [1e-8, 1e-13])
@pytest.mark.parametrize("largest", [0.05, 0.2, 1.0])
@pytest.mark.parametrize("first", [0.05, 0.2, 0.5, 1.0])
def test_a_circle_closes(first, largest, tolerance):
    found = walk(CIRCLE, [0.6, 0.8], 1.0, first=first, largest=largest, tolerance=tolerance)
    assert found.kinds == ["SN", "SN"]
    assert close(found.met, [[0, 1], [0, -1]], 1e-14)
    assert close(np.sum(found.z**2, axis=1), 1, 1e-12)
    start = np.arctan2(0.6, 0.8)
    steps = -np.diff(np.append(np.unwrap(np.arctan2(*found.z.T)), start - 2 * np.pi))
    assert np.all(steps > 0)
    assert steps.max() < arclength.LARGEST_TURN
    assert steps[1:].max() < min(1.01 * largest, 1.1 * arclength.TURN)
    assert close(found.closed, np.sin(steps[-1]), 1e-9)  # along the last tangent


def test_a_fold_and_bounds():
    found = walk(PARABOLA, [-1.0, 1.0], along=[1, 0], high=2.0)
    assert found.kinds == ["SN"]
    assert close(found.met, [[0, 0]], 1e-14)
    assert close(found.z[:, 1], found.z[:, 0] ** 2, 1e-12)
    assert found.status == arclength.OUT
    assert found.z[-1, 1] > 2 >= found.z[:-1, 1].max()
    found = walk(PARABOLA, [-1.0, 1.0], along=[1, 0], low=0.5, high=1.5)
    assert found.kinds == []
    assert found.status == arclength.OUT
    assert found.z[-1, 1] < 0.5 <= found.z[:-1, 1].min()


def test_a_step_that_strays_is_refused():
    period = np.pi / 10
    found = walk(
        RIPPLE, [0.0, 0.0], first=period / np.hypot(0.6, 1), largest=1.0
    )  # a period on, the tangent is the same
    assert close(found.z[:, 0], 0.03 * np.sin(20 * found.z[:, 1]), 1e-12)
    assert 0 < np.diff(found.z[:, 1]).min() < np.diff(found.z[:, 1]).max() < 0.4 * period


def test_a_step_is_kept_only_where_newton_s_method_ended():
    place = place_of([1.0, 1.0], np.array([2.0, 1.0]) / np.sqrt(5))
    points, _ = next(follow.stretches(TWICE, place, control_of(2), None))
    assert len(points.z) > 5
    assert abs(points.z[:, 0] - points.z[:, 1] ** 2).max() < 1e-9


def test_every_fold_of_many_is_seen_once():
    found = walk(WAVE, [0.0, 0.0], along=[1, 0])
    folds = np.arange(0.5, found.z[-1, 0] * 4 / np.pi) * np.pi / 4
    assert found.kinds == ["SN"] * len(folds)
    assert len(folds) > 12
    assert close(found.met, np.stack([folds, np.sin(4 * folds)], 1), 1e-13)


@pytest.mark.parametrize("a", [1.0, 2.5, -0.5])
def test_cusp(a):
    found = walk(CUSP, [-2.0, -8.0 + 2.0 * a], a, low=-9.0, high=5.0)
    u = np.sqrt(max(a, 0) / 3)
    true = [[-u, 2 * a * u / 3], [u, -2 * a * u / 3]] if a > 0 else []
    assert found.kinds == ["SN"] * len(true)
    assert close(found.met, true, 1e-14)
    assert close(found.z[:, 1], found.z[:, 0] ** 3 - a * found.z[:, 0], 1e-12)
    assert found.status == arclength.OUT
    assert found.z[-1, 1] > 5


@pytest.mark.parametrize(
    ("z", "along"), [([0, -1], [0, 1]), ([0, 1.03], [0, -1]), ([1.2, 1.44], [-1, -1]), ([-1.1, 1.21], [1, -1])]
)
def test_a_pitchfork_from_each_branch(z, along):
    found = walk(PITCHFORK, z, 0.0, along=along)
    assert found.kinds == ["BP"]
    assert close(found.met, [[0, 0]], 1e-12)
    u, p = found.z.T
    assert close(u if z[0] == 0 else p - u * u, 0, 1e-12)
    assert u[0] * u[-1] < 0 or p[0] * p[-1] < 0  # on beyond the crossing


def test_a_crossing_where_a_branch_turns_is_no_fold_as_well():
    for u in np.linspace(0.01, 0.02, 5):  # steps so short that a fold is found there too
        found = walk(PITCHFORK, [u, u * u], 0.0, along=[-1, 0], first=1e-3, largest=2e-3, high=5e-4)
        assert found.kinds == ["BP"]
        assert close(found.met, [[0, 0]], 1e-12)


def test_the_switched_branch_of_a_pitchfork():
    crossing = walk(PITCHFORK, [0.0, -1.0], 0.0).events[0].z
    both = switch.directions(PITCHFORK, crossing, np.ones(2), 0.0)
    ends = []
    for found in leaving(PITCHFORK, crossing, switch.other(both, np.array([0.0, 1.0]), np.ones(2)), 0.0):
        assert close(found.z[:, 1], found.z[:, 0] ** 2, 1e-12)
        assert found.kinds == []
        assert found.status == arclength.OUT
        ends.append(found.z[-1, 0])
    assert min(ends) < -np.sqrt(3) and max(ends) > np.sqrt(3)


@pytest.mark.parametrize(("z", "along"), [([0, -1], [0, 1]), ([-1, -1], [1, 1]), ([1.05, 1.05], [-1, -1])])
def test_a_transcritical_crossing(z, along):
    found = walk(TRANSCRITICAL, z, along=along)
    assert found.kinds == ["BP"]
    assert close(found.met, [[0, 0]], 1e-12)
    assert close(found.z[:, 0], found.z[:, 1] if z[0] else 0, 1e-12)


@pytest.mark.parametrize(("e", "largest"), [(0.1, 0.1), (0.01, 0.1), (1e-4, 0.01), (-0.1, 0.1)])
def test_a_broken_pitchfork_has_a_fold_and_no_crossing(e, largest):
    sign = np.sign(e)
    found = walk(PITCHFORK, [-sign * 1.1, 1.21 + abs(e) / 1.1], e, along=[sign, 0], largest=largest, high=1.5)
    assert found.kinds == ["SN"]
    assert close(found.met, [[-np.cbrt(e / 2), 3 * np.cbrt(e / 2) ** 2]], 1e-12)
    u, p = found.z.T
    assert close(p * u - u**3 + e, 0, 1e-12)
    assert -np.sign(e) * u[-1] > 0 and p[-1] > 1.5
    found = walk(PITCHFORK, [e, e * e - 1], e, largest=largest, high=1.5)
    assert found.kinds == []
    assert np.sign(e) * found.z[-1, 0] > np.sqrt(1.5)


def test_no_crossing_is_located_off_the_branch():
    found = locate.branch_point(PITCHFORK, np.array([0.01, 0.02]), 1e-3)
    assert found.z is None or found.residual > 1e-4


def test_two_unknowns_turn_and_cross():
    found = walk(KNOTS, [0.2, 0.2, 1.8 * np.exp(-0.2)], low=0.3, high=4.0)
    crossing = np.array([3, 3, 27 * np.exp(-3)])
    assert found.kinds == ["SN", "BP"]
    assert close(found.met, [[1, 1, 9 / np.e], crossing], 1e-13)
    both = switch.directions(KNOTS, found.met[1], np.ones(3), None)
    for side in leaving(KNOTS, found.met[1], switch.other(both, np.array([1, 1, 0]), np.ones(3)), low=0.3, high=4.0):
        left, right, p = side.z.T
        assert abs(left - right)[-1] > 1
        assert close(p * np.exp(left), 9 * (2 * left - right), 1e-11)
        assert close(p * np.exp(right), 9 * (2 * right - left), 1e-11)


def test_a_branch_that_starts_in_a_crossing_does_not_meet_it_again():
    crossing = locate.branch_point(KNOTS, np.array([2.95, 3.04, 1.3]), None).z
    for tangent in switch.directions(KNOTS, crossing, np.ones(3), None):
        for sign in (1, -1):
            found = walk(KNOTS, crossing, tangent=sign * tangent, low=1.0, high=1.6)
            assert [one.kind for one in found.events if one.after == 0] == []


def test_a_map_of_one_number():
    for sign, kind in ((-1, "PD"), (1, "BP")):
        found = walk(CUBIC, np.zeros(2), along=[0, sign], first=0.07)
        assert found.kinds == [kind]
        assert close(found.met, [[0, sign]], 1e-12)


@pytest.mark.parametrize("b", [0.3, -0.5])
def test_henon(b):
    s = 1 - b
    for sign, kind, u, p in ((-1, "SN", -s / 2, -s * s / 4), (1, "PD", s / 2, 3 * s * s / 4)):
        found = walk(HENON, np.zeros(3), b, along=[0, 0, sign])
        assert found.kinds == [kind]
        assert close(found.met, [[u, u, p]], 1e-12)
        assert close(found.z[:, 0] ** 2 + s * found.z[:, 0], found.z[:, 2], 1e-12)
        assert close(found.z[:, 0], found.z[:, 1], 1e-12)


@pytest.mark.parametrize("b", [0.3, -0.5])
def test_the_two_cycle_of_henon(b):
    s = 1 - b
    (doubling,) = walk(HENON, np.zeros(3), b, high=2.0).met
    null = locate.null(locate.matrices(HENON, HENON.tests[0], doubling, b)[0])
    assert close(abs(null @ [1, -1]), np.sqrt(2), 1e-12)
    p = s * s + (1 + b) ** 2 / 4
    for found in leaving(HENON_TWICE, doubling, np.append(null, 0.0), b, high=2.7):
        x, y = found.z[:, 0], found.z[:, 1]
        assert close(x + y, s, 1e-12)
        assert close(x * y, s * s - found.z[:, 2], 1e-12)
        assert found.kinds == ["PD"]
        with mpmath.workdps(40):
            true = maps.doubled_cycle(b, tuple(found.met[0].round(2)))
        assert close(found.met[0], true, 1e-10)
        assert close(found.met[0][2], p, 1e-12)


def test_delayed_logistic():
    found = walk(DELAYED, [1 / 3, 1 / 3, 1.5])
    assert found.kinds == ["NS"]
    assert close(found.met, [[0.5, 0.5, 2]], 1e-12)
    assert close(found.z[:, 0], 1 - 1 / found.z[:, 2], 1e-12)
    found = walk(DELAYED, [1 / 3, 1 / 3, 1.5], along=[0, 0, -1], low=0.5)
    assert found.kinds == ["BP"]
    assert close(found.met, [[0, 0, 1]], 1e-12)


def test_a_neimark_sacker_point_in_three_dimensions():
    found = walk(SWIRL, np.zeros(3 + 1), high=1.2)
    assert found.kinds == ["NS"]
    assert close(found.met, [[*0.5 * MIDDLE, 0.5]], 1e-12)
    assert close(found.z[:, :3], found.z[:, 3:] * MIDDLE, 1e-12)


def test_a_neutral_saddle_is_no_neimark_sacker_point():
    found = walk(DIAGONAL, [0.0, 0.0, 0.2], 2.0, high=0.9)
    assert "NS" not in found.kinds


def test_a_point_that_is_an_event():
    found = walk(DIAGONAL, np.zeros(3), 0.5, along=[0, 0, -1], first=0.25, largest=0.25, low=-1.6)
    assert -1 in found.z[:, 2]
    assert found.kinds == ["PD"]


def test_where_a_branch_ends():
    found = walk(ENDING, [1.0, 0.0])
    assert found.status == arclength.NONFINITE
    assert found.kinds == []
    assert close(found.z[:, 0] ** 2, 1 - found.z[:, 1], 1e-11)
    assert np.all(np.diff(found.z[:, 1]) > 0)
    assert 1 - 1e-12 < found.z[-1, 1] <= 1
    found = walk(BROKEN, [0.0, 0.0])
    assert found.status == arclength.NONFINITE
    assert close(found.z[:, 0], found.z[:, 1], 1e-15)
    assert 0.5 - 1e-6 < found.z[-1, 1] < 0.5


def row_of(what, zs, args, step):
    """Points so far apart as if in a row, each with the tangent towards greater parameters; (points, control)."""
    control = control_of(2)
    none = np.zeros(())
    rows = []
    for z in np.asarray(zs, float):
        ahead = follow.tangent(what, z, control.scale, args)
        begun = arclength.Point(z, ahead, none, none, none, np.True_, np.True_)
        rows.append(follow.step(what, begun, 0.0, control, args)._replace(step=np.float64(step)))
    return arclength.Point(*(np.stack(each) for each in zip(*rows, strict=True))), control


def test_a_jump_to_another_branch_is_told_from_a_crossing():
    _, middle, upper = np.sort(np.roots([-1.0, 0.0, 0.5, 0.01]).real)  # the sheets at p = 0.5: two meet in a fold
    points, control = row_of(PITCHFORK, [[upper - 0.001, 0.499], [middle, 0.5]], 0.01, 0.8)
    assert follow.jump(PITCHFORK, points, control, 0.01) == (1, {})
    points, control = row_of(PITCHFORK, [[upper - 0.001, 0.499], [upper, 0.5]], 0.01, 0.01)
    assert follow.jump(PITCHFORK, points, control, 0.01) == (None, {})
    points, control = row_of(PITCHFORK, [[0.0, -0.2], [0.0, 0.2]], 0.0, 0.4)
    place, known = follow.jump(PITCHFORK, points, control, 0.0)
    assert place is None and list(known) == [0] and known[0].kind == "BP" and close(known[0].z, [0, 0], 1e-12)
