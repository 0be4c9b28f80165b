"""Pictures in physical units are those in the scene's own, each axis multiplied by what its label says."""

from functools import partial

import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro import plot
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


# what draws, of what, and what a number of the scene is in the units of each axis' label
PICTURES = {
    "portrait": (lambda one, **more: plot.portrait(one, SCENE, **more), motion, ("(mm)", LENGTH), ("(m/s)", PACE)),
    "trace": (lambda one, **more: plot.trace(one, SCENE, **more), motion, ("(s)", SECONDS / TURNS), ("(mm)", LENGTH)),
    "orbit": (plot.orbit, orbit, ("(mm)", LENGTH), ("(m/s)", PACE)),
    "right": (
        partial(plot.section, which="right"),
        lambda: jv.sections(SCENE, PLAIN, 20, 5),
        ("pi", 1.0),
        ("(m/s)", PACE),
    ),
}
SLOW = {
    "sigma": (plot.section, lambda: jv.sections(SCENE, PLAIN, 20, 5), ("(mm)", LENGTH), ("(m/s)", PACE)),
    "spectrum": (plot.spectrum, exponents, ("(Hz)", HERTZ), ("period", 1.0)),
    "basins": (
        plot.basins,
        lambda: jv.basins(SCENE, *[np.linspace(-0.9, 0.9, 9)] * 2),
        ("(mm)", LENGTH),
        ("(m/s)", PACE),
    ),
}
LONG = {"margin": (plot.margin, near, ("(N)", NEWTONS), ("(Hz)", HERTZ))}
MARKED = [
    *PICTURES,
    *(pytest.param(kind, marks=pytest.mark.slow) for kind in SLOW),
    *(pytest.param(kind, marks=pytest.mark.long) for kind in LONG),
]


@pytest.mark.parametrize("kind", MARKED)
def test_a_picture_in_physical_units(kind):
    draw, made, *axes = (PICTURES | SLOW | LONG)[kind]
    one = made()
    own, physical = (draw(one, ax=Figure().subplots(), units=units) for units in ("scene", "physical"))
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
    plot.mark(found, 30.0, "v", ax, "physical")
    plot.mark_orbits([orbit()], 30.0, "x", ax, "physical")
    marks = [line.get_xydata() for line in ax.lines if line.get_marker() not in ("", "None")]
    np.testing.assert_allclose(marks[0][:, 1], PACE * found[0].points[:, 1], rtol=1e-14)
    assert marks[-1][0, 1] == pytest.approx(LENGTH * float(orbit().state.x), abs=1e-9)
    with pytest.raises(jv.ArgumentError, match="units: physical units need scales"):
        plot.mark(jv.find_attractors(jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0)), 5), 2.0, units="physical")
