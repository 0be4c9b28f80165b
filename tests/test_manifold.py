"""Manifolds: eigenvectors at the saddle, images that stay on the curve, boundaries of basins found without it."""

from functools import cache

import jax
import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro import plot
from jaxvibro.attractors.local_manifold import compute_local_manifold, iterate_map
from jaxvibro.attractors.manifold import _assemble_side
from jaxvibro.attractors.manifold_growth import ManifoldLevel, ManifoldPointRules
from jaxvibro.compiled.lane_arithmetic import COMPILER_OPTIONS
from jaxvibro.maps.strobe_inverse import strobe_backward

from .basins_proof import SCENE, bisected, distance
from .test_basins import SCENES

BACK = jax.jit(lambda scene, state: strobe_backward(scene, state, 16), compiler_options=COMPILER_OPTIONS)


@cache
def saddle(label="P111", amplitude=4.65, sign=1.0):
    """The orbit with this label whose larger multiplier is beyond 1, or below -1."""
    scene = jv.make_scene(**SCENE | {"amplitude": amplitude})
    found = jv.find_orbits(scene, 1, 64)
    return next(one for one in found if one.label == label and sign * one.multipliers[0].real > 1)


@cache
def curve(kind, label="P111", length=6.0, angle=0.02):
    return jv.manifold(saddle(label=label), kind, length, 0.0, 0.01, angle)


def points(data):
    return np.stack([data["x"].values, data["v"].values], -1)


OTHERS = [pytest.param(name, marks=pytest.mark.long) for name in SCENES if name != "figure 5"]


@pytest.mark.parametrize("name", ["figure 5", *OTHERS])
@pytest.mark.parametrize("phase", [0.0, pytest.param(1.3, marks=pytest.mark.long)])
def test_the_way_back_is_the_inverse(name, phase):
    scene, rng = jv.make_scene(**SCENES[name]), np.random.default_rng(0)
    given = np.stack([rng.uniform(-0.95, 0.75, 500), rng.uniform(-3.0, 3.0, 500)])
    before, impacts = jax.device_get(BACK(scene, jv.State(*given, np.full(500, phase), np.zeros(500))))
    good = (np.asarray(impacts.status) < 2) & (abs(before.v) < 1e3)  # the rest got faster at every impact, without end
    assert good.sum() > 150
    start = jv.State(*(each[good] for each in (before.x, before.v, before.phase)))
    assert (start.phase == phase).all()
    end, _ = jv.strobe(scene, start, 1, 0)
    error = abs(np.stack([end.x, end.v]) - given[:, good]).max(axis=0)
    stretch = abs(np.asarray(jv.monodromy(scene, start, 1, 1024))).max(axis=(1, 2))
    assert (error <= 1e-12 * np.maximum(1.0, stretch * np.maximum(1.0, abs(start.v)))).all()


@pytest.mark.parametrize("kind", ["stable", "unstable"])
def test_a_manifold_begins_along_the_eigenvector(kind):
    orbit, data = saddle(), curve(kind)
    values, vectors = np.linalg.eig(np.asarray(jv.monodromy(orbit.scene, jv.State(orbit.state.x, orbit.state.v))))
    place = np.argmin(abs(values)) if kind == "stable" else np.argmax(abs(values))
    assert data.attrs["multiplier"] == pytest.approx(values[place], rel=1e-9)
    z = points(data) - [orbit.state.x, orbit.state.v]
    for side in (-1, 1):
        here = (data["side"].values == side) & (data["arc"].values > 0) & (data["arc"].values < 1e-4)
        across = z[here] @ np.array([-vectors[1, place], vectors[0, place]])
        assert here.sum() > 5
        assert abs(across).max() < 1e-7
    ways = [z[data["side"].values == side][3] @ vectors[:, place] for side in (-1, 1)]
    assert ways[0] * ways[1] < 0


@pytest.mark.parametrize(
    "back", [pytest.param(False, marks=pytest.mark.long), pytest.param(True, marks=pytest.mark.slow)]
)
def test_a_germ_is_led_into_itself(back):
    orbit = saddle()
    state = orbit.state
    values, vectors = np.linalg.eig(np.asarray(jv.monodromy(orbit.scene, jv.State(state.x, state.v))))
    place = np.argmin(abs(values)) if back else np.argmax(abs(values))
    rate = 1.0 / values[place] if back else values[place]
    found = compute_local_manifold(
        orbit.scene, np.array([state.x, state.v], float), vectors[:, place], rate, 1, 0.0, back, 1.0
    )
    along = found.radius * np.linspace(-1.0, 1.0, 101)
    z, _, good = iterate_map(orbit.scene, found.points_at(found.preimage_coordinate(along)), 0.0, 1, back)
    assert good.all() and found.radius > 0.05
    assert abs(z - found.points_at(along)).max() < 1e-12
    assert found.preimage_coordinate(1e-4) == pytest.approx(1e-4 / rate, rel=1e-3)


def stays(data, scene, given, back):
    """Assert that the map, or its inverse where `back`, leads points of a manifold into it."""
    z, _, good = iterate_map(scene, given, data.attrs["phase"], 1, back)
    matrix = np.asarray(jv.monodromy(scene, jv.State(*(z if back else given).T, data.attrs["phase"])))
    with np.errstate(divide="ignore", over="ignore"):
        stretch = abs(matrix).max(axis=(1, 2)) / (abs(np.linalg.det(matrix)) if back else 1.0)
    apart, error = distance(data, z), 1e-8 + 1e-14 * stretch
    assert good.all() and np.quantile(error, 0.9) < 1e-7
    # beside a corner the map loses half of the digits, on one side of it without a stretch that tells
    assert np.quantile(apart - error, 0.99) <= 0.0 and apart.max() < 1e-4


@pytest.mark.parametrize(
    ("kind", "label"),
    [
        pytest.param("stable", "P112", marks=pytest.mark.slow),
        *(pytest.param(kind, "P111", marks=pytest.mark.long) for kind in ("stable", "unstable")),
    ],
)
def test_what_is_on_a_manifold_stays_on_it(kind, label):
    data = curve(kind, label)
    some = np.flatnonzero((data["image"].values > 0) & (abs(data["v"].values) < 4.0))[::7]
    assert len(some) > 40
    stays(data, saddle(label=label).scene, points(data)[some], kind == "unstable")


def test_basins_meet_at_a_stable_manifold():
    scene = jv.make_scene(**SCENE)
    attractors = jv.find_attractors(scene)
    data = curve("stable")
    for first, second in (
        ((-0.9, 1.0), (-0.9, 2.0)),
        ((0.0, 0.5), (0.0, 1.0)),
        ((0.5, 1.0), (0.5, 2.0)),
        ((0.9, 2.5), (0.9, 3.5)),
        ((0.3, -1.8), (0.3, -2.4)),
    ):
        point = bisected(scene, attractors, first, second)
        assert distance(data, point[None])[0] < 1e-8


def test_pieces_keep_the_rules_and_say_why_they_end():
    data = curve("stable", "P111", 12.0)
    z, piece = points(data), data["piece"].values
    began, ended = data["began"].values, data["ended"].values
    inside = np.diff(piece) == 0
    assert np.hypot(*np.diff(z, axis=0).T)[inside & (abs(z[1:, 1]) < 6.0)].max() <= 0.01
    assert set(began) | set(ended) <= {"saddle", "section", "grazing", "fast", "resolution", "length"}
    assert list(began).count("saddle") == 2 and "grazing" in ended
    first = np.searchsorted(piece, np.arange(len(began)))
    for k in np.flatnonzero(ended[:-1] == "section"):
        (x, v), (after, w) = z[first[k + 1] - 1], z[first[k + 1]]
        assert abs(x) == pytest.approx(1.0, abs=1e-6) and after == pytest.approx(x, abs=1e-6)
        fast, slow = sorted((v, w), key=abs, reverse=True)
        assert slow == pytest.approx(-0.7 * fast, abs=1e-5)
    for k in np.flatnonzero(ended[:-1] == "grazing"):
        assert (z[first[k + 1]] == z[first[k + 1] - 1]).all()
    arcs = [data["arc"].values[data["side"].values == side].max() for side in (-1, 1)]
    assert max(arcs) == pytest.approx(12.0, abs=0.2)


@pytest.mark.parametrize(("position", "counts"), [(0.0, (0, 1, 0, 1)), (0.7, (1, 0, 1, 0, 1, 0)), (-1.5, (0, 1))])
def test_one_impact_at_the_phase_breaks_a_curve_once(position, counts):
    """At an impact at the phase of the section, rounding may make neighbours' numbers of impacts alternate."""
    scene = jv.make_scene(**SCENE | {"walls": (position - 2.0, position)})
    counts = np.array([*[counts[0]] * 4, *counts, *[counts[-1]] * 4])
    x = position - np.abs(np.r_[np.linspace(0.04, 0.01, 4), np.zeros(len(counts) - 8), np.linspace(0.01, 0.04, 4)])
    z = np.stack([x, np.where(counts == 0, 1.0, -0.7) + x - position], -1)
    level = ManifoldLevel(np.linspace(0.0, 1.0, len(x)), z, counts, np.full(len(x), True))
    rules = ManifoldPointRules(0.02, 0.1, 1e-5, 3.0, 6.0, 1.0, 1000)
    branch = _assemble_side(scene, 0.0, z[0], [level], "length", 1.0, rules)
    assert list(branch["began"]) == ["saddle", "section"] and list(branch["ended"]) == ["section", "length"]
    assert branch["z"][branch["piece"] == 0][-1] == pytest.approx([position, z[0, 1] + 0.04], abs=1e-12)
    assert branch["z"][branch["piece"] == 1][0] == pytest.approx([position, z[-1, 1] + 0.04], abs=1e-12)


def test_an_unstable_manifold_ends_on_attractors():
    data = curve("unstable")
    last = points(data)[np.append(np.flatnonzero(np.diff(data["side"].values)), -1)]
    assert list(data["ended"].values[data["ended"].values != "section"]) == ["attractor", "attractor"]
    attractors = [one.points[0] for one in jv.find_attractors(jv.make_scene(**SCENE), 64)]
    assert max(min(abs(z - point).max() for point in attractors) for z in last) < 1e-4


def test_a_saddle_that_flips_has_two_sides_too():
    orbit = saddle("P112", 4.85, -1.0)
    data = jv.manifold(orbit, "unstable", 0.3, 0.0, 0.002, 0.005)
    some = np.flatnonzero(data["image"].values > 0)[::11]
    z, _, _ = iterate_map(orbit.scene, points(data)[some], 0.0, 1, True)
    assert distance(data, z).max() < 1e-8
    other = data.isel(point=data["side"].values != data["side"].values[some[0]])
    assert distance(other, z[:1])[0] < 1e-8


@pytest.mark.parametrize("name", OTHERS)
def test_other_scenes_have_manifolds(name):
    orbits = jv.find_orbits(jv.make_scene(**SCENES[name]), 2)
    saddles = [one for one in orbits if abs(one.multipliers[0]) > 1 > abs(one.multipliers[1]) > 0]
    for orbit in saddles[:1]:
        for kind in ("stable", "unstable"):
            data = jv.manifold(orbit, kind, 4.0, spacing=0.001, angle=0.003)
            assert set(data["origin"].values) == set(range(orbit.periods))
            # the image of one point's arc may be longer than that arc, on the next one's curve: so half of it is asked
            half = (data["image"].values > 0) & (data["arc"].values < 2.0) & (abs(data["v"].values) < 4.0)
            given = points(data)[np.flatnonzero(half)[::10]]
            assert len(given) > 100
            stays(data, orbit.scene, given, kind == "unstable")


@pytest.mark.parametrize(
    ("key", "given"),
    [
        ("kind", {"kind": "centre"}),
        ("orbit", {"orbit": None}),
        ("length", {"length": 0.0}),
        ("spacing", {"spacing": np.nan}),
        ("most", {"most": 1}),
    ],
)
def test_what_cannot_be_is_refused(key, given):
    with pytest.raises(jv.ArgumentError) as caught:
        jv.manifold(**{"orbit": saddle(), "kind": "stable"} | given)
    assert caught.value.key == key


def test_no_saddle_and_no_way_back_are_refused():
    stable = jv.find_orbit(saddle().scene, jv.State(0.6, -1.3))
    with pytest.raises(jv.ArgumentError, match="saddle"):
        jv.manifold(stable, "unstable")
    for changes, key in (({"left.restitution": 0.0}, "left.restitution"), ({"damping": 1.0}, "damping")):
        other = saddle().scene.replace(**changes)
        orbit = type(stable)(**(vars(saddle()) | {"scene": other}))
        with pytest.raises(jv.ArgumentError) as caught:
            jv.manifold(orbit, "stable")
        assert caught.value.key == key


def test_a_picture_of_a_manifold_breaks_where_the_curve_does():
    data = curve("stable", "P111", 12.0)
    ax = Figure().subplots()
    assert plot.manifold(data, ax) is ax
    (line,) = [one for one in ax.lines if one.get_gid() == "manifold"]
    assert np.isnan(line.get_xdata()).sum() == data.sizes["piece_end"] - 1
    assert line.get_label() == "stable manifold of P111"
    (cross,) = [one for one in ax.lines if one.get_gid() == "saddle"]
    assert cross.get_xdata() == pytest.approx(saddle().state.x)
    assert "X" in ax.get_xlabel() and "omega_0" in ax.get_ylabel()
