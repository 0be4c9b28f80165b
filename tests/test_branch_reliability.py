"""What continuation is judged by, against closed forms in mpmath; that the judge sees what is wrong; ours on a few."""

import mpmath
import numpy as np
import pytest

from benchmarks.rows import Size
from reliability import branch_truth, branches, jaxcont_branch, scipy_branch
from tests.reference import closed

TRUTHS = branches.drawn(9)
IDS = [each.family.label for each in TRUTHS]


def reference(family, speed, amplitude):
    """The orbit of mpmath's closed form with the impact speed, and the arguments that made it."""
    given = family.gamma, family.omega, amplitude, family.restitution
    found = closed.orbits(*given, 1.0, 1, family.periods, family.symmetric)
    return min(found, key=lambda orbit: abs(orbit.speed - speed)), given


@pytest.mark.parametrize("truth", TRUTHS, ids=IDS)
def test_the_closed_form(truth):
    family, amplitude = truth.family, float(truth.family.amplitude(truth.start))
    with mpmath.workdps(30):
        orbit, given = reference(family, truth.start, amplitude)
        state = closed.at_phase(*given[:3], orbit, 0, family.symmetric)
        assert abs(orbit.speed - truth.start) < 1e-9 * truth.high
        assert np.allclose(family.sections(truth.start)[0], [float(each) for each in state], rtol=0, atol=1e-9)
        fold = closed.fold(family.gamma, family.omega, family.restitution, 1.0, 1, family.periods, family.symmetric)
        assert abs(fold.speed - family.turning(1.0)) < 1e-10 * abs(family.turning(1.0))
        speed = family.turning(-1.0)
        if speed > 0:
            orbit, given = reference(family, speed, float(family.amplitude(speed)))
            found = closed.multipliers(*given, orbit, family.periods, family.symmetric)
            assert min(abs(each - (1 if family.symmetric else -1)) for each in found) < 1e-7


@pytest.mark.parametrize("truth", TRUTHS, ids=IDS)
def test_where_it_ends_it_touches_a_wall(truth):
    family, inner = truth.family, np.linspace(truth.low, truth.high, 40)[1:-1]
    assert np.all(family.clearance(inner) > 0)
    if truth.ends[1] == "GR":
        x = family.motion(truth.high, np.linspace(0, family.length, 200_001)[2000:-2000])[0]
        assert abs((abs(x) if family.symmetric else x).max() - 1) < 1e-8


@pytest.fixture(scope="module")
def followed():
    """Truth and our path of each kind."""
    return [(truth, branches.ours(truth)) for truth in TRUTHS[:3]]


def test_ours_finds_all_and_nothing_else(followed):
    for truth, path in followed:
        told = branches.judge(truth, path, branches.NAMED["jaxvibro"])
        assert told[:4] == (0, 0, [], []) and told.error < 1e-9


def test_the_judge_sees_each_failure(followed):
    for truth, path in followed:
        named = branches.NAMED["jaxvibro"]
        cut = len(path.places) // 2
        known = [one for one in path.special if one[0] in named]
        assert branches.judge(truth, branches.Path(path.places[:cut], []), named).lost == 1
        assert branches.judge(truth, branches.Path(path.places[:0], []), named).lost == 2
        assert branches.judge(truth, path._replace(places=path.places + np.array([0.0, 0.1, 0.0])), named).jumped > cut
        (missed,) = branches.judge(truth, path._replace(special=known[1:]), named).missed
        assert missed[0] == known[0][0] and missed[1] == pytest.approx(known[0][1], rel=1e-9)
        more = [*known, ("PD", 0.123)]
        assert branches.judge(truth, path._replace(special=more), named).wrong == [("PD", 0.123)]


def test_a_share_has_clopper_and_pearsons_bounds():
    assert branches.share(0, 200) == "0: 0.0 % (0.0 to 1.8)"  # 1 - 0.025^(1 / 200)
    assert branches.share(3, 20) == "3: 15.0 % (3.2 to 37.9)"


def test_a_branch_lies_between_its_ends():
    assert branch_truth.run_of([False, True, True, False, True], 2) == (1, 2)
    for truth in TRUTHS:
        assert truth.low < truth.start < truth.high and truth.bounds[0] < min(value for _, value in truth.special)


def test_a_measurement(monkeypatch):
    """But for jaxcont, which compiles for minutes; it follows one branch below."""
    monkeypatch.delitem(branches.METHODS, "jaxcont on our map")
    ours, *others = branches.measure(Size(quick=True))
    assert ours.branches == 12 and (ours.lost, ours.jumped, ours.missed, ours.wrong) == (0, 0, 0, 0)
    assert ours.error < 1e-9 and all(each.branches for each in others)
    text = branches.table([ours, *others])
    assert "| jaxvibro | 12 | 0: 0.0 % (0.0 to 26.5) |" in text and "SciPy arclength" in text


@pytest.mark.parametrize(
    ("module", "fold"),
    [(scipy_branch, 7.245431514880592), (jaxcont_branch, 0.40044852663887776)],
    ids=["scipy", "jaxcont"],
)
def test_a_rival_follows_a_branch_where_its_map_is_smooth(module, fold):
    (truth,) = (each for each in branches.drawn(30) if abs(each.special[-1][1] - fold) < 1e-9)
    told = branches.judge(truth, branches.by(module)(truth), ("SN",))
    assert told[:4] == (0, 0, [], []) and told.error < 1e-2
