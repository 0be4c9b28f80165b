"""A branch of `continuation` in a file and back."""

import numpy as np
import pytest

import continuation as co
from tests.test_trace import HENON, PITCHFORK, kinds


@pytest.fixture(scope="module")
def cycle():
    (doubling,) = co.trace(HENON, np.zeros(2), {"a": 0.0, "b": 0.3}, "a", (-0.2, 0.95)).points("PD")
    (cycle,) = co.switch(doubling)
    return cycle


def test_it_comes_back_the_same_and_goes_on(cycle, tmp_path):
    path = tmp_path / "cycle.npz"
    co.save(cycle, path)
    again = co.load(path, HENON)
    assert [one.name for one in tmp_path.iterdir()] == ["cycle.npz"]
    assert (again.names, again.kind, again.reasons, again.system) == (cycle.names, None, cycle.reasons, cycle.system)
    for one, two in ((again, cycle), *zip(again.special, cycle.special, strict=True)):
        assert np.array_equal(one.u, two.u) and np.array_equal(one.eigenvalues, two.eigenvalues)
    assert np.array_equal(again.p["a"], cycle.p["a"]) and again.table() == cycle.table()
    mine, other = (co.switch(each.points("PD")[0], {"a": (0.9, 0.95)})[0] for each in (cycle, again))
    assert len(mine) == len(other) and np.array_equal(mine.u, other.u) and kinds(mine) == kinds(other)


def test_what_is_no_branch_is_refused(cycle, tmp_path):
    path = tmp_path / "cycle.npz"
    co.save(cycle, path)
    with pytest.raises(co.ContinuationError, match="system"):
        co.load(path, PITCHFORK)
    content = path.read_bytes()
    for damaged in (b"", b"not an archive", content[: len(content) // 2]):
        path.write_bytes(damaged)
        with pytest.raises(co.ContinuationError, match="path"):
            co.load(path, HENON)
    np.savez(path, plain=np.array('{"form": 2}'))
    with pytest.raises(co.ContinuationError, match="path"):
        co.load(path, HENON)
    with pytest.raises(OSError):
        co.load(tmp_path / "none.npz", HENON)
