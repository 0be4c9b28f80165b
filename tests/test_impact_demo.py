"""One mass and one wall, k, c, A, w, d, e = 1, .1, 1, 1, 1, .8: the impact oscillator that COCO's demos follow, one of
whose pictures shows a solution through the wall."""

import numpy as np
import pytest

import jaxvibro as jv


@pytest.fixture(scope="module")
def branch():
    scene = jv.make_scene(amplitude=0.05, frequency=1.0, damping=0.05, restitution=0.8, walls=(None, 1.0))
    return jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.01, 1.2))


def highest(amplitude, times, speeds):
    """The largest x of an orbit with these impacts at the wall, by the closed form on 2000 times a flight."""
    size, phase = amplitude / 0.1, -0.5 * np.pi  # at w = 1
    if not len(times):
        return size
    best, fast = 1.0, np.sqrt(1.0 - 0.05**2)
    ends = np.append(times[1:], times[0] + 2.0 * np.pi * np.ceil((times[-1] - times[0] + 1e-9) / (2.0 * np.pi)))
    for begin, end, speed in zip(times, ends, speeds, strict=True):
        late = np.linspace(0.0, end - begin, 2000)
        x = 1.0 - size * np.cos(begin + phase)
        v = -0.8 * speed + size * np.sin(begin + phase)
        free = np.exp(-0.05 * late) * (x * np.cos(fast * late) + (v + 0.05 * x) / fast * np.sin(fast * late))
        best = max(best, (free + size * np.cos(begin + late + phase)).max())
    return best


def test_no_solution_goes_through_the_wall(branch):
    (first, *_) = branch.points("GR")
    assert abs(first.value - 0.1) < 1e-12
    hits = 0
    for k in range(len(branch)):
        hit = branch.data["side"].values[k] != 0
        times, speeds = (branch.data[key].values[k][hit] for key in ("time", "speed"))
        hits += int(hit.any())
        assert highest(branch.values[k], times, speeds) < 1.0 + 1e-9
    assert 10 < hits < len(branch)


def test_where_it_grazes(branch):
    bounds = {"frequency": (0.5, 1.5), "amplitude": (0.01, 2.0)}
    found = jv.locus(branch.points("GR")[0], ("frequency", "amplitude"), bounds)
    omega, amplitude = found.values.T
    assert len(found) > 20 and {omega.min(), omega.max()} == {0.5, 1.5}
    assert abs(amplitude - np.sqrt((1.0 - omega**2) ** 2 + 0.01 * omega**2)).max() < 1e-10
