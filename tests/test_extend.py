"""Ends of branches: what is continued beyond them, and how files and texts keep them."""

import json

import numpy as np
import pytest
import xarray as xr

import jaxvibro as jv
from jaxvibro.problem.curve_ends import End, parse_end

WALLS = -1.0, jv.Wall(1.0, 0.6)


def test_a_branch_that_closes_beyond_its_bounds_is_walked_once():
    scene = jv.make_scene(2.4385486894519643, 2.670563884763925, 0.04702036199895722, 0.8592648540574589, (None, 1.0))
    orbit = jv.find_orbit(scene, jv.State(-2.3616057606263445, 0.04007684474399777))
    whole = jv.follow(orbit, "frequency", (1.5, 6.0))
    assert whole.ends == (End.START, End.CLOSED)
    middle = 0.5 * (whole.values.min() + whole.values.max())
    cut = jv.follow(orbit, "frequency", (1.5, middle))
    assert cut.ends == (End.BOUND, End.BOUND)
    once = jv.extend(cut, (1.5, 6.0))
    values = [sorted(one.value for one in each.special if one.kind != "EP") for each in (once, whole)]
    np.testing.assert_allclose(*values, rtol=0, atol=1e-9)
    assert set(once.ends) == set(whole.ends)
    assert abs(len(once) - len(whole)) < 0.2 * len(whole)


def test_an_end_of_the_domain_is_not_a_bound_any_more():
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, WALLS)
    orbit = jv.find_orbit(scene, jv.State(0.9, -1.1))
    branch = jv.follow(orbit, "damping", (0.0, 0.06))
    assert End.BOUND in branch.ends
    for wide in (jv.extend(branch, (-1.0, 0.06)), jv.follow(orbit, "damping", (-1.0, 0.06))):
        assert len(wide) == len(branch) and wide.values.min() == 0.0
        assert wide.ends == tuple(End.DOMAIN if value == 0.0 else End.BOUND for value in branch.values[[0, -1]])
        assert "the parameter's domain ends at 0" in wide.reasons


@pytest.mark.parametrize("one", End)
def test_an_end_is_read_from_its_text(one):
    assert parse_end(one.reason(-1.25e-7, "my {bound} of 1").text) is one
    with pytest.raises(ValueError):
        parse_end(one.reason().text + " or so")


def test_branches_of_before_are_loaded(tmp_path):
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, WALLS)
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (1.9, 2.1))
    branch.save(tmp_path / "branch.nc")
    assert jv.load_branch(tmp_path / "branch.nc").ends == branch.ends
    data = xr.load_dataset(tmp_path / "branch.nc", engine="scipy")
    assert json.loads(data.attrs.pop("ends")) == ["BOUND", "BOUND"]
    data.attrs = {key: each for key, each in data.attrs.items() if key not in ("format", "checksum")}
    data.to_netcdf(tmp_path / "old.nc", engine="scipy")
    with pytest.warns(UserWarning, match="has no checksum"):
        assert jv.load_branch(tmp_path / "old.nc").ends == branch.ends
