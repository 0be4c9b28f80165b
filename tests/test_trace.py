"""Branches and curves whose points and events are known numbers, as a user of `continuation` alone asks for them."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

import continuation as co
from continuation import arclength
from continuation.continuation_loop import End
from tests.reference import maps

MIX = np.array([[1.0, 0.3, -0.2], [0.5, 1.0, 0.4], [-0.1, 0.6, 1.0]])
MIDDLE = np.array([1.0, 2.0, -1.0])
ROWS = np.array([[1.0, 0.4], [-0.3, 2.0]])


def two_knots(u, p, args):
    """u'' + p exp(u) = 0, u(0) = u(1) = 0, by differences at 1/3 and 2/3; mixed, so that no slopes are symmetric.

    With equal knots p = 9 u exp(-u), which turns at u = 1; at u = 3 the eigenvalue of (1, -1), 9 u - 27, is zero.
    """
    return ROWS @ (9 * (u[::-1] - 2 * u) + p["p"] * jnp.exp(u))


def swirl_map(u, p, args):
    """Rotation by 0.9 times sqrt(p + 1/2) in a plane, contraction by 1/2 across it, about p MIDDLE, and bent."""
    (x, y, w) = np.linalg.inv(MIX) @ (u - p["p"] * MIDDLE)
    size, cos, sin = jnp.sqrt(0.5 + p["p"]), np.cos(0.9), np.sin(0.9)
    turned = jnp.stack([size * (cos * x - sin * y), size * (sin * x + cos * y), 0.5 * w + x * x])
    return p["p"] * MIDDLE + MIX @ turned


def bratu(u, p, args):
    """u'' + p exp(u) = 0, u = 0 at both ends, by central differences with as many knots within as u has."""
    step, ends = 1.0 / (len(u) + 1), jnp.zeros(1)
    wide = jnp.concatenate([ends, u, ends])
    return (wide[2:] - 2.0 * u + wide[:-2]) / step**2 + p["p"] * jnp.exp(u)


def brusselator(u, p, args):
    x, y = u
    return jnp.stack([p["a"] - (p["b"] + 1.0) * x + x * x * y, p["b"] * x - x * x * y])


def lorenz84(u, p, args):
    x, y, z, w = u
    first = -y * y - z * z - 0.25 * x + 0.25 * p["F"] - 0.987 * w * w
    return jnp.stack([first, x * y - x * z - y + 0.25, x * y + x * z - z, -1.04 * w + 0.987 * w * x + p["T"]])


CIRCLE = co.equilibria(lambda u, p, args: u * u + p["p"] ** 2 - 1.0)
PARABOLA = co.equilibria(lambda u, p, args: p["p"] - u * u)
WAVE = co.equilibria(lambda u, p, args: p["p"] - jnp.sin(4 * u))
RIPPLE = co.equilibria(lambda u, p, args: u - 0.03 * jnp.sin(20 * p["p"]))
BEND = co.equilibria(lambda u, p, args: u - p["p"] + p["p"] ** 3)
CUSP = co.equilibria(lambda u, p, args: p["h"] + p["r"] * u - u**3)
PITCHFORK = co.equilibria(lambda u, p, args: p["p"] * u - u**3 + p["e"])
TRANSCRITICAL = co.equilibria(lambda u, p, args: p["p"] * u - u * u)
KNOTS = co.equilibria(two_knots)
ENDING = co.equilibria(lambda u, p, args: u - jnp.sqrt(1 - p["p"]))
BROKEN = co.equilibria(lambda u, p, args: u - jnp.where(p["p"] < 0.5, p["p"], jnp.nan))
DIAGONAL = co.fixed_points(lambda u, p, other: jnp.stack([p["p"] * u[0], other * u[1]]))
CUBIC = co.fixed_points(lambda u, p, args: p["p"] * u - u**3)
HENON = co.fixed_points(lambda u, p, args: jnp.stack([p["a"] - u[0] ** 2 + p["b"] * u[1], u[0]]))
DELAYED = co.fixed_points(lambda u, p, args: jnp.stack([p["r"] * u[0] * (1 - u[1]) + p["e"], u[0]]))
SWIRL = co.fixed_points(swirl_map)


def kinds(branch):
    """Of the special points but for ends."""
    return [one.kind for one in branch.special if one.kind != "EP"]


def met(branch):
    """(u, parameters along the branch) of the special points but for ends."""
    return [one.z for one in branch.special if one.kind != "EP"]


def close(found, true, tolerance):
    return np.allclose(np.asarray(found, float), np.asarray(true, float), rtol=0, atol=tolerance)


@pytest.mark.parametrize("tolerance", [1e-8, 1e-13])
@pytest.mark.parametrize("largest", [0.05, 0.2, 1.0])
@pytest.mark.parametrize("first", [0.05, 0.2, 0.5, 1.0])
def test_a_circle_closes(first, largest, tolerance):
    steps = {"first_step": first, "largest_step": largest, "tolerance": tolerance}
    found = co.trace(CIRCLE, [0.6], {"p": 0.8}, "p", (-3.0, 3.0), **steps)
    assert kinds(found) == ["SN", "SN"]
    assert close(met(found), [[0, 1], [0, -1]], 1e-14)
    assert close(found.u[:, 0] ** 2 + found.p["p"] ** 2, 1, 1e-12)
    turns = -np.diff(np.unwrap(np.arctan2(found.u[:, 0], found.p["p"])))
    assert np.all(turns < 0) or np.all(turns > 0)
    assert close(abs(turns.sum()), 2 * np.pi, 1e-6)
    assert abs(turns).max() < arclength.MAX_ANGLE
    assert found.reasons == ("the start", End.CLOSED.value.format(value=0.8))


def test_a_fold_and_bounds():
    found = co.trace(PARABOLA, [-1.0], {"p": 1.0}, "p", (-1.0, 2.0))
    assert kinds(found) == ["SN"]
    assert close(met(found), [[0, 0]], 1e-14)
    assert close(found.p["p"], found.u[:, 0] ** 2, 1e-12)
    assert found.p["p"][[0, -1]].tolist() == [2.0, 2.0]
    assert (found.stable == (found.u[:, 0] > 1e-13)).all()
    found = co.trace(PARABOLA, [-1.0], {"p": 1.0}, "p", (0.5, 1.5))
    assert kinds(found) == []
    assert sorted(found.p["p"][[0, -1]]) == [0.5, 1.5]


def test_a_step_that_strays_is_refused():
    period = np.pi / 10  # a period on, the tangent is the same
    steps = {"first_step": period / np.hypot(0.6, 1), "largest_step": 1.0}
    found = co.trace(RIPPLE, [0.0], {"p": 0.0}, "p", (-0.1, 3.0), direction="forward", **steps)
    assert close(found.u[:, 0], 0.03 * np.sin(20 * found.p["p"]), 1e-12)
    assert 0 < np.diff(found.p["p"]).min() < np.diff(found.p["p"]).max() < 0.4 * period


def test_a_step_that_turns_too_far_is_refused():
    """The tangent of u = p - p^3 at 1/2 meets the curve again at -1, where that has another slope."""
    steps = {"first_step": 1.5 * np.hypot(1.0, 0.25), "largest_step": 2.0}
    found = co.trace(BEND, [0.375], {"p": 0.5}, "p", (-2.0, 1.0), direction="backward", **steps)
    angle = np.arctan(1.0 - 3.0 * found.p["p"] ** 2)
    assert close(found.u[:, 0], found.p["p"] - found.p["p"] ** 3, 1e-12)
    assert len(found.u) > 10 and abs(np.diff(angle)).max() < arclength.MAX_ANGLE


def test_every_fold_of_many_is_seen_once_and_monitors_and_stops():
    found = co.trace(
        WAVE, [0.0], {"p": 0.0}, "p", (-3.0, 3.0), monitors={"far": lambda u, p, args: u[0] - 10.0}, stop=["far"]
    )
    folds = np.arange(0.5, 10.0 * 4 / np.pi) * np.pi / 4
    ahead = [one for one in found.special if one.u[0] > 0.1]
    assert [one.kind for one in ahead] == ["SN"] * len(folds) + ["far"]
    assert close([one.z for one in ahead[:-1]], np.stack([folds, np.sin(4 * folds)], 1), 1e-13)
    assert close(ahead[-1].u, 10.0, 1e-12)
    assert found.reasons[1] == End.STOPPED.value.format(kind="far", value=np.sin(40.0))


@pytest.mark.parametrize("r", [1.0, 2.5, -0.5])
def test_cusp(r):
    found = co.trace(CUSP, [-2.0], {"h": -8.0 + 2.0 * r, "r": r}, "h", (-9.0, 5.0))
    u = np.sqrt(max(r, 0) / 3)
    assert kinds(found) == ["SN"] * (2 if r > 0 else 0)
    assert close(met(found), [[-u, 2 * r * u / 3], [u, -2 * r * u / 3]] if r > 0 else [], 1e-14)
    assert close(found.p["h"], found.u[:, 0] ** 3 - r * found.u[:, 0], 1e-12)
    assert found.p["h"][-1] == 5.0


@pytest.mark.parametrize(("least", "most"), [(-1.087, 1.99), (-1.08, 1.9995), (-1.087, 1.98)])
def test_a_step_that_crosses_two_bounds_ends_at_the_first(least, most):
    """The folds lie at h = -2 (r / 3)^1.5."""
    fold = co.trace(CUSP, [-2.0], {"h": -6.0, "r": 1.0}, "h", (-9.0, 9.0)).points("SN")
    fold = next(one for one in fold if one.p["h"] < 0)
    found = co.curve(fold, ("h", "r"), {"h": (least, 9.0), "r": (0.5, most)}, largest_step=0.5)
    name, end = ("r", most) if 2 * (most / 3) ** 1.5 < -least else ("h", 3 * (-least / 2) ** (2 / 3))
    top = max(found.special, key=lambda one: one.p["r"])
    assert abs(top.p["r"] - end) < 1e-12 and abs(top.p["h"] + 2 * (end / 3) ** 1.5) < 1e-12
    assert any(f"{name} reached its bound" in one for one in found.reason.values())


def test_the_curve_of_folds_has_a_cusp():
    fold = co.trace(CUSP, [-2.0], {"h": -6.0, "r": 1.0}, "h", (-9.0, 9.0)).points("SN")[0]
    found = co.curve(fold, ("h", "r"), {"h": (-9.0, 9.0), "r": (-1.0, 3.0)})
    assert kinds(found) == ["CP"]
    assert close(met(found), [[0, 0, 0]], 1e-12)
    assert close(27 * found.p["h"] ** 2, 4 * found.p["r"] ** 3, 1e-10)
    assert close(co.sensitivity(fold, "r"), -fold.u, 1e-12)


@pytest.mark.parametrize(("u", "p"), [(0.0, -1.0), (1.2, 1.44), (-1.1, 1.21)])
def test_a_pitchfork_from_each_branch(u, p):
    found = co.trace(PITCHFORK, [u], {"p": p, "e": 0.0}, "p", (-2.0, 2.0))
    assert kinds(found) == ["BP"]
    assert close(met(found), [[0, 0]], 1e-12)
    assert close(found.u[:, 0] if u == 0 else found.p["p"] - found.u[:, 0] ** 2, 0, 1e-12)
    for half in co.switch(found.points("BP")[0]):
        assert kinds(half) == []
        assert close(half.p["p"] - half.u[:, 0] ** 2 if u == 0 else half.u[:, 0], 0, 1e-12)


def test_a_crossing_where_a_branch_turns_is_no_fold_as_well():
    for u in np.linspace(0.01, 0.02, 5):  # steps so short that a fold is found there too
        steps = {"first_step": 1e-3, "largest_step": 2e-3}
        found = co.trace(PITCHFORK, [u], {"p": u * u, "e": 0.0}, "p", (-1e-3, 1e-3), **steps)
        assert kinds(found) == ["BP"]
        assert close(met(found), [[0, 0]], 1e-12)


def test_a_transcritical_crossing():
    for u, p in ((0, -1), (-1, -1), (1.05, 1.05)):
        found = co.trace(TRANSCRITICAL, [u], {"p": p}, "p", (-3.0, 3.0))
        assert kinds(found) == ["BP"]
        assert close(met(found), [[0, 0]], 1e-12)
        assert close(found.u[:, 0], found.p["p"] if u else 0, 1e-12)


KNOT = [1.0, 1.0, -18.0 * np.exp(-3.0)]  # p e^u = 9 u at u = 3


@pytest.mark.parametrize(
    ("system", "u", "at", "along"),
    [
        (PITCHFORK, [0.0], {"p": -1.0, "e": 0.0}, [0.0, 1.0]),
        (PITCHFORK, [1.2], {"p": 1.44, "e": 0.0}, [1.0, 0.0]),
        (TRANSCRITICAL, [-1.0], {"p": -1.0}, [1.0, 1.0]),
        (KNOTS, [0.2, 0.2], {"p": 1.8 * np.exp(-0.2)}, KNOT),
    ],
)
def test_the_tangent_at_a_crossing_is_that_of_the_branch_which_comes_there(system, u, at, along):
    (point,) = co.trace(system, u, at, "p", (-2.0, 4.0)).points("BP")
    assert close(abs(point.tangent @ along) / np.linalg.norm(along), 1.0, 1e-15)
    assert close(np.linalg.norm(point.tangent), 1.0, 1e-15)


@pytest.mark.parametrize(("e", "largest"), [(0.1, 0.1), (0.01, 0.1), (1e-4, 0.01), (-0.1, 0.1)])
def test_a_broken_pitchfork_has_a_fold_and_no_crossing(e, largest):
    sign = np.sign(e)
    at = {"p": 1.21 + abs(e) / 1.1, "e": e}
    found = co.trace(PITCHFORK, [-sign * 1.1], at, "p", (-2.0, 1.5), largest_step=largest)
    assert kinds(found) == ["SN"]
    assert close(met(found), [[-np.cbrt(e / 2), 3 * np.cbrt(e / 2) ** 2]], 1e-12)
    u, p = found.u[:, 0], found.p["p"]
    assert close(p * u - u**3 + e, 0, 1e-12)
    assert close(p[[0, -1]], 1.5, 0)
    found = co.trace(PITCHFORK, [e], {"p": e * e - 1, "e": e}, "p", (-2.0, 1.5), largest_step=largest)
    assert kinds(found) == []
    assert sign * found.u[-1, 0] > np.sqrt(1.5)


def test_two_unknowns_turn_and_cross():
    found = co.trace(KNOTS, [0.2, 0.2], {"p": 1.8 * np.exp(-0.2)}, "p", (0.3, 4.0))
    assert kinds(found) == ["SN", "BP"]
    assert close(met(found), [[1, 1, 9 / np.e], [3, 3, 27 * np.exp(-3)]], 1e-13)
    for side in co.switch(found.points("BP")[0]):
        (left, right), p = side.u.T, side.p["p"]
        assert abs(left - right)[-1] > 1
        assert close(p * np.exp(left), 9 * (2 * left - right), 1e-11)
        assert close(p * np.exp(right), 9 * (2 * right - left), 1e-11)
        assert "BP" not in kinds(side)  # the crossing that it begins in is not met again


def test_a_map_of_one_number():
    found = co.trace(CUBIC, [0.0], {"p": 0.0}, "p", (-3.0, 3.0), first_step=0.07)
    assert kinds(found) == ["PD", "BP"]
    assert close(met(found), [[0, -1], [0, 1]], 1e-12)


@pytest.mark.parametrize("b", [0.3, -0.5])
def test_henon_and_its_two_cycle(b):
    s = 1 - b
    found = co.trace(HENON, [0.0, 0.0], {"a": 0.0, "b": b}, "a", (-3.0, 2.7))
    assert kinds(found) == ["SN", "PD"]
    assert close(met(found), [[-s / 2, -s / 2, -s * s / 4], [s / 2, s / 2, 3 * s * s / 4]], 1e-12)
    (cycle,) = co.switch(found.points("PD")[0])
    assert kinds(cycle)[0] == "PD"
    assert close(cycle.u.sum(axis=1), s, 1e-12)
    assert close(cycle.u.prod(axis=1), s * s - cycle.p["a"], 1e-12)
    with mpmath.workdps(40):
        true = maps.doubled_cycle(b, tuple(cycle.points("PD")[0].z.round(2)))
    assert close(cycle.points("PD")[0].z, true, 1e-10)
    assert close(cycle.points("PD")[0].p["a"], s * s + (1 + b) ** 2 / 4, 1e-12)


def test_the_curves_of_henon():
    """With multipliers m and -b / m: fold a = -(1 - b)^2 / 4, doubling a = 3 (1 - b)^2 / 4, both at b = 1, R1 and R2 at
    b = -1."""
    found = co.trace(HENON, [0.0, 0.0], {"a": 0.0, "b": 0.3}, "a", (-3.0, 2.7))
    for kind, factor, double in (("SN", -0.25, "R1"), ("PD", 0.75, "R2")):
        (point,) = found.points(kind)
        curve = co.curve(point, ("a", "b"), {"a": (-9.0, 9.0), "b": (-1.8, 1.8)})
        assert sorted(kinds(curve)) == sorted(["FF", double])
        assert close(curve.p["a"], factor * (1 - curve.p["b"]) ** 2, 1e-11)
        assert close([curve.points("FF")[0].p["b"], curve.points(double)[0].p["b"]], [1, -1], 1e-12)
        assert close(co.sensitivity(point, ["b"]), -2 * factor * 0.7, 1e-11)


def test_delayed_logistic():
    found = co.trace(DELAYED, [1 / 3, 1 / 3], {"r": 1.5, "e": 0.0}, "r", (0.5, 2.5))
    assert kinds(found) == ["BP", "NS"]
    assert close(met(found), [[0, 0, 1], [0.5, 0.5, 2]], 1e-12)
    assert close(sorted(np.angle(found.points("NS")[0].eigenvalues)), [-np.pi / 3, np.pi / 3], 1e-12)
    curve = co.curve(found.points("NS")[0], ("r", "e"), {"r": (0.1, 9.0), "e": (-2.0, 2.0)})
    assert close(curve.u[:, 0] * curve.p["r"], 1, 1e-11)  # the product of the multipliers
    assert sorted(kinds(curve)) == ["R1", "R4"]  # their sum is r - 1
    assert close(curve.points("R1")[0].z, [1 / 3, 1 / 3, 3, -1 / 3], 1e-11)
    assert close(curve.points("R4")[0].z, [1, 1, 1, 1], 1e-11)


def test_a_neimark_sacker_point_in_three_dimensions():
    found = co.trace(SWIRL, np.zeros(3), {"p": 0.0}, "p", (-0.1, 1.2))
    assert kinds(found) == ["NS"]
    assert close(met(found), [[*0.5 * MIDDLE, 0.5]], 1e-12)
    assert close(found.u, found.p["p"][:, None] * MIDDLE, 1e-12)


def test_a_neutral_saddle_is_no_neimark_sacker_point():
    found = co.trace(DIAGONAL, [0.0, 0.0], {"p": 0.2}, "p", (-0.9, 0.9), args=2.0)
    assert kinds(found) == []


def test_a_point_that_is_an_event():
    steps = {"first_step": 0.25, "largest_step": 0.25}
    found = co.trace(DIAGONAL, np.zeros(2), {"p": 0.0}, "p", (-1.6, 0.5), args=0.5, direction="backward", **steps)
    assert -1 in found.p["p"]
    assert kinds(found) == ["PD"]


def test_hopf_points_and_their_curve():
    found = co.trace(co.equilibria(brusselator), [1.0, 1.0], {"a": 1.0, "b": 1.0}, "b", (0.5, 3.0))
    assert kinds(found) == ["HB"]
    assert close(found.points("HB")[0].p["b"], 2, 1e-12)
    assert close(found.points("HB")[0].eigenvalues.imag, [1, -1], 1e-12)
    curve = co.curve(found.points("HB")[0], ("b", "a"), {"b": (1.1, 9.0), "a": (0.2, 2.5)})
    assert close(curve.p["b"], 1 + curve.p["a"] ** 2, 1e-11)


def test_bogdanov_takens_and_double_hopf_points_of_lorenz_84():
    found = co.trace(co.equilibria(lorenz84), [1.0, 0.0, 0.0, 0.0], {"F": 1.0, "T": 0.04}, "F", (0.5, 4.0))
    curve = co.curve(found.points("HB")[0], ("F", "T"), {"F": (0.0, 4.0), "T": (-0.5, 0.5)}, largest_step=0.05)
    (double,) = curve.points("BT")
    assert close(double.p["F"], 1.44671670111536, 1e-10)
    assert close(abs(double.p["T"]), 0.0209401696833226, 1e-10)
    assert "stopped at BT" in curve.reasons[0] + curve.reasons[1]
    (both,) = curve.points("HH")
    assert close([both.p["F"], abs(both.p["T"])], [2.53322110695982, 0.0262739429830842], 1e-12)
    assert len(curve.points("GH")) == 1


def test_henon_to_period_sixteen():
    where, steps = {"a": -0.1, "b": 0.3}, {"direction": "forward", "largest_step": 0.05}
    found = co.trace(HENON, np.zeros(2), where, "a", (-0.2, 1.06), stop=["PD"], **steps)
    for value in (0.3675, 0.9125, 1.02585540507378, 1.05112566203517):
        (doubling,) = found.points("PD")
        assert close(doubling.p["a"], value, 1e-13)
        (found,) = co.switch(doubling, stop=["PD"])


def test_bratu():
    found = co.trace(co.equilibria(bratu), np.zeros(99), {"p": 0.0}, "p", (-0.1, 4.0), stop=["SN"], largest_step=2.0)
    assert close(found.points("SN")[0].p["p"], 3.51364790397, 1e-10)


def test_where_a_branch_ends():
    found = co.trace(ENDING, [1.0], {"p": 0.0}, "p", (-1.0, 2.0), direction="forward")
    assert kinds(found) == []
    assert "not finite" in found.reasons[1]
    assert close(found.u[:, 0] ** 2, 1 - found.p["p"], 1e-11)
    assert 1 - 1e-12 < found.p["p"][-1] <= 1
    found = co.trace(BROKEN, [0.0], {"p": 0.0}, "p", (-1.0, 2.0), direction="forward")
    assert "not finite" in found.reasons[1]
    assert close(found.u[:, 0], found.p["p"], 1e-15)
    assert 0.5 - 1e-6 < found.p["p"][-1] < 0.5


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"u": [np.nan]}, "u"),
        ({"u": [9.0], "at": {"p": -4.0}}, "u"),
        ({"along": "q"}, "along"),
        ({"bounds": (2.0, 3.0)}, "bounds"),
        ({"bounds": (3.0, -3.0)}, "bounds"),
        ({"direction": "up"}, "direction"),
        ({"first_step": 0.0}, "first_step"),
        ({"stop": "SN"}, "stop"),
        ({"stop": ["LP"]}, "stop"),
        ({"system": None}, "system"),
        ({"at": [1.0]}, "at"),
        ({"at": {"p": {"q": 1.0}}}, "at.p"),
        ({"u": [[1.0]]}, "u"),
        ({"system": co.equilibria(lambda u, p, args: [u[0] - p["p"]])}, "function"),
        ({"system": co.equilibria(lambda u, p, args: u[0] - p["p"])}, "function"),
        ({"system": co.equilibria(lambda u, p, args: np.sin(u) - p["p"])}, "function"),
        ({"system": co.equilibria(lambda t, u, p: u - p["p"])}, "function"),
    ],
)
def test_what_cannot_be_is_refused(change, key):
    given = {"system": PARABOLA, "u": [1.0], "at": {"p": 1.0}, "along": "p", "bounds": (-5.0, 3.0)} | change
    with pytest.raises(co.ContinuationError) as told:
        co.trace(**given)
    assert told.value.key == key and "\n" not in str(told.value)


def test_nothing_is_followed_within_jit():
    with pytest.raises(co.ContinuationError, match="u: must be concrete numbers"):
        jax.jit(lambda at: co.trace(PARABOLA, [1.0], {"p": at}, "p", (-5.0, 3.0)).u)(1.0)


def test_a_table_has_a_norm_and_no_more_than_some_numbers():
    def many(u, p, args):
        return jnp.concatenate([p["p"] - u[:1] ** 2, u[1:] - 2.0])

    lines = (
        co.trace(co.equilibria(many), np.append(1.0, np.full(49, 2.0)), {"p": 1.0}, "p", (-5.0, 3.0))
        .table()
        .split("\n")
    )
    assert lines[0].split() == ["kind", "p", "norm", "u", "residual"] and max(map(len, lines)) < 120
    assert lines[1].split()[2] == f"{np.sqrt(3.0 + 49 * 4.0):.9g}" and "..." in lines[1]


def test_a_function_is_held_along_two_parameters():
    """On the cusp's surface h + r u = u^3, which folds at h = -2 u^3, r = 3 u^2."""
    at, bounds = {"h": -1.5, "r": 2.5}, {"h": (-2.9, 5.0), "r": (-2.0, 4.0)}
    found = co.trace(CUSP, [1.0], at, ("h", "r"), bounds, hold={lambda u, p, args: u[0] * (p["h"] + 3.0): 1.5})
    u, h, r = found.u[:, 0], found.p["h"], found.p["r"]
    assert len(found) > 20 and found.names == ("h", "r")
    assert close(u * (h + 3.0), 1.5, 1e-10) and close(h + r * u - u**3, 0, 1e-10)
    folds = np.sort(np.roots([2.0, 0.0, 0.0, -3.0, 1.5]))[-2:]
    assert kinds(found) == ["SN", "SN"]
    assert close(sorted(one.u[0] for one in found.points("SN")), np.sort(folds.real), 1e-12)
    size = {"size": lambda u, p, args: u[0]}
    found = co.trace(CUSP, [1.0], at, ("r", "h"), bounds, hold={"size": 0.9}, monitors=size)
    assert close(found.u, 0.9, 1e-12) and close(found.p["h"] + 0.9 * found.p["r"], 0.9**3, 1e-12)
    assert close(found.points("SN")[0].z, [0.9, 2.43, -1.458], 1e-12)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"along": "h"}, "along"),
        ({"hold": {"size": 1.0}}, "hold"),
        ({"hold": {abs: "1"}}, f"hold.{abs}"),
        ({"bounds": {}}, "bounds"),
    ],
)
def test_what_cannot_be_held_is_refused(change, key):
    given = {
        "along": ("h", "r"),
        "bounds": {"h": (-3.0, 3.0), "r": (-3.0, 3.0)},
        "hold": {lambda u, p, args: u[0]: 1.0},
    }
    with pytest.raises(co.ContinuationError) as told:
        co.trace(CUSP, [1.0], {"h": 0.0, "r": 1.0}, **(given | change))
    assert told.value.key == key


def test_a_branch_of_an_ill_conditioned_system_is_followed_to_its_bounds():
    """u = a^2 with slopes of 1e-6, beside which the roundings of an exact zero move u by 1e-10."""

    def noisy(u, p, args):
        angles = jnp.arange(1.0, 6.0) * u[0]
        zero = jnp.sum(jnp.cos(angles) ** 2 + jnp.sin(angles) ** 2 - 1.0)
        return jnp.stack([1e-6 * (u[0] - p["a"] ** 2) + zero])

    branch = co.trace(co.equilibria(noisy), [0.0], {"a": 0.0}, "a", (-1.0, 2.0))
    assert branch.reasons == ("a reached its bound -1", "a reached its bound 2")
    assert abs(branch.u[:, 0] - branch.p["a"] ** 2).max() < 1e-9
