"""Basins: labels against states run on alone, the mirrored picture, entropy and dimension of known pictures."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro import plot
from jaxvibro.attractors import basin_boundaries, trapping_region
from jaxvibro.flight.wall_positions import wall_states
from jaxvibro.plot.basins import PALE_COLOURS

FIG5 = {"amplitude": 4.65, "frequency": 2.1, "damping": 0.05, "restitution": 0.7, "walls": (-1.0, 1.0)}
SCENES = {
    "figure 5": FIG5,
    "one wall": FIG5 | {"amplitude": 2.0, "walls": (None, 1.0)},
    "uneven walls": FIG5 | {"amplitude": 3.0, "walls": (-1.5, 1.0)},
    "moving wall": FIG5 | {"amplitude": 3.0, "walls": (-1.0, jv.Wall(1.0, motion=jv.Motion(0.2, 0.5, 2)))},
    "a restitution each": FIG5 | {"amplitude": 3.0, "walls": (jv.Wall(-1.0, 0.5), jv.Wall(1.0, 0.9))},
    "a plastic wall": FIG5 | {"amplitude": 1.0, "walls": (jv.Wall(-1.0, 0.0), 1.0)},
}


@cache
def known(name):
    scene = jv.make_scene(**SCENES[name])
    return scene, jv.find_attractors(scene, starts=200)


def nearest(data, z):
    """(place of the attractor with the nearest point, distance to it) of states (lanes, 2)."""
    points = np.stack([data["point_x"].values, data["point_v"].values], -1)
    apart = abs(z[:, None, None] - points).max(axis=-1)
    apart = np.where(np.isnan(apart), np.inf, apart).min(axis=-1)
    return apart.argmin(axis=1), apart.min(axis=1)


QUICK = (("figure 5", 0.0),)
OTHERS = [pytest.param(name, 4.0, marks=pytest.mark.long) for name in ("moving wall", "uneven walls")]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "phase"), [*QUICK, *OTHERS])
def test_labels_are_those_of_states_run_on_alone(name, phase):
    scene, attractors = known(name)
    x, v = np.linspace(-1.4, 1.2, 27), np.linspace(-3.1, 3.0, 17)
    data = jv.basins(scene, x, v, phase, attractors)
    (left, _), (right, _) = wall_states(scene, phase)
    beyond = (x < left) | (x > right)
    label = data["label"].values
    np.testing.assert_array_equal(label == -2, np.broadcast_to(beyond, label.shape))
    across, up = (each[label != -2] for each in np.meshgrid(x, v))
    end, _ = jv.strobe(scene, jv.State(across, up, phase), 3000, 0)
    place, apart = nearest(data, np.stack([end.x, end.v], -1))
    assert apart.max() < 1e-9
    np.testing.assert_array_equal(label[label != -2], place)
    shares = np.bincount(place, minlength=len(attractors)) / place.size
    np.testing.assert_allclose(data["fraction"], shares, atol=1e-15)


def test_the_mirrored_picture_half_a_period_later_has_the_twins_swapped():
    scene, attractors = known("figure 5")
    x, v = np.linspace(-1.0, 1.0, 41), np.linspace(-3.0, 3.0, 41)
    before, after = (jv.basins(scene, x, v, phase, attractors) for phase in (0.0, np.pi))
    twins = before["mirror_of"].values
    assert sorted(twins) == [0, 1, 2, 3] and (twins != np.arange(4)).all()
    np.testing.assert_array_equal(after["label"].values[::-1, ::-1], twins[before["label"].values])
    np.testing.assert_allclose(after["point_x"].values[twins], -before["point_x"].values, atol=1e-12)


def test_a_chaotic_attractor_takes_the_starts_that_stay_on_it():
    scene = jv.make_scene(5.24, 2.1, 0.05, 0.7, (-1.0, 1.0))
    attractors = jv.find_attractors(scene, starts=100)
    data = jv.basins(scene, np.linspace(-1.0, 1.0, 12), np.linspace(-3.0, 3.0, 12), 1.0, attractors, 600)
    assert set(data["kind"].values) == {"periodic", "chaotic"}
    label = data["label"].values
    across, up = (each[label >= 0] for each in np.meshgrid(data["x"], data["v"]))
    assert (label >= 0).mean() > 0.95  # a twin with few starts may not be among the attractors
    end, _ = jv.strobe(scene, jv.State(across, up, 1.0), 3000, 0)
    place, apart = nearest(data, np.stack([end.x, end.v], -1))
    np.testing.assert_array_equal(place, label[label >= 0])
    assert apart[data["kind"].values[place] == "periodic"].max(initial=0.0) < 1e-9
    assert apart.max() < 0.2


def test_what_has_no_trap_is_not_certain():
    scene, attractors = known("figure 5")
    data = jv.basins(scene, np.linspace(-1.0, 1.0, 9), np.linspace(-3.0, 3.0, 9), 0.0, attractors[:1], patience=40)
    label = data["label"].values
    assert set(np.unique(label)) == {-1, 0}
    assert data["fraction_error"].values[0] >= (label == -1).mean()
    elastic = jv.make_scene(4.65, 2.1, 0.0, 1.0, (-1.0, 1.0))
    orbit = jv.find_orbits(elastic, 1, 16)[0]
    point = np.array([[orbit.state.x, orbit.state.v]])
    assert trapping_region.find_trapping_ellipses(elastic, point, orbit.state.phase, 3.0) is None


def test_no_state_of_a_trap_leaves_it():
    scene, attractors = known("figure 5")
    rng = np.random.default_rng(0)
    for one in attractors:
        found = trapping_region.find_trapping_ellipses(scene, one.points, 0.0, 6.0)
        disc = rng.normal(size=(500, 2))
        disc *= (rng.random(500) ** 0.5 / np.hypot(*disc.T))[:, None]
        z = one.points[0] + np.linalg.solve(found.ellipse_matrices[0], disc.T).T
        z = z[abs(z[:, 0]) <= 1.0]
        assert found.contains(z).all()
        end, _ = jv.strobe(scene, jv.State(*z.T), one.periods, 0)
        after = (np.stack([end.x, end.v], -1) - one.points[0]) @ found.ellipse_matrices[0].T
        assert np.hypot(*after.T).max() < 1.0


def test_single_precision_has_basins():
    scene = jv.make_scene(**FIG5, dtype=jnp.float32)
    data = jv.basins(scene, np.linspace(-0.9, 0.9, 9), np.linspace(-3.0, 3.0, 9))
    double = jv.basins(known("figure 5")[0], np.linspace(-0.9, 0.9, 9), np.linspace(-3.0, 3.0, 9))

    def points(data):
        where = data["label"].values
        return np.stack([data[name].values[:, 0][where] for name in ("point_x", "point_v")], -1)

    assert (data["label"].values >= 0).all()
    assert (abs(points(data) - points(double)).max(axis=-1) < 1e-3).mean() > 0.97


@pytest.mark.parametrize(
    ("key", "given"),
    [
        ("x", {"x": [0.0]}),
        ("x", {"x": [1.0, 0.0]}),
        ("v", {"v": [[0.0, 1.0]]}),
        ("v", {"v": [0.0, np.nan]}),
        ("phase", {"phase": [0.0, 1.0]}),
        ("patience", {"patience": 0}),
    ],
)
def test_what_cannot_be_is_refused(key, given):
    scene, attractors = known("figure 5")
    with pytest.raises(jv.ArgumentError) as caught:
        jv.basins(**{"scene": scene, "x": [0.0, 1.0], "v": [0.0, 1.0], "attractors": attractors} | given)
    assert caught.value.key == key


def test_progress_counts_starts():
    scene, attractors = known("figure 5")
    counts = []
    jv.basins(scene, np.linspace(-1.0, 1.0, 9), np.linspace(-3.0, 3.0, 9), 0.0, attractors, progress=counts.append)
    assert counts == sorted(counts) and counts[-1] == 81


def test_entropy_of_known_pictures():
    halves = np.repeat([[0, 1]], 50, axis=1).T @ np.ones((1, 100), int)
    board = np.indices((100, 100)).sum(axis=0) % 2
    assert basin_boundaries.basin_entropies(board, 2) == pytest.approx((np.log(2), np.log(2)))
    assert basin_boundaries.basin_entropies(halves, 5) == (0.0, 0.0)  # the boundary lies between boxes
    whole, edge = basin_boundaries.basin_entropies(np.roll(halves, 2, axis=0), 5)
    part = -(0.4 * np.log(0.4) + 0.6 * np.log(0.6))
    assert (whole, edge) == pytest.approx((part * 2 / 20, part))
    thirds = np.arange(90 * 90).reshape(90, 90) % 3
    assert basin_boundaries.basin_entropies(thirds, 3) == pytest.approx((np.log(3), np.log(3)))
    assert basin_boundaries.basin_entropies(np.where(board == 1, -1, 0), 2) == (0.0, 0.0)
    assert np.isnan(basin_boundaries.basin_entropies(board[:3, :3])).all()


def test_dimension_of_known_pictures():
    rows, columns = np.indices((1025, 1025))
    straight = basin_boundaries.boundary_dimension((columns > 400).astype(int))
    assert (straight.value, straight.error) == pytest.approx((1.0, 0.0), abs=1e-12)
    np.testing.assert_allclose(straight.mixed_fractions, straight.box_sides / 1024)
    slanted = basin_boundaries.boundary_dimension((columns > 0.37 * rows + 100.3).astype(int))
    assert slanted.value == pytest.approx(1.0, abs=0.01)
    circle = basin_boundaries.boundary_dimension(((rows - 500) ** 2 + (columns - 510) ** 2 < 300**2).astype(int))
    assert circle.value == pytest.approx(1.0, abs=max(0.02, 2 * circle.error))
    riddled = basin_boundaries.boundary_dimension(np.random.default_rng(0).integers(0, 2, (1025, 1025)))
    assert riddled.value > 1.9
    assert np.isnan(basin_boundaries.boundary_dimension(np.zeros((65, 65), int))[:2]).all()
    assert basin_boundaries.boundary_dimension(np.where(columns == 400, -1, (columns > 400).astype(int)))[
        0
    ] == pytest.approx(1.0, abs=0.1)


def test_dimension_of_a_cantor_set_of_boundaries():
    levels, parity = 8, np.zeros(3**8, int)
    for level in range(levels):
        third = np.arange(3**levels) // 3 ** (levels - 1 - level) % 3
        new = (third == 1) & (parity == 0)
        parity[new] = 1 + level % 2
    found = basin_boundaries.boundary_dimension(np.tile(np.where(parity == 0, 3, parity), (2049, 1)))
    assert found.value == pytest.approx(1.0 + np.log(2) / np.log(3), abs=0.06)
    assert abs(found.value - 1.0 - np.log(2) / np.log(3)) < 3 * found.error


def test_a_picture_of_basins_tells_all_attractors_apart():
    scene, attractors = known("figure 5")
    data = jv.basins(scene, np.linspace(-1.2, 1.0, 23), np.linspace(-3.0, 3.0, 21), 0.0, attractors)
    ax = Figure().subplots()
    assert plot.basins(data, ax) is ax
    marks = [line for line in ax.lines if line.get_gid() == "attractor"]
    assert [line.get_marker() for line in marks] == ["<", ">", "^", "v"]
    assert len({line.get_color() for line in marks}) == 4
    told = [text.get_text() for text in ax.get_legend().get_texts()]
    assert told[-1] == "beyond a wall" and told[0].startswith("P111: ")
    assert "X" in ax.get_xlabel() and "omega_0" in ax.get_ylabel()
    greys = [np.dot(to_rgb(colour), (0.299, 0.587, 0.114)) for colour in PALE_COLOURS]
    assert (np.diff(greys) < -0.05).all()
