"""A few of the compositions of `tests.compositions_proof`, in child processes: none aborts, all equal single calls."""

import pytest

from tests import compositions_proof


@pytest.mark.parametrize("first", [0, 10])
def test_compositions(first, tmp_path):
    results = compositions_proof.children(range(first, first + 10), tmp_path)
    assert not [one for one in results.values() if "failure" in one or one["error"] > 1]
    assert sum(one["compared"] - one["slow"] for one in results.values()) > 20
