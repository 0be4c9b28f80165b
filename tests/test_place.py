"""`place` where the targets cannot be met: the last admissible scene, against a value that is known in closed form."""

import numpy as np
import pytest

from jaxvibro.design import place


def asked(is_virtual, bound=np.inf):
    """One free number, whose change is the value; the point is virtual where a function of the change says so."""

    def sloped(places):
        return places.copy(), np.ones((len(places), 1, 1))

    def virtual(change):
        return ["SN"] if is_virtual(float(change[0])) else []

    none = np.zeros(1)
    return place._PlacementProblem(("damping",), none + 1.0, none, none - np.inf, none + bound, sloped, virtual)


@pytest.mark.parametrize("edge", [0.003, 0.3, 0.75, 0.999])
def test_beyond_the_end_of_a_boundary_it_is_the_last_admissible_one(edge):
    last, held, virtual = place._follow_path_to_targets(asked(lambda change: change > edge), np.ones(1))
    assert edge - place.MIN_FRACTION < last.fraction <= edge and last.change[0] == pytest.approx(
        last.fraction, abs=1e-12
    )
    assert virtual == ["SN"] and not held.any()
    told = place._failure_reason(last.fraction, virtual, ())
    assert told == (
        f"the path to the targets ends after {last.fraction:.3g} of its length:"
        " the orbit of the SN passes through a wall beyond it"
    )


def test_a_target_beyond_a_virtual_stretch_is_met():
    last, _, virtual = place._follow_path_to_targets(asked(lambda change: 0.3 < change < 0.6), np.ones(1))
    assert last.fraction == 1.0 and not virtual and place._failure_reason(1.0, virtual, ()) == ""


def test_where_a_bound_stops_it_that_is_told():
    last, held, virtual = place._follow_path_to_targets(asked(lambda change: False, 0.4), np.ones(1))
    assert 0.4 - place.MIN_FRACTION < last.fraction <= 0.4 and held.all() and not virtual
    assert "damping is at a bound" in place._failure_reason(last.fraction, virtual, ("damping",))
