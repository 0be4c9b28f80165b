"""Pictures in physical units are those in the scene's own, each axis multiplied by what its label says."""

from functools import partial

import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxvibro as jv
from tests.test_units import rig

SCENE = rig(frequency_hz=82.0)
LENGTH, PACE = 1e3 * 0.5e-3, 0.5e-3 * np.sqrt(3e4 / 0.5)  # mm and m/s that one of the scene's is
HERTZ, SECONDS, NEWTONS = np.sqrt(3e4 / 0.5) / (2 * np.pi), 1.0 / np.sqrt(3e4 / 0.5), 3e4 * 0.5e-3
TURNS = float(SCENE.frequency) / (2 * np.pi)
PLAIN = jv.State(0.3, 0.2)


def motion():
    return jv.simulate(SCENE, PLAIN, 2, 50)


def orbit():
    return jv.find_orbit(SCENE, jv.State(0.9, -1.1))


def exponents():
    return jv.spectrum(SCENE, "frequency", [2.0, 2.1], PLAIN, settle=50, error=0.1, most=2**10)


def near():
    return jv.margin(orbit(), {"amplitude": 1.0, "frequency": 0.1}, directions=8)


# what draws, the record, and the unit in the label of each axis with the size of the scene's unit in it
PICTURES = {
    "portrait": (lambda one, **more: jv.plot.portrait(one, SCENE, **more), motion, ("(mm)", LENGTH), ("(m/s)", PACE)),
    "trace": (
        lambda one, **more: jv.plot.trace(one, SCENE, **more),
        motion,
        ("(s)", SECONDS / TURNS),
        ("(mm)", LENGTH),
    ),
    "orbit": (jv.plot.orbit, orbit, ("(mm)", LENGTH), ("(m/s)", PACE)),
    "right": (
        partial(jv.plot.section, which="right"),
        lambda: jv.sections(SCENE, PLAIN, 20, 5),
        ("pi", 1.0),
        ("(m/s)", PACE),
    ),
    "sigma": (jv.plot.section, lambda: jv.sections(SCENE, PLAIN, 20, 5), ("(mm)", LENGTH), ("(m/s)", PACE)),
    "spectrum": (jv.plot.spectrum, exponents, ("(Hz)", HERTZ), ("period", 1.0)),
    "basins": (
        jv.plot.basins,
        lambda: jv.basins(SCENE, *[np.linspace(-0.9, 0.9, 9)] * 2),
        ("(mm)", LENGTH),
        ("(m/s)", PACE),
    ),
    "margin": (jv.plot.margin, near, ("(N)", NEWTONS), ("(Hz)", HERTZ)),
}


@pytest.mark.parametrize("kind", PICTURES)
def test_a_picture_in_physical_units(kind):
    draw, make, *axes = PICTURES[kind]
    record = make()
    own, physical = (draw(record, ax=Figure().subplots(), units=units) for units in ("scene", "physical"))
    for told, (text, _) in zip((physical.get_xlabel(), physical.get_ylabel()), axes, strict=True):
        assert told.endswith(text) or text in told
    assert len(own.lines) == len(physical.lines) > 0
    for line, other in zip(own.lines, physical.lines, strict=True):
        for data, found, (_, size) in zip(line.get_data(), other.get_data(), axes, strict=True):
            if line.get_transform() == own.transData:
                np.testing.assert_allclose(found, size * np.asarray(data), rtol=1e-13)
    for limits, found, (_, size) in zip(
        (own.get_xlim(), own.get_ylim()), (physical.get_xlim(), physical.get_ylim()), axes, strict=True
    ):
        np.testing.assert_allclose(found, size * np.asarray(limits), rtol=1e-9)


def test_marks_in_a_diagram_in_physical_units():
    found = jv.find_attractors(SCENE, starts=20)
    ax = Figure().subplots()
    jv.plot.mark(found, 30.0, "v", ax, "physical")
    jv.plot.mark_orbits([orbit()], 30.0, "x", ax, "physical")
    marks = [line.get_xydata() for line in ax.lines if line.get_marker() not in ("", "None")]
    np.testing.assert_allclose(marks[0][:, 1], PACE * found[0].points[:, 1], rtol=1e-14)
    assert marks[-1][0, 1] == pytest.approx(LENGTH * float(orbit().state.x), abs=1e-9)
    with pytest.raises(jv.ArgumentError, match="units: physical units need scales"):
        jv.plot.mark(jv.find_attractors(jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0)), 5), 2.0, units="physical")
