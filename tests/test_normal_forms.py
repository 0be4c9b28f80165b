"""Normal forms of special points against closed forms and certified flights; properties/test_problem has the rest."""

from dataclasses import replace
from itertools import pairwise

import mpmath
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.branches.normal_form import normal_form_fields, normal_form_of_unfolding
from jaxvibro.output.checksums import netcdf_bytes
from jaxvibro.problem.normal_forms import Unfolding

from . import figure_4
from .figure_4 import GAMMA, OMEGA, R
from .reference import closed, special
from .special_points import reference_bend
from .truths import plain


@pytest.fixture(scope="module")
def branch():
    return figure_4.branch()


@pytest.fixture(scope="module")
def asymmetric():
    return figure_4.asymmetric()[1]


def only(branch, kind):
    return branch.points(kind)[0].normal_form


def test_a_fold_against_its_closed_form(branch):
    """(1 - a u)^2 + (b u / omega)^2 = A^2 / D, with the speed u."""
    with mpmath.workdps(40):
        a, b = closed.coefficients(GAMMA, OMEGA, R, 1, True)
        fold, d = closed.fold(GAMMA, OMEGA, R, 1, symmetric=True), closed.denominator(GAMMA, OMEGA)
        omega = mpmath.mpf(OMEGA)

        def amplitude(u):
            return mpmath.sqrt(d * ((1 - a * u) ** 2 + (b * u / omega) ** 2))

        def time(u):
            return closed.phase_of(GAMMA, omega, amplitude(u), 1 - a * u, -b * u) / omega

        late, bend = float(mpmath.diff(time, fold.speed)), float(mpmath.diff(amplitude, fold.speed, 2) / 2)
    form = only(branch, "SN")
    assert form.coefficient == pytest.approx(bend / (late**2 + 1), rel=1e-10) and form.side == 1
    count = len(form.null) // 2
    assert np.allclose(form.null[:count] / form.null[count:], late, rtol=1e-9, atol=0)
    assert form.consequence == "jump" and form.criticality == "" and np.isnan(form.rate) and form.depths == ()


DOUBLINGS = {  # (amplitude, frequency, damping, restitution, right wall), name, bounds
    ("soft", "supercritical"): ((2.0, 2.1, 0.2, 0.6, 0.8), "amplitude", (0.05, 4.0)),
    ("jump", "subcritical"): ((3.7, 3.2, 1.2, 0.62, 0.68), "frequency", (1.0, 4.0)),
}


@pytest.mark.parametrize("expected", DOUBLINGS)
def test_period_doublings_of_one_impact(expected):
    (*numbers, wall), name, bounds = DOUBLINGS[expected]
    scene = jv.make_scene(*numbers, (None, wall))
    branch = jv.follow(jv.find_orbit(scene, jv.State(-0.5, 0.0)), name, bounds)
    (point,) = (one for one in branch.points("PD") if one.label == "P101")
    form = point.normal_form
    assert (form.consequence, form.criticality) == expected
    assert form.coefficient == pytest.approx(reference_bend(point), rel=1e-10)
    step = 1e-5
    least = [
        jv.find_orbit(scene.replace(**{name: point.value + change}), point.orbit.state).multipliers.real.min()
        for change in (-step, step)
    ]
    assert form.rate == pytest.approx((least[1] - least[0]) / (2.0 * step), rel=1e-6)


def test_coefficients_vanish_where_the_side_changes():
    """At the frequencies of GPD and DSB that `test_locus` has in 20 digits."""

    def breaking(frequency):
        scene = jv.make_scene(2.0, frequency, GAMMA, R, (-1.0, 1.0))
        return jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.0, 2.0)).points("SB")[0]

    found = [breaking(frequency).normal_form for frequency in (0.85, 0.87811842201733201397, 0.9)]
    assert [one.criticality for one in found[::2]] == ["supercritical", "subcritical"]
    assert abs(found[1].coefficient) < 1e-8 * min(abs(one.coefficient) for one in found[::2])
    asymmetric = jv.switch(breaking(0.94613199424931461124), (0.4, 0.65))[0]
    assert abs(only(asymmetric, "PD").coefficient) < 1e-9


def test_the_root_of_the_motion_without_impacts(branch):
    """Its acceleration at the wall is omega^2 times the wall's distance, its size the drive's over sqrt(D)."""
    form = only(branch, "GR")
    with mpmath.workdps(30):
        size = float(1 / mpmath.sqrt(closed.denominator(GAMMA, OMEGA)))
    assert form.coefficient == pytest.approx((1.0 + R) * np.sqrt(2.0) * OMEGA, rel=1e-11)
    assert form.rate == pytest.approx(size, rel=1e-9) and form.side == 1
    assert [one.side for one in form.depths] in ([-1, 1], [1, -1])
    assert form.consequence == "jump" and len(form.null) == 0 and form.criticality == ""
    scene = jv.make_scene(2.0, OMEGA, GAMMA, R, (jv.Wall(-1.0, 0.4), jv.Wall(1.0)))
    free = jv.follow(jv.find_orbit(scene.replace(amplitude=1.0), jv.State(0.0, 0.0)), "amplitude", (0.5, 3.5))
    roots = {one.side: one.root for one in only(free, "GR").depths}
    assert roots[-1] == pytest.approx(1.4 * np.sqrt(2.0) * OMEGA, rel=1e-11)
    assert only(free, "GR").coefficient == roots[1] == pytest.approx(form.coefficient, rel=1e-11)


def test_the_consequence_of_a_grazing_is_that_of_the_stable_orbits(branch, asymmetric):
    for point in (branch.points("GR")[0], asymmetric.points("GR")[0]):
        sides = {float(one.scene.parameter(point.name)) > point.value for one in point.meets if one.stable}
        assert len(sides) == 1 and point.normal_form.consequence == "jump"
    point = branch.points("GR")[0]
    free, hitting = sorted(point.joins, key=lambda one: len(one.times))
    beyond = free._replace(z=np.append(free.z[:-1], 2.0 * point.value - free.value))
    for joins, told in (((free,), "jump"), ((hitting,), "harmless"), ((free, beyond), "harmless")):
        assert replace(point, joins=joins).normal_form.consequence == told


def test_grazings_of_soft_walls_are_harmless():
    walls = [jv.Wall(side, stiffness=10.0, damping=0.1) for side in (-1.0, 1.0)]
    scene = jv.make_scene(0.3, 0.7, 0.05, 0.7, walls)
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.1, 0.0)), "frequency", (0.6, 0.95))
    for point in branch.points("GR"):
        form = point.normal_form
        assert form.coefficient == 0.0 and form.consequence == "harmless" and len(form.depths) == 2
        size = np.hypot(1.0 - point.value**2, 2.0 * 0.05 * point.value)
        slope = (point.value * (1.0 - point.value**2 - 2.0 * 0.05**2)) * 2.0 * 0.3 / size**3
        assert form.rate == pytest.approx(slope, rel=1e-8)
    assert branch.points("GR")


def test_a_soft_wall_that_moves_changes_the_velocity_at_once():
    """Where the motion without impacts touches it, as it would a rigid one: a period that begins there with a depth, by
    certified flights, brought back to its begin without the wall."""
    wall = jv.Wall(1.0, stiffness=20.0, damping=0.6, motion=jv.Motion(0.2, 0.5))
    soft = jv.make_scene(0.3, 0.7, 0.05, 0.7, (None, wall))
    point = jv.follow(jv.find_orbit(soft, jv.State(0.0, 0.0)), "amplitude", (0.1, 2.0), stop="GR").points("GR")[0]
    (grazing,), soft = point.normal_form.depths, soft.replace(amplitude=point.value)
    phases = np.linspace(0.0, 2.0 * np.pi, 4001)
    z = point.value / (1.0 - 0.7**2 + 2j * 0.05 * 0.7)
    gaps = 1.0 + 0.2 * np.cos(phases + 0.5) - (z * np.exp(1j * phases)).real
    near = phases[np.argmin(gaps)] + np.array([-2e-3, 0.0, 2e-3])
    rates = -0.2 * np.sin(near + 0.5) - (1j * z * np.exp(1j * near)).real
    phase = np.interp(0.0, rates, near)
    position, velocity = 1.0 + 0.2 * np.cos(phase + 0.5), -0.14 * np.sin(phase + 0.5)

    free = plain(soft)

    def jump(h):
        begin = phase / 0.7 - 2.0  # the period ends before the wall is touched again
        start = special.fly(free, phase / 0.7, position + h * h, velocity, begin)
        end, impacts = jv.strobe(soft, jv.State(*map(float, start), 0.7 * begin))
        assert impacts.count == 1
        _, v = special.fly(free, begin, float(end.x), float(end.v), phase / 0.7 - 2.0 * np.pi / 0.7)
        return float(abs(v - velocity)) / h

    values = [jump(0.02 * 0.5**k) for k in range(6)]
    for order in range(1, 6):  # the limit of a series in h
        values = [(2.0**order * b - a) / (2.0**order - 1.0) for a, b in pairwise(values)]
    assert values[0] == pytest.approx(grazing.root, rel=1e-5)


def test_orbits_that_are_unstable_on_both_sides_are_harmless():
    """No scene with damping has one, so the rule is asked alone."""
    found = Unfolding(0.5, np.ones(2), -1.0)
    told = [normal_form_of_unfolding(kind, found, stable) for kind in ("SN", "PD", "SB") for stable in (True, False)]
    assert [one.consequence for one in told] == ["jump", "harmless", "soft", "harmless", "jump", "harmless"]
    assert normal_form_of_unfolding("PD", found._replace(coefficient=np.nan), True) is None


def same(one, other):
    """Whether two normal forms have the same bits."""
    return repr(normal_form_fields(one)) == repr(normal_form_fields(other))


def test_files_have_them(asymmetric, tmp_path):
    asymmetric.save(tmp_path / "new.nc")
    loaded = jv.load_branch(tmp_path / "new.nc")
    assert all(same(a.normal_form, b.normal_form) for a, b in zip(asymmetric.special, loaded.special, strict=True))
    assert loaded.points("PD")[0].saved is not None and asymmetric.points("PD")[0].saved is None
    assert loaded.table() == asymmetric.table()
    data = jv.load_data(tmp_path / "new.nc")
    text = data.attrs.pop("normal_forms")
    (tmp_path / "old.nc").write_bytes(netcdf_bytes(data))
    before = jv.load_branch(tmp_path / "old.nc")
    assert before.points("PD")[0].saved is None and before.table() == asymmetric.table()
    for change, wrong in (('"soft"', '"much"'), ('"supercritical"', '"much"'), ("[", "[null, ")):
        assert change in text
        wrong = text.replace(change, wrong, 1)
        (tmp_path / "wrong.nc").write_bytes(netcdf_bytes(data.assign_attrs(normal_forms=wrong)))
        with pytest.raises(jv.ArgumentError, match="must be a file of Branch"):
            jv.load_branch(tmp_path / "wrong.nc")


def test_other_kinds_have_none(branch):
    assert all(one.normal_form is None for one in branch.points("EP"))
    assert branch.table().splitlines()[1].split()[-2:] == ["-", "-"]
    wrong = replace(branch.points("EP")[0], kind="GR")
    assert wrong.normal_form is None  # it touches no wall
