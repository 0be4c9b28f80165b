"""The present code gives the numbers, reads the files and has the signatures of an earlier commit."""

import json
from pathlib import Path

import numpy as np
import pytest

from .baseline import compare, compute

STORED = Path(compute.__file__).parent / "stored"
ULPS = 32  # processors differ in the order of a few operations, and multipliers at a fold amplify this


@pytest.fixture(scope="module")
def stored():
    return compare.read(STORED)


@pytest.mark.parametrize("part", ["strobe", "readme", "map"])
def test_the_numbers_are_those_of_before(stored, part):
    values = {"strobe": compute.strobes, "readme": lambda: compute.readme(None), "map": compute.map_cells}[part]()
    old = {name: array for name, array in stored[0].items() if name in values}
    assert old.keys() == values.keys() and len(values) >= 3
    assert {name: ulps for name, array in old.items() if (ulps := compare.ulps(array, values[name])) > ULPS} == {}


def test_public_names_parameters_and_attributes_are_those_of_before(stored):
    assert {name.split("/")[0] for name in stored[0]} == {"strobe", "branch", "locus", "map"}
    assert compare.removed(stored[1], compute.signatures()) == []
    lacking = json.loads(json.dumps(stored[1]))
    del lacking["jaxvibro.follow"]["signature"][1]
    del lacking["jaxvibro.Branch"]["attributes"]["table"]
    names = " ".join(compare.removed(stored[1], lacking))
    assert "jaxvibro.follow(" in names and "jaxvibro.Branch.table" in names


@pytest.mark.parametrize("name", sorted(compare.READERS))
def test_files_of_before_are_read(stored, name):
    content = compare.contents(STORED, name)
    if name in ("branch.nc", "locus.nc"):
        assert compare.ulps(stored[0][f"{name.removesuffix('.nc')}/amplitude"], content) == 0
    assert content.size > 1 and np.isfinite(content).all()


def test_differences_are_counted_in_units_in_the_last_place():
    values = np.array([1.0, np.nan, 0.0])
    assert compare.ulps(values, values.copy()) == 0
    assert compare.ulps(values, np.array([1.0 + 2**-50, np.nan, 0.0])) == 4
    assert compare.ulps(values, np.array([1.0, 0.0, 0.0])) == np.inf
    assert compare.ulps(np.array([1, 2]), np.array([1, 3])) == np.inf
