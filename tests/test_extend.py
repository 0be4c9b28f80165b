"""A branch with wider bounds is the one followed within them at once, whichever of its ends goes on."""

import json

import numpy as np
import pytest
import xarray as xr

import jaxvibro as jv
from jaxvibro.problem.end import End, parse_end

MOVING = jv.Wall(1.0, 0.8, motion=jv.Motion(0.1, 0.5))
SOFT = jv.Wall(1.0, stiffness=20.0, damping=0.3)
WALLS = {
    "two walls": lambda far: (-far, jv.Wall(1.0, 0.6)),
    "one wall": lambda far: (None, 0.3 * far),
    "a moving wall": lambda far: (-far, MOVING),
    "a soft wall": lambda far: (-far, SOFT),
}
DOMAIN = {"amplitude": (0.2, 7.0), "frequency": (1.2, 4.0), "damping": (0.0, 1.5), "left.position": (-4.0, -0.2)}


def drawn(name, seed):
    """(orbit, parameter, narrow bounds, wide bounds) of a random scene with such walls."""
    rng = np.random.default_rng([list(WALLS).index(name), seed])
    while True:
        numbers = rng.uniform((1.0, 1.7, 0.02, 0.3), (6.0, 3.0, 0.4, 0.9))
        scene = jv.make_scene(*numbers, WALLS[name](rng.uniform(0.8, 1.8)))
        try:
            orbit = jv.find_orbit(scene, jv.State(0.1, rng.uniform(-2.0, 2.0)))
        except jv.OrbitError:
            continue
        if orbit.impacts.count and orbit.unknowns == "impacts" and orbit.impacts.count <= 4:
            break
    known = [key for key in DOMAIN if key in scene.names]
    parameter, (low, high) = (key := known[seed % len(known)]), DOMAIN[key]
    value = float(scene.parameter(parameter))
    low, high = max(low, value - 2.0), min(high, value + 2.0)
    narrow = value + 0.4 * (low - value) * rng.random(), value + 0.4 * (high - value) * rng.random()
    return orbit, parameter, narrow, (low, high)


def told(branch):
    return [(one.kind, one.label, one.place) for one in branch.special]


def is_sound(branch):
    """Whether no point is there twice or outside the bounds, and special points and segments are in their places."""
    low, high = branch.bounds
    size = 1.0 / branch.data["time"].shape[1]
    rows = [branch.data[key].fillna(0.0).values for key in ("time", "speed")] + [branch.values[:, None]]
    same = np.array_equal(branch.data["segment"], np.repeat(range(len(branch.segments)), _lengths(branch)))
    apart = np.abs(np.diff(np.concatenate(rows, axis=1), axis=0)).max(axis=1)
    places = [one.place for one in branch.special]
    ends = {0, len(branch) - 1}
    return bool(
        same
        and (apart[np.diff(branch.data["segment"]) == 0] > 1e-9 * size).all()
        and low <= branch.values.min()
        and branch.values.max() <= high
        and ends <= set(places)
        and places == sorted(places)
        and all(one.kind != "EP" or one.place in ends for one in branch.special)
        and all(one.bounds == branch.bounds and one.value == branch.values[one.place] for one in branch.special)
    )


def _lengths(branch):
    return [one.last - one.first + 1 for one in branch.segments]


def is_same(branch, whole):
    """Whether two branches have the same special points and ends; where they close they may begin elsewhere, and come
    to a grazing from its other side, whose label it then has."""
    closes = End.CLOSED in whole.ends
    one, other = ([each for each in every.special if not (closes and each.kind == "EP")] for every in (branch, whole))
    one, other = (sorted(each, key=lambda one: one.value) if closes else each for each in (one, other))
    kinds = [[(each.kind, each.label * (not closes)) for each in every] for every in (one, other)]
    values = [[each.value for each in every] for every in (one, other)]
    # a special point is known to rounding, a grazing of soft walls from a square root away
    return kinds[0] == kinds[1] and np.allclose(*values, rtol=0, atol=1e-9) and set(branch.ends) == set(whole.ends)


MARKS = {"two walls": (), "one wall": pytest.mark.slow}


@pytest.mark.parametrize("name", [pytest.param(name, marks=MARKS.get(name, pytest.mark.long)) for name in WALLS])
def test_a_branch_extended_is_the_one_followed_at_once(name):
    check_extended(name, 2)


def check_extended(name, seed):
    """A branch of a random scene with such walls, extended in every order, against the one followed at once."""
    orbit, parameter, narrow, wide = drawn(name, seed)
    branch = jv.follow(orbit, parameter, narrow)
    bounds = {"low": (wide[0], narrow[1]), "high": (narrow[0], wide[1]), "both": wide, "neither": narrow}
    for which, some in bounds.items():
        once = jv.extend(branch, some)
        assert once.bounds == some and is_sound(once), which
        assert once.scene.numbers == branch.scene.numbers
        assert is_same(once, jv.follow(orbit, parameter, some)), which
        again = jv.extend(once, some)
        assert told(again) == told(once) and len(again) == len(once) and again.reasons == once.reasons
    one, other = (jv.extend(jv.extend(branch, bounds[which]), wide) for which in ("low", "high"))
    assert is_sound(one) and is_sound(other)
    once = jv.extend(branch, wide)
    assert is_same(one, once) and is_same(other, once)
    assert told(jv.extend(branch, narrow)) == told(branch) and len(jv.extend(branch, narrow)) == len(branch)


def test_a_branch_that_closes_beyond_its_bounds_is_walked_once():
    scene = jv.make_scene(2.4385486894519643, 2.670563884763925, 0.04702036199895722, 0.8592648540574589, (None, 1.0))
    orbit = jv.find_orbit(scene, jv.State(-2.3616057606263445, 0.04007684474399777))
    whole = jv.follow(orbit, "frequency", (1.5, 6.0))
    assert whole.ends == (End.START, End.CLOSED)
    middle = 0.5 * (whole.values.min() + whole.values.max())
    cut = jv.follow(orbit, "frequency", (1.5, middle))
    assert cut.ends == (End.BOUND, End.BOUND)
    once = jv.extend(cut, (1.5, 6.0))
    assert is_same(once, whole) and is_sound(once)
    assert abs(len(once) - len(whole)) < 0.2 * len(whole)


def test_an_end_of_the_domain_is_not_a_bound_any_more():
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, WALLS["two walls"](1.0))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "damping", (0.0, 0.06))
    assert End.BOUND in branch.ends
    wide = jv.extend(branch, (-1.0, 0.06))
    assert len(wide) == len(branch) and wide.ends == tuple(
        End.DOMAIN if value == 0.0 else End.BOUND for value in branch.values[[0, -1]]
    )
    assert "the parameter's domain ends at 0" in wide.reasons


@pytest.mark.parametrize("one", End)
def test_an_end_is_read_from_its_text(one):
    assert parse_end(one.reason(-1.25e-7, "my {bound} of 1").text) is one
    with pytest.raises(ValueError):
        parse_end(one.reason().text + " or so")


def test_branches_of_before_are_loaded(tmp_path):
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, WALLS["two walls"](1.0))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (1.9, 2.1))
    branch.save(tmp_path / "branch.nc")
    assert jv.load_branch(tmp_path / "branch.nc").ends == branch.ends
    data = xr.load_dataset(tmp_path / "branch.nc", engine="scipy")
    assert json.loads(data.attrs.pop("ends")) == ["BOUND", "BOUND"]
    data.attrs = {key: each for key, each in data.attrs.items() if key not in ("format", "checksum")}
    data.to_netcdf(tmp_path / "old.nc", engine="scipy")
    with pytest.warns(UserWarning, match="has no checksum"):
        assert jv.load_branch(tmp_path / "old.nc").ends == branch.ends
