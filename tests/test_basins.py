"""Basins and manifolds: trapping regions, mirrored pictures, boundaries, entropy and dimension of known pictures."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro.attractors.basin_boundaries import basin_entropies, boundary_dimension
from jaxvibro.attractors.basin_labels import find_trapping_ellipses
from jaxvibro.attractors.manifold import _assemble_side
from jaxvibro.attractors.manifold_growth import ManifoldLevel, ManifoldPointRules
from jaxvibro.plot.basins import PALE_COLOURS

from .plane_curves import bisected, distance, points_of
from .properties.test_attractors import check_labels, plane

FIG5 = {"amplitude": 4.65, "frequency": 2.1, "damping": 0.05, "restitution": 0.7, "walls": (-1.0, 1.0)}


@cache
def known(amplitude=4.65):
    scene = jv.make_scene(**FIG5 | {"amplitude": amplitude})
    return scene, jv.find_attractors(scene, starts=200)


def test_a_mirrored_grid_half_a_period_later_has_the_twins_swapped():
    scene, attractors = known()
    x, v, counts = np.linspace(-1.0, 1.0, 41), np.linspace(-3.0, 3.0, 41), []
    before = jv.basins(scene, x, v, 0.0, attractors, progress=counts.append)
    assert counts == sorted(counts) and counts[-1] == 41 * 41
    after, twins = jv.basins(scene, x, v, np.pi, attractors), before["mirror_of"].values
    assert sorted(twins) == [0, 1, 2, 3] and (twins != np.arange(4)).all()
    np.testing.assert_array_equal(after["label"].values[::-1, ::-1], twins[before["label"].values])
    np.testing.assert_allclose(after["point_x"].values[twins], -before["point_x"].values, atol=1e-12)


def test_starts_on_a_chaotic_attractor_have_its_label():
    scene, attractors = known(5.24)
    data = jv.basins(scene, np.linspace(-1.0, 1.0, 8), np.linspace(-3.0, 3.0, 6), 1.0, attractors, 600)
    assert set(data["kind"].values) == {"periodic", "chaotic"}
    assert (data["label"] >= 0).mean() > 0.9  # a twin with few starts may not be among the attractors
    assert check_labels(scene, data, 1.0).max() < 0.2


def test_starts_without_a_trapping_region_are_not_certain():
    scene, attractors = known()
    data = jv.basins(scene, np.linspace(-1.0, 1.0, 9), np.linspace(-3.0, 3.0, 9), 0.0, attractors[:1], patience=40)
    label = data["label"].values
    assert set(np.unique(label)) == {-1, 0}
    assert data["fraction_error"].values[0] >= (label == -1).mean()
    elastic = jv.make_scene(4.65, 2.1, 0.0, 1.0, (-1.0, 1.0))
    orbit = jv.find_orbits(elastic, 1, 16)[0]
    point = np.array([[orbit.state.x, orbit.state.v]])
    assert find_trapping_ellipses(elastic, point, orbit.state.phase, 3.0) is None


def test_no_state_leaves_a_trapping_region():
    scene, attractors = known()
    rng = np.random.default_rng(0)
    for one in attractors:
        region = find_trapping_ellipses(scene, one.points, 0.0, 6.0)
        disc = rng.normal(size=(500, 2))
        disc *= (rng.random(500) ** 0.5 / np.hypot(*disc.T))[:, None]
        z = one.points[0] + np.linalg.solve(region.ellipse_matrices[0], disc.T).T
        z = z[abs(z[:, 0]) <= 1.0]
        assert region.contains(z).all()
        end, _ = jv.strobe(scene, jv.State(*z.T), one.periods, 0)
        after = (plane(end) - one.points[0]) @ region.ellipse_matrices[0].T
        assert np.hypot(*after.T).max() < 1.0


def test_single_precision_has_basins():
    axes, points = (np.linspace(-0.9, 0.9, 9), np.linspace(-3.0, 3.0, 9)), []
    single = jv.make_scene(**FIG5, dtype=jnp.float32)
    for data in (jv.basins(single, *axes), jv.basins(known()[0], *axes, 0.0, known()[1])):
        where = data["label"].values
        assert (where >= 0).all()
        points.append(np.stack([data[name].values[:, 0][where] for name in ("point_x", "point_v")], -1))
    assert (abs(points[0] - points[1]).max(axis=-1) < 1e-3).mean() > 0.97


def test_entropy_of_known_pictures():
    halves = np.repeat([[0, 1]], 50, axis=1).T @ np.ones((1, 100), int)
    board = np.indices((100, 100)).sum(axis=0) % 2
    assert basin_entropies(board, 2) == pytest.approx((np.log(2), np.log(2)))
    assert basin_entropies(halves, 5) == (0.0, 0.0)  # the boundary lies between boxes
    part = -(0.4 * np.log(0.4) + 0.6 * np.log(0.6))
    assert basin_entropies(np.roll(halves, 2, axis=0), 5) == pytest.approx((part * 2 / 20, part))
    assert basin_entropies(np.arange(90 * 90).reshape(90, 90) % 3, 3) == pytest.approx((np.log(3), np.log(3)))
    assert basin_entropies(np.where(board == 1, -1, 0), 2) == (0.0, 0.0)
    for few in (board[:3, :3], board[:3], board[:, :3]):  # no whole box
        assert np.isnan(basin_entropies(few)).all()


def test_dimension_of_known_pictures():
    rows, columns = np.indices((1025, 1025))
    halves = (columns > 400).astype(int)
    straight = boundary_dimension(halves)
    assert (straight.value, straight.error) == pytest.approx((1.0, 0.0), abs=1e-12)
    np.testing.assert_allclose(straight.mixed_fractions, straight.box_sides / 1024)
    assert boundary_dimension((columns > 0.37 * rows + 100.3).astype(int)).value == pytest.approx(1.0, abs=0.01)
    circle = boundary_dimension(((rows - 500) ** 2 + (columns - 510) ** 2 < 300**2).astype(int))
    assert circle.value == pytest.approx(1.0, abs=max(0.02, 2 * circle.error))
    assert boundary_dimension(np.random.default_rng(0).integers(0, 2, (1025, 1025))).value > 1.9
    assert np.isnan(boundary_dimension(np.zeros((65, 65), int))[:2]).all()
    assert boundary_dimension(np.where(columns == 400, -1, halves)).value == pytest.approx(1.0, abs=0.1)


def test_dimension_of_a_cantor_set_of_boundaries():
    levels, parity = 8, np.zeros(3**8, int)
    for level in range(levels):
        third = np.arange(3**levels) // 3 ** (levels - 1 - level) % 3
        new = (third == 1) & (parity == 0)
        parity[new] = 1 + level % 2
    cantor = boundary_dimension(np.tile(np.where(parity == 0, 3, parity), (2049, 1)))
    true = 1.0 + np.log(2) / np.log(3)
    assert cantor.value == pytest.approx(true, abs=0.06) and abs(cantor.value - true) < 3 * cantor.error


def test_a_picture_of_basins_distinguishes_all_attractors():
    scene, attractors = known()
    data = jv.basins(scene, np.linspace(-1.2, 1.0, 23), np.linspace(-3.0, 3.0, 21), 0.0, attractors)
    ax = Figure().subplots()
    assert jv.plot.basins(data, ax) is ax
    assert [cells.get_rasterized() for cells in ax.images] == [True]  # in files of vectors too
    marks = [line for line in ax.lines if line.get_gid() == "attractor"]
    assert [line.get_marker() for line in marks] == ["<", ">", "^", "v"]
    assert len({line.get_color() for line in marks}) == 4
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts[-1] == "beyond a wall" and texts[0].startswith("P111: ")
    assert "X" in ax.get_xlabel() and "omega_0" in ax.get_ylabel()
    greys = [np.dot(to_rgb(colour), (0.299, 0.587, 0.114)) for colour in PALE_COLOURS]
    assert (np.diff(greys) < -0.05).all()


@cache
def saddle(label="P111", amplitude=4.65, sign=1.0):
    """Return the orbit with this label whose larger multiplier is beyond 1, or below -1."""
    orbits = jv.find_orbits(jv.make_scene(**FIG5 | {"amplitude": amplitude}), 1, 64)
    return next(one for one in orbits if one.label == label and sign * one.multipliers[0].real > 1)


@cache
def curve(kind, length=6.0):
    return jv.manifold(saddle(), kind, length, 0.0, 0.01, 0.02)


@pytest.mark.parametrize("kind", ["stable", "unstable"])
def test_a_manifold_begins_along_the_eigenvector(kind):
    orbit, data = saddle(), curve(kind)
    values, vectors = np.linalg.eig(np.asarray(jv.monodromy(orbit.scene, jv.State(orbit.state.x, orbit.state.v))))
    index = np.argmin(abs(values)) if kind == "stable" else np.argmax(abs(values))
    assert data.attrs["multiplier"] == pytest.approx(values[index], rel=1e-9)
    z, side = points_of(data) - plane(orbit.state), data["side"].values
    near = (data["arc"].values > 0) & (data["arc"].values < 1e-4)
    assert min((near & (side == sign)).sum() for sign in (-1, 1)) > 5
    assert abs(z[near] @ np.array([-vectors[1, index], vectors[0, index]])).max() < 1e-7
    assert np.prod([z[side == sign][3] @ vectors[:, index] for sign in (-1, 1)]) < 0


def test_basins_meet_at_a_stable_manifold():
    for first, second in (((-0.9, 1.0), (-0.9, 2.0)), ((0.5, 1.0), (0.5, 2.0)), ((0.3, -1.8), (0.3, -2.4))):
        assert distance(curve("stable"), bisected(*known(), first, second)[None])[0] < 1e-8


def test_pieces_follow_the_rules_and_give_the_reasons_for_their_ends():
    data = curve("stable", 12.0)
    z, piece = points_of(data), data["piece"].values
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
    ax = Figure().subplots()
    assert jv.plot.manifold(data, ax) is ax
    (line,) = [line for line in ax.lines if line.get_gid() == "manifold"]
    assert np.isnan(line.get_xdata()).sum() == data.sizes["piece_end"] - 1
    assert line.get_label() == "stable manifold of P111"
    (cross,) = [line for line in ax.lines if line.get_gid() == "saddle"]
    assert cross.get_xdata() == pytest.approx(saddle().state.x)
    assert "X" in ax.get_xlabel() and "omega_0" in ax.get_ylabel()


@pytest.mark.parametrize(("position", "counts"), [(0.0, (0, 1, 0, 1)), (0.7, (1, 0, 1, 0, 1, 0)), (-1.5, (0, 1))])
def test_one_impact_at_the_phase_breaks_a_curve_once(position, counts):
    """At an impact at the phase of the section, rounding may make the numbers of impacts of neighbours alternate."""
    scene = jv.make_scene(**FIG5 | {"walls": (position - 2.0, position)})
    counts = np.array([*[counts[0]] * 4, *counts, *[counts[-1]] * 4])
    x = position - np.abs(np.r_[np.linspace(0.04, 0.01, 4), np.zeros(len(counts) - 8), np.linspace(0.01, 0.04, 4)])
    z = np.stack([x, np.where(counts == 0, 1.0, -0.7) + x - position], -1)
    level = ManifoldLevel(np.linspace(0.0, 1.0, len(x)), z, counts, np.full(len(x), True))
    rules = ManifoldPointRules(0.02, 0.1, 1e-5, 3.0, 6.0, 1.0, 1000, 1.0)
    branch = _assemble_side(scene, 0.0, z[0], [level], "length", rules)
    assert list(branch["began"]) == ["saddle", "section"] and list(branch["ended"]) == ["section", "length"]
    assert branch["z"][branch["piece"] == 0][-1] == pytest.approx([position, z[0, 1] + 0.04], abs=1e-12)
    assert branch["z"][branch["piece"] == 1][0] == pytest.approx([position, z[-1, 1] + 0.04], abs=1e-12)


def test_an_unstable_manifold_ends_on_attractors():
    data = curve("unstable")
    last = points_of(data)[np.append(np.flatnonzero(np.diff(data["side"].values)), -1)]
    assert list(data["ended"].values[data["ended"].values != "section"]) == ["attractor", "attractor"]
    assert max(min(abs(z - one.points[0]).max() for one in known()[1]) for z in last) < 1e-4


def test_a_saddle_that_flips_has_two_sides_too():
    orbit = saddle("P112", 4.85, -1.0)
    data = jv.manifold(orbit, "unstable", 0.3, 0.0, 0.002, 0.005)
    for sign in (-1, 1):
        side, other = (data.isel(point=data["side"].values == each) for each in (sign, -sign))
        start = points_of(side)[:: max(1, side.sizes["point"] // 16)][:8]
        end, _ = jv.strobe(orbit.scene, jv.State(*start.T), 1, 0)
        assert distance(other, plane(end)).max() < 1e-8


def test_no_saddle_and_irreversible_motions_are_refused():
    stable = jv.find_orbit(saddle().scene, jv.State(0.6, -1.3))
    with pytest.raises(jv.ArgumentError, match="saddle"):
        jv.manifold(stable, "unstable")
    for changes, key in (({"left.restitution": 0.0}, "left.restitution"), ({"damping": 1.0}, "damping")):
        orbit = type(stable)(**(vars(saddle()) | {"scene": saddle().scene.replace(**changes)}))
        with pytest.raises(jv.ArgumentError) as caught:
            jv.manifold(orbit, "stable")
        assert caught.value.key == key
