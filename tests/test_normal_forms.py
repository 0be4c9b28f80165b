"""Normal forms of special points against closed forms and certified flights; properties/test_problem has the rest."""

from dataclasses import replace
from itertools import pairwise

import mpmath
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.branches import normal_form as forms
from jaxvibro.output.checksums import netcdf_bytes
from jaxvibro.problem.grazing_jumps import grazing_jumps
from jaxvibro.problem.normal_forms import Unfolding
from jaxvibro.problem.orbit_point import set_up_equations
from tests.reference import closed
from tests.special_points import reference_bend

GAMMA, OMEGA, R = 0.05, 2.1, 0.7


@pytest.fixture(scope="module")
def branch():
    scene = jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.0, 1.0))
    return jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (0.0, 6.0))


@pytest.fixture(scope="module")
def lopsided(branch):
    return jv.switch(branch.points("SB")[0])[1]


def only(branch, kind):
    return branch.points(kind)[0].normal_form


def bend_of_the_fold(frequency, symmetric):
    """(b, how the time changes with the speed) at the fold of the orbits of `closed.orbits` about walls at 1: there
    (1 - a u)^2 + (b u / omega)^2 = A^2 / D."""
    with mpmath.workdps(40):
        a, b = closed.coefficients(GAMMA, frequency, R, 1, symmetric)
        fold, d = closed.fold(GAMMA, frequency, R, 1, symmetric=symmetric), closed.denominator(GAMMA, frequency)
        omega = mpmath.mpf(frequency)

        def amplitude(u):
            return mpmath.sqrt(d * ((1 - a * u) ** 2 + (b * u / omega) ** 2))

        def time(u):
            return closed.phase_of(GAMMA, omega, amplitude(u), 1 - a * u, -b * u) / omega

        late, bend = mpmath.diff(time, fold.speed), mpmath.diff(amplitude, fold.speed, 2) / 2
        return float(bend / (late**2 + 1)), float(late)


@pytest.mark.parametrize("symmetric", [True, False])
def test_a_fold_against_its_closed_form(branch, symmetric):
    frequency = OMEGA if symmetric else 1.7
    if not symmetric:
        scene = jv.make_scene(1.0, frequency, GAMMA, R, (None, 1.0))
        branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.0, 6.0))
    form = only(branch, "SN")
    true, late = bend_of_the_fold(frequency, symmetric)
    assert form.coefficient == pytest.approx(true, rel=1e-10) and form.side == 1
    count = len(form.null) // 2
    assert np.allclose(form.null[:count] / form.null[count:], late, rtol=1e-9, atol=0)
    assert form.consequence == "jump" and form.criticality == "" and np.isnan(form.rate) and form.depths == ()


@pytest.fixture(scope="module")
def lone():
    """Branches of the motions that hit one wall: along the amplitude, and strongly damped along the frequency."""

    def along(name, bounds, amplitude, frequency, damping, restitution, wall):
        scene = jv.make_scene(amplitude, frequency, damping, restitution, (None, wall))
        return jv.follow(jv.find_orbit(scene, jv.State(-0.5, 0.0)), name, bounds)

    damped = along("frequency", (1.0, 4.0), 3.7, 3.2, 1.2, 0.62, 0.68)
    return {"soft": along("amplitude", (0.05, 4.0), 2.0, 2.1, 0.2, 0.6, 0.8), "jump": damped}


@pytest.mark.parametrize("consequence, critical", [("soft", "supercritical"), ("jump", "subcritical")])
def test_period_doublings_of_one_impact(lone, consequence, critical):
    (point,) = (one for one in lone[consequence].points("PD") if one.label == "P101")
    form = point.normal_form
    assert (form.consequence, form.criticality) == (consequence, critical)
    assert form.coefficient == pytest.approx(reference_bend(point), rel=1e-10)


def test_coefficients_vanish_where_the_side_changes():
    """At the frequencies of GPD and DSB that `test_locus` has in 20 digits."""

    def breaking(frequency):
        scene = jv.make_scene(2.0, frequency, GAMMA, R, (-1.0, 1.0))
        return jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.0, 2.0)).points("SB")[0]

    found = [breaking(frequency).normal_form for frequency in (0.85, 0.87811842201733201397, 0.9)]
    assert [one.criticality for one in found[::2]] == ["supercritical", "subcritical"]
    assert abs(found[1].coefficient) < 1e-8 * min(abs(one.coefficient) for one in found[::2])
    lopsided = jv.switch(breaking(0.94613199424931461124), (0.4, 0.65))[0]
    assert abs(only(lopsided, "PD").coefficient) < 1e-9


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


@pytest.fixture(scope="module")
def moving():
    """P111 with a wall that moves, and restitutions of their own."""
    walls = jv.Wall(-0.46, 0.6), jv.Wall(1.15, motion=jv.Motion(0.145, 5.53, 2))
    scene = jv.make_scene(3.15, 2.5, 0.11, 0.55, walls)
    return jv.follow(jv.find_orbit(scene, jv.State(0.7, 1.8)), "frequency", (1.6, 3.2))


def test_the_consequence_of_a_grazing_is_that_of_the_stable_orbits(branch, lopsided, moving):
    for point in (branch.points("GR")[0], lopsided.points("GR")[0], *moving.points("GR")):
        sides = {float(one.scene.parameter(point.name)) > point.value for one in point.meets if one.stable}
        assert len(sides) == 1 and point.normal_form.consequence == "jump"
    point = branch.points("GR")[0]
    free, hitting = sorted(point.joins, key=lambda one: len(one.times))
    beyond = free._replace(value=2.0 * point.value - free.value)
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


def flown(scene, x, v, phase, time):
    """(x, v) of the driven oscillator a time later or earlier, without walls: by its closed form."""
    omega, gamma, force = (float(each) for each in (scene.frequency, scene.damping, scene.amplitude))
    z = force / (1.0 - omega**2 + 2j * gamma * omega) * np.exp(1j * phase)
    roots = np.roots([1.0, 2.0 * gamma, 1.0]).astype(complex)
    a = np.linalg.solve(np.array([[1.0, 1.0], roots]), [x - z.real, v - (1j * omega * z).real])
    e, z = a * np.exp(roots * time), z * np.exp(1j * omega * time)
    return e.sum().real + z.real, (roots * e).sum().real + (1j * omega * z).real


def test_a_soft_wall_that_moves_changes_the_velocity_at_once():
    """Where the motion without impacts touches it, as it would a rigid one: a period that begins there with a depth, by
    certified flights, brought back to its begin without the wall."""
    motion = jv.Motion(0.2, 0.5)
    scene = jv.make_scene(0.3, 0.7, 0.05, 0.7, (None, jv.Wall(1.0, motion=motion)))
    point = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.1, 2.0), stop="GR").points("GR")[0]
    wall = jv.Wall(1.0, stiffness=20.0, damping=0.6, motion=motion)
    soft = jv.make_scene(point.value, 0.7, 0.05, 0.7, (None, wall))
    (grazing,) = grazing_jumps(soft, *set_up_equations(soft, "amplitude", point.spot), 1.0)
    phases = np.linspace(0.0, 2.0 * np.pi, 4001)
    z = point.value / (1.0 - 0.7**2 + 2j * 0.05 * 0.7)
    gaps = 1.0 + 0.2 * np.cos(phases + 0.5) - (z * np.exp(1j * phases)).real
    near = phases[np.argmin(gaps)] + np.array([-2e-3, 0.0, 2e-3])
    rates = -0.2 * np.sin(near + 0.5) - (1j * z * np.exp(1j * near)).real
    phase = np.interp(0.0, rates, near)
    position, velocity = 1.0 + 0.2 * np.cos(phase + 0.5), -0.14 * np.sin(phase + 0.5)

    def jump(h):
        back = 2.0  # the period ends before the wall is touched again
        start = flown(soft, position + h * h, velocity, phase, -back)
        end, impacts = jv.strobe(soft, jv.State(*start, phase - 0.7 * back))
        assert impacts.count == 1
        _, v = flown(soft, float(end.x), float(end.v), phase - 0.7 * back, back - 2.0 * np.pi / 0.7)
        return abs(v - velocity) / h

    values = [jump(0.02 * 0.5**k) for k in range(6)]
    for order in range(1, 6):  # the limit of a series in h
        values = [(2.0**order * b - a) / (2.0**order - 1.0) for a, b in pairwise(values)]
    assert values[0] == pytest.approx(grazing.root, rel=1e-5)


def test_orbits_that_are_unstable_on_both_sides_are_harmless():
    """No scene with damping has one, so the rule is asked alone."""
    found = Unfolding(0.5, np.ones(2), -1.0)
    told = [
        forms.normal_form_of_unfolding(kind, found, stable) for kind in ("SN", "PD", "SB") for stable in (True, False)
    ]
    assert [one.consequence for one in told] == ["jump", "harmless", "soft", "harmless", "jump", "harmless"]
    assert forms.normal_form_of_unfolding("PD", found._replace(coefficient=np.nan), True) is None


def same(one, other):
    """Whether two normal forms have the same bits."""
    return repr(forms.normal_form_fields(one)) == repr(forms.normal_form_fields(other))


def test_files_have_them(lopsided, tmp_path):
    lopsided.save(tmp_path / "new.nc")
    loaded = jv.load_branch(tmp_path / "new.nc")
    assert all(same(a.normal_form, b.normal_form) for a, b in zip(lopsided.special, loaded.special, strict=True))
    assert loaded.points("PD")[0].saved is not None and lopsided.points("PD")[0].saved is None
    assert loaded.table() == lopsided.table()
    data = jv.load_data(tmp_path / "new.nc")
    old = dict(data.attrs)
    del old["normal_forms"]
    (tmp_path / "old.nc").write_bytes(netcdf_bytes(data.assign_attrs().drop_attrs().assign_attrs(old)))
    before = jv.load_branch(tmp_path / "old.nc")
    assert before.points("PD")[0].saved is None and before.table() == lopsided.table()


@pytest.mark.parametrize("change", ['"soft"', '"supercritical"', "["])
def test_normal_forms_that_cannot_be_are_refused(lopsided, tmp_path, change):
    lopsided.save(tmp_path / "new.nc")
    data = jv.load_data(tmp_path / "new.nc")
    text = data.attrs["normal_forms"]
    assert change in text
    wrong = text.replace(change, {"[": "[null, "}.get(change, '"much"'), 1)
    (tmp_path / "wrong.nc").write_bytes(netcdf_bytes(data.assign_attrs(normal_forms=wrong)))
    with pytest.raises(jv.ArgumentError, match="must be a file of Branch"):
        jv.load_branch(tmp_path / "wrong.nc")


def test_other_kinds_have_none(branch):
    assert all(one.normal_form is None for one in branch.points("EP"))
    assert branch.table().splitlines()[1].split()[-2:] == ["-", "-"]
    wrong = replace(branch.points("EP")[0], kind="GR")
    assert wrong.normal_form is None  # it touches no wall
