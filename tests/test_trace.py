"""Branches, curves and periodic orbits of single problems of `continuation`; random ones are in the properties."""

from functools import cache
from math import factorial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import continuation as co
from continuation.shooting import periodic_orbits, settled

from .properties.continued import flown, spiral


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


def figure_of_eight(u, p, half):
    """(sin 2t, half cos t, sin t): at t = pi it passes the point of t = 0 at twice half."""
    x, z = u
    return jnp.stack([half * x - 2.0 * p["p"] * z, z * z / half - half * (1.0 - p["p"] ** 2)])


CIRCLE = co.equilibria(lambda u, p, args: u * u + p["p"] ** 2 - 1.0)
PARABOLA = co.equilibria(lambda u, p, args: p["p"] - u * u)
WAVE = co.equilibria(lambda u, p, args: p["p"] - jnp.sin(4 * u))
RIPPLE = co.equilibria(lambda u, p, args: u - 0.03 * jnp.sin(20 * p["p"]))
BEND = co.equilibria(lambda u, p, args: u - p["p"] + p["p"] ** 3)
CUSP = co.equilibria(lambda u, p, args: p["h"] + p["r"] * u - u**3)
PITCHFORK = co.equilibria(lambda u, p, args: p["p"] * u - u**3 + p["e"])
ENDING = co.equilibria(lambda u, p, args: u - jnp.sqrt(1 - p["p"]))
BROKEN = co.equilibria(lambda u, p, args: u - jnp.where(p["p"] < 0.5, p["p"], jnp.nan))
DIAGONAL = co.fixed_points(lambda u, p, other: jnp.stack([p["p"] * u[0], other * u[1]]))
HENON = co.fixed_points(lambda u, p, args: jnp.stack([p["a"] - u[0] ** 2 + p["b"] * u[1], u[0]]))
DELAYED = co.fixed_points(lambda u, p, args: jnp.stack([p["r"] * u[0] * (1 - u[1]) + p["e"], u[0]]))
MAX_ANGLE = 0.3  # between the tangents of two points


def kinds(branch):
    """Of the special points but for ends."""
    return [one.kind for one in branch.special if one.kind != "EP"]


def met(branch):
    """(u, parameters along the branch) of the special points but for ends."""
    return [one.z for one in branch.special if one.kind != "EP"]


def close(found, true, tolerance):
    return np.allclose(np.asarray(found, float), np.asarray(true, float), rtol=0, atol=tolerance)


@pytest.mark.parametrize(
    ("first", "largest", "tolerance"), [(0.05, 0.05, 1e-8), (0.2, 1.0, 1e-13), (0.5, 0.2, 1e-8), (1.0, 1.0, 1e-8)]
)
def test_a_circle_closes(first, largest, tolerance):
    steps = {"first_step": first, "largest_step": largest, "tolerance": tolerance}
    found = co.trace(CIRCLE, [0.6], {"p": 0.8}, "p", (-3.0, 3.0), **steps)
    assert kinds(found) == ["SN", "SN"]
    assert close(met(found), [[0, 1], [0, -1]], 1e-14)
    assert close(found.u[:, 0] ** 2 + found.p["p"] ** 2, 1, 1e-12)
    turns = -np.diff(np.unwrap(np.arctan2(found.u[:, 0], found.p["p"])))
    assert np.all(turns < 0) or np.all(turns > 0)
    assert close(abs(turns.sum()), 2 * np.pi, 1e-6)
    assert abs(turns).max() < MAX_ANGLE
    assert found.reasons == ("the start", "it closes: the branch came back to its start at 0.8")


def test_a_branch_that_passes_close_to_its_start_goes_on():
    found = co.trace(co.equilibria(figure_of_eight), [0.0, 5e-5], {"p": 0.0}, "p", (-2.0, 2.0), args=5e-5)
    assert sorted(found.p["p"][one.place] for one in found.points("SN")) == pytest.approx([-1.0, 1.0], abs=1e-12)
    assert "it closes" in found.reasons[1]


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
    assert len(found.u) > 10 and abs(np.diff(angle)).max() < MAX_ANGLE


def test_every_fold_of_many_is_seen_once_and_monitors_and_stops():
    found = co.trace(
        WAVE, [0.0], {"p": 0.0}, "p", (-3.0, 3.0), monitors={"far": lambda u, p, args: u[0] - 10.0}, stop=["far"]
    )
    folds = np.arange(0.5, 10.0 * 4 / np.pi) * np.pi / 4
    ahead = [one for one in found.special if one.u[0] > 0.1]
    assert [one.kind for one in ahead] == ["SN"] * len(folds) + ["far"]
    assert close([one.z for one in ahead[:-1]], np.stack([folds, np.sin(4 * folds)], 1), 1e-13)
    assert close(ahead[-1].u, 10.0, 1e-12)
    assert found.reasons[1] == f"stopped at far, {np.sin(40.0):.12g}"


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


@pytest.mark.parametrize(
    ("u", "p", "bound", "largest"),
    [(0.0, -1.0, 2.0, 0.1), (1.2, 1.44, 2.0, 0.1), (-1.1, 1.21, 2.0, 0.1)]
    + [(u, u * u, 1e-3, 2e-3) for u in np.linspace(0.01, 0.02, 5)],  # steps so short that a fold is found there too
)
def test_a_pitchfork_from_each_branch(u, p, bound, largest):
    """Where the branch turns as it is crossed there is no fold besides."""
    steps = {"first_step": 0.5 * largest, "largest_step": largest}
    found = co.trace(PITCHFORK, [u], {"p": p, "e": 0.0}, "p", (-bound, bound), **steps)
    assert kinds(found) == ["BP"]
    assert close(met(found), [[0, 0]], 1e-12)
    assert close(found.u[:, 0] if u == 0 else found.p["p"] - found.u[:, 0] ** 2, 0, 1e-12)
    for half in co.switch(found.points("BP")[0], **steps):
        assert kinds(half) == []
        assert close(half.p["p"] - half.u[:, 0] ** 2 if u == 0 else half.u[:, 0], 0, 1e-12)


@pytest.mark.parametrize(("e", "step"), [(0.1, 0.1), (0.01, 0.1), (1e-4, 0.01), (-0.1, 0.1), (0.001, 0.3)])
def test_a_broken_pitchfork_has_a_fold_and_no_crossing(e, step):
    """The last step is so long that a jump to the other branch is refused."""
    sign, steps = np.sign(e), {"first_step": step, "largest_step": step}
    found = co.trace(PITCHFORK, [-sign * 1.1], {"p": 1.21 + abs(e) / 1.1, "e": e}, "p", (-2.0, 1.5), **steps)
    assert kinds(found) == ["SN"]
    assert close(met(found), [[-np.cbrt(e / 2), 3 * np.cbrt(e / 2) ** 2]], 1e-12)
    u, p = found.u[:, 0], found.p["p"]
    assert close(p * u - u**3 + e, 0, 1e-12)
    assert close(p[[0, -1]], 1.5, 0)
    found = co.trace(PITCHFORK, [e], {"p": e * e - 1, "e": e}, "p", (-2.0, 1.5), **steps)
    assert kinds(found) == []
    assert sign * found.u[-1, 0] > np.sqrt(1.5)


@pytest.mark.parametrize(("before", "seen"), [(1e-9, 0), (1e-7, 1), (0.1, 1)])
def test_a_crossing_in_which_a_branch_begins_is_not_met_again(before, seen):
    found = co.trace(PITCHFORK, [0.0], {"p": -before, "e": 0.0}, "p", (-1.0, 0.5), direction="forward")
    assert kinds(found) == ["BP"] * seen


def test_a_neutral_saddle_is_no_neimark_sacker_point():
    found = co.trace(DIAGONAL, [0.0, 0.0], {"p": 0.2}, "p", (-0.9, 0.9), args=2.0)
    assert kinds(found) == []


def test_a_point_that_is_an_event():
    steps = {"first_step": 0.25, "largest_step": 0.25}
    found = co.trace(DIAGONAL, np.zeros(2), {"p": 0.0}, "p", (-1.6, 0.5), args=0.5, direction="backward", **steps)
    assert -1 in found.p["p"]
    assert kinds(found) == ["PD"]


def linear_pair(u, p, args):
    """Multipliers at 0 with product s and sum t."""
    x, y = u
    return jnp.stack([y, -p["s"] * x + p["t"] * y + x * x])


def cubic(u, p, args):
    """Period doublings at m = 0, whose coefficient is a^2 - 0.49."""
    return -(1.0 + p["m"]) * u + p["a"] * u**2 - 0.49 * u**3


# name: (map, u and parameters at the start, bounds of the first, kind of point, bounds along its curve, points there)
CURVES = {
    "delayed logistic map": (
        DELAYED,
        ([1 / 3, 1 / 3], {"r": 1.5, "e": 0.0}, (1.2, 2.5), "NS"),
        {"r": (0.1, 9.0), "e": (-2.0, 2.0)},
        [("R1", [1 / 3, 1 / 3, 3, -1 / 3]), ("R4", [1, 1, 1, 1])],
    ),
    "linear pair": (
        co.fixed_points(linear_pair),
        ([0.0, 0.0], {"s": 0.8, "t": 0.5}, (0.7, 1.2), "NS"),
        {"s": (0.5, 1.5), "t": (-2.5, 1.5)},
        [("R2", [0, 0, 1, -2]), ("R3", [0, 0, 1, -1]), ("R4", [0, 0, 1, 0])],
    ),
    "cubic map": (
        co.fixed_points(cubic),
        ([0.0], {"m": -0.1, "a": 0.2}, (-0.2, 0.3), "PD"),
        {"m": (-0.5, 0.5), "a": (-1.0, 1.0)},
        [("GPD", [0, 0, -0.7]), ("GPD", [0, 0, 0.7])],
    ),
}


@pytest.mark.parametrize("name", CURVES)
def test_points_of_codimension_two(name):
    system, (u, at, interval, kind), bounds, expected = CURVES[name]
    found = co.trace(system, u, at, next(iter(at)), interval)
    assert kinds(found) == [kind]
    curve = co.curve(found.points(kind)[0], tuple(at), bounds)
    located = sorted((one.kind, one.z.tolist()) for one in curve.special if one.kind != "EP")
    assert [kind for kind, _ in located] == [kind for kind, _ in expected]
    assert close([z for _, z in located], [z for _, z in expected], 1e-11)


def test_bogdanov_takens_and_double_hopf_points_of_lorenz_84():
    found = co.trace(co.equilibria(lorenz84), [1.0, 0.0, 0.0, 0.0], {"F": 1.0, "T": 0.04}, "F", (0.5, 4.0))
    curve = co.curve(found.points("HB")[0], ("F", "T"), {"F": (0.0, 4.0), "T": (-0.5, 0.5)}, largest_step=0.05)
    (double,), (both,) = curve.points("BT"), curve.points("HH")
    assert close([double.p["F"], abs(double.p["T"])], [1.44671670111536, 0.0209401696833226], 1e-10)
    assert close([both.p["F"], abs(both.p["T"])], [2.53322110695982, 0.0262739429830842], 1e-12)
    assert "stopped at BT" in curve.reasons[0] + curve.reasons[1]
    assert len(curve.points("GH")) == 1


def test_henon_to_period_sixteen():
    where, steps = {"a": -0.1, "b": 0.3}, {"direction": "forward", "largest_step": 0.05}
    found = co.trace(HENON, np.zeros(2), where, "a", (-0.2, 1.06), stop=["PD"], **steps)
    for value in (0.3675, 0.9125, 1.02585540507378, 1.05112566203517):
        (doubling,) = found.points("PD")
        assert close(doubling.p["a"], value, 1e-13)
        (found,) = co.switch(doubling, stop=["PD"])


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


def test_nothing_is_followed_within_jit():
    with pytest.raises(co.ContinuationError, match="u: must be concrete numbers"):
        jax.jit(lambda at: co.trace(PARABOLA, [1.0], {"p": at}, "p", (-5.0, 3.0)).u)(1.0)


def test_a_table_has_a_norm_and_no_more_than_some_numbers():
    def many(u, p, args):
        return jnp.concatenate([p["p"] - u[:1] ** 2, u[1:] - 2.0])

    branch = co.trace(co.equilibria(many), np.append(1.0, np.full(49, 2.0)), {"p": 1.0}, "p", (-5.0, 3.0))
    lines = branch.table().split("\n")
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


def test_a_branch_of_an_ill_conditioned_system_is_followed_to_its_bounds():
    """u = a^2 with slopes of 1e-6, beside which the roundings of an exact zero move u by 1e-10."""

    def noisy(u, p, args):
        angles = jnp.arange(1.0, 6.0) * u[0]
        zero = jnp.sum(jnp.cos(angles) ** 2 + jnp.sin(angles) ** 2 - 1.0)
        return jnp.stack([1e-6 * (u[0] - p["a"] ** 2) + zero])

    branch = co.trace(co.equilibria(noisy), [0.0], {"a": 0.0}, "a", (-1.0, 2.0))
    assert branch.reasons == ("a reached its bound -1", "a reached its bound 2")
    assert abs(branch.u[:, 0] - branch.p["a"] ** 2).max() < 1e-9


@pytest.mark.parametrize(("knots", "fold"), [(9, 3.49549329428091), (99, 3.51364790397)])
def test_bratu(knots, fold):
    """The references are those of Newton's method in 30 digits, and of the literature."""
    found = co.trace(co.equilibria(bratu), np.zeros(knots), {"p": 0.0}, "p", (-0.1, 4.0), stop=["SN"], largest_step=2.0)
    assert close(found.points("SN")[0].p["p"], fold, 1e-10)


def rings(u, time, p, args):
    """Circles whose radii x + 2 move as x' = q - x^2, q = 1 / 4 - m^2, the angle by 1 + m / 5 + 3 x / 10."""
    x, angle = jnp.hypot(u[0], u[1]) - 2.0, jnp.arctan2(u[1], u[0])
    q = 0.25 - p["m"] ** 2
    even, odd = (np.array([1.0 / factorial(2 * k + one) for k in range(12, -1, -1)]) for one in (0, 1))
    c, s = jnp.polyval(even, q * time**2), jnp.polyval(odd, q * time**2)  # cosh(root of q, times time), sinh over that
    grown = c + x * s * time
    size, after = (x * c + q * s * time) / grown + 2.0, angle + (1.0 + p["m"] / 5.0) * time + 0.3 * jnp.log(grown)
    return size * jnp.stack([jnp.cos(after), jnp.sin(after)])


def test_an_isola_of_orbits_closes_whatever_its_phase():
    start = np.array([2.5, 0.0, -2.5, 0.0, 2.0 * np.pi / 1.15])
    branch = co.trace(flown(rings, 2), start, {"m": 0.0}, "m", (-2.0, 2.0))
    sizes, m = np.hypot(*branch.u.T[:2]), branch.p["m"]
    assert close((sizes - 2.0) ** 2 + m**2, 0.25, 1e-10)
    assert close(branch.u[:, -1], 2.0 * np.pi / (1.0 + m / 5.0 + 0.3 * (sizes - 2.0)), 1e-10)
    assert "closes" in branch.reason["last"]
    assert sorted(round(one.p["m"], 10) for one in branch.points("SN")) == [-0.5, 0.5]
    assert abs(sizes[-1] - sizes[0]) < 1e-9 and abs(branch.u[-1] - branch.u[0]).max() > 1e-5  # at another phase


def predators(u, p, args):
    """Rosenzweig and MacArthur's predator and prey."""
    x, y = u
    eaten = x * y / (0.3 + x)
    return jnp.stack([x * (1.0 - x / p["k"]) - eaten, eaten - 0.4 * y])


FIELDS = {
    "brusselator": (brusselator, [1.0, 1.0], {"a": 1.0, "b": 1.0}, "b", (0.5, 3.0)),
    "predators": (predators, [0.2, 0.3], {"k": 0.5}, "k", (0.45, 1.2)),
}


@cache
def hopf_point(name):
    field, start, at, along, bounds = FIELDS[name]
    (found,) = co.trace(co.equilibria(field), start, at, along, bounds).points("HB")
    return found


def flown_by_scipy(field, u, period, p):
    """Return the state after a period, and exp of the integral of the divergence: the multiplier of a closed orbit."""
    divergence = jax.jit(lambda u: (field(u, p, None), jnp.trace(jax.jacfwd(field)(u, p, None))))

    def rate(t, state):
        return np.append(*divergence(state[:2]))

    end = solve_ivp(rate, (0.0, period), np.append(u, 0.0), method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    return end[:2], np.exp(end[2])


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [("brusselator", None), ("brusselator", 1e-7), ("predators", 1e-7), ("predators", 1e-9)],
)
def test_orbits_from_a_hopf_point(name, tolerance):
    """They leave it whatever the integrator's tolerance, and close by SciPy's integrator."""
    point, (field, _, at, along, bounds) = hopf_point(name), FIELDS[name]
    given, error = ({}, 1e-10) if tolerance is None else ({"tolerance": tolerance}, 100.0 * tolerance)
    (cycles,) = co.switch(point, orbits=periodic_orbits(field, segments=4, **given), largest_step=0.2)
    assert kinds(cycles) == [] and abs(cycles.p[along][0] - point.p[along]) < 1e-3
    assert cycles.p[along][-1] == pytest.approx(bounds[1], abs=1e-6) and "bound" in cycles.reasons[1]
    for k in (len(cycles) // 2, len(cycles) - 1):
        end, multiplier = flown_by_scipy(field, cycles.u[k, :2], cycles.u[k, -1], at | {along: cycles.p[along][k]})
        assert close(end, cycles.u[k, :2], error) and close(cycles.eigenvalues[k], multiplier, error)


def test_orbits_from_a_long_run_back_to_the_hopf_point():
    at, orbits = {"a": 1.0, "b": 2.3}, periodic_orbits(brusselator, segments=4)
    start = settled(orbits, [1.0, 1.0], 6.4, at, rounds=20)
    back = co.trace(orbits, start, at, "b", (1.5, 2.5), largest_step=0.5, direction="backward")
    assert kinds(back) == ["HB"] and back.reasons[0] == "it ends in the Hopf point at 2"
    assert close(back.points("HB")[0].z, [*[1, 2] * 4, 2 * np.pi, 2], 1e-12)


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
        ({"at": {"p": {"q": 1.0}}}, "at.p"),
        ({"u": [[1.0]]}, "u"),
        ({"system": co.equilibria(lambda u, p, args: [u[0] - p["p"]])}, "function"),
        ({"system": co.equilibria(lambda u, p, args: u[0] - p["p"])}, "function"),
        ({"system": co.equilibria(lambda u, p, args: np.sin(u) - p["p"])}, "function"),
        ({"system": co.equilibria(lambda t, u, p: u - p["p"])}, "function"),
        ({"hold": {abs: 1.0}}, "along"),
        ({"along": ("p", "e"), "hold": {"size": 1.0}}, "hold"),
        ({"along": ("p", "e"), "hold": {abs: "1"}}, f"hold.{abs}"),
        ({"along": ("p", "e"), "hold": {abs: 1.0}, "bounds": {}}, "bounds"),
    ],
)
def test_invalid_arguments_of_trace(change, key):
    given = {"system": PARABOLA, "u": [1.0], "at": {"p": 1.0, "e": 0.0}, "along": "p", "bounds": (-5.0, 3.0)} | change
    with pytest.raises(co.ContinuationError) as told:
        co.trace(**given)
    assert told.value.key == key and "\n" not in str(told.value)


def crossing():
    system = co.equilibria(lambda u, p, args: (p["a"] - 0.5) * u - u**3)
    return co.trace(system, [0.0], {"a": 0.0}, "a", bounds=(-1.0, 1.0)).points("BP")[0]


@pytest.mark.parametrize(
    ("call", "key"),
    [
        (lambda: periodic_orbits(brusselator, segments=0), "segments"),
        (lambda: co.fixed_points(lambda u, p, args: u, times=0), "times"),
        (lambda: co.switch(crossing(), bounds={"b": (-1.0, 1.0)}), "bounds"),
        (lambda: co.switch(crossing(), bounds={"a": (0.6, 1.0)}), "bounds"),
        (lambda: periodic_orbits(brusselator, tolerance=2.0), "tolerance"),
        (lambda: settled(co.equilibria(brusselator), [1.0, 1.0], 6.0, {}), "system"),
        (lambda: settled(periodic_orbits(brusselator), [1.0, 1.0, 1.0], 6.0, {"a": 1.0, "b": 3.0}), "start"),
        (lambda: co.trace(flown(spiral, 2), np.ones(8), {"m": 0.0, "n": 0.3}, "m", (-1.0, 1.0)), "u"),
        (
            lambda: co.switch(
                hopf_point("predators"), orbits=periodic_orbits(predators, tolerance=1e-9), tolerance=1e-10
            ),
            "tolerance",
        ),
    ],
)
def test_invalid_arguments_of_switch_and_of_systems(call, key):
    with pytest.raises(co.ContinuationError) as told:
        call()
    assert told.value.key == key
