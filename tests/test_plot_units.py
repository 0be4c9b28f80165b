"""Pictures in physical units are those in the scene's own, each axis multiplied by what its label says."""

from functools import partial

import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxvibro as jv
from tests.scene_files import refusal
from tests.test_units import NATURAL, SPEED, STATE, rig

SCENE = rig(frequency_hz=82.0)
# the unit in the label of an axis, and the size of the scene's unit in it
SIZES = {"(mm)": 0.5, "(m/s)": SPEED, "(s)": 2 * np.pi / float(SCENE.frequency) / NATURAL, "(N)": 3e4 * 0.5e-3}
SIZES |= {"(Hz)": NATURAL / (2 * np.pi), "period": 1.0, "pi": 1.0}


def motion():
    return jv.simulate(SCENE, STATE, 2, 50)


def orbit():
    return jv.find_orbit(SCENE, jv.State(0.9, -1.1))


def section():
    return jv.sections(SCENE, STATE, 20, 5)


def exponents():
    return jv.spectrum(SCENE, "frequency", [2.0, 2.1], STATE, settle=50, error=0.1, most=2**10)


def basins():
    return jv.basins(SCENE, *[np.linspace(-0.9, 0.9, 9)] * 2)


def margin():
    return jv.margin(orbit(), {"amplitude": 1.0, "frequency": 0.1}, directions=8)


def with_scene(draw):
    return lambda record, **options: draw(record, SCENE, **options)


PICTURES = {
    "portrait": (with_scene(jv.plot.portrait), motion, "(mm)", "(m/s)"),
    "trace": (with_scene(jv.plot.trace), motion, "(s)", "(mm)"),
    "orbit": (jv.plot.orbit, orbit, "(mm)", "(m/s)"),
    "right": (partial(jv.plot.section, which="right"), section, "pi", "(m/s)"),
    "sigma": (jv.plot.section, section, "(mm)", "(m/s)"),
    "spectrum": (jv.plot.spectrum, exponents, "(Hz)", "period"),
    "basins": (jv.plot.basins, basins, "(mm)", "(m/s)"),
    "margin": (jv.plot.margin, margin, "(N)", "(Hz)"),
}


@pytest.mark.parametrize("kind", PICTURES)
def test_a_picture_in_physical_units(kind):
    draw, make, *units = PICTURES[kind]
    record, sizes = make(), [SIZES[unit] for unit in units]
    own, physical = (draw(record, ax=Figure().subplots(), units=system) for system in ("scene", "physical"))
    assert units[0] in physical.get_xlabel() and units[1] in physical.get_ylabel()
    assert len(own.lines) == len(physical.lines) > 0
    for line, other in zip(own.lines, physical.lines, strict=True):
        if line.get_transform() == own.transData:
            for data, scaled, size in zip(line.get_data(), other.get_data(), sizes, strict=True):
                np.testing.assert_allclose(scaled, size * np.asarray(data), rtol=1e-13)
    np.testing.assert_allclose(physical.get_xlim(), sizes[0] * np.array(own.get_xlim()), rtol=1e-9)
    np.testing.assert_allclose(physical.get_ylim(), sizes[1] * np.array(own.get_ylim()), rtol=1e-9)


def test_marks_in_a_diagram_in_physical_units():
    attractors = jv.find_attractors(SCENE, starts=20)
    ax = Figure().subplots()
    jv.plot.mark(attractors, 30.0, "v", ax, "physical")
    jv.plot.mark_orbits([orbit()], 30.0, "x", ax, "physical")
    marks = [line.get_xydata() for line in ax.lines if line.get_marker() not in ("", "None")]
    np.testing.assert_allclose(marks[0][:, 1], SPEED * attractors[0].points[:, 1], rtol=1e-14)
    assert marks[-1][0, 1] == pytest.approx(0.5 * float(orbit().state.x), abs=1e-9)
    plain = jv.find_attractors(jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0)), 5)
    assert "physical units need scales" in refusal(jv.plot.mark, plain, 2.0, units="physical")
