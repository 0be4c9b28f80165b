"""A mass and a wall, k, c, A, w, d, e = 1, .1, 1, 1, 1, .8: the impact oscillator of the demos of COCO, one of whose
pictures shows a solution that passes through the wall."""

import numpy as np

import jaxvibro as jv


def highest_position(amplitude, times, speeds):
    """Return the largest x of an orbit with these impacts at the wall, by the closed form at 2000 times of a flight."""
    size, phase = amplitude / 0.1, -0.5 * np.pi  # at w = 1
    if not len(times):
        return size
    highest, root = 1.0, np.sqrt(1.0 - 0.05**2)
    ends = np.append(times[1:], times[0] + 2.0 * np.pi * np.ceil((times[-1] - times[0] + 1e-9) / (2.0 * np.pi)))
    for begin, end, speed in zip(times, ends, speeds, strict=True):
        t = np.linspace(0.0, end - begin, 2000)
        x = 1.0 - size * np.cos(begin + phase)
        v = -0.8 * speed + size * np.sin(begin + phase)
        free = np.exp(-0.05 * t) * (x * np.cos(root * t) + (v + 0.05 * x) / root * np.sin(root * t))
        highest = max(highest, (free + size * np.cos(begin + t + phase)).max())
    return highest


def test_no_solution_passes_through_the_wall_and_the_grazing_is_exact():
    scene = jv.make_scene(amplitude=0.05, frequency=1.0, damping=0.05, restitution=0.8, walls=(None, 1.0))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.01, 1.2))
    sides = branch.data["side"].values
    for row, amplitude in enumerate(branch.values):
        times, speeds = (branch.data[key].values[row][sides[row] != 0] for key in ("time", "speed"))
        assert highest_position(amplitude, times, speeds) < 1.0 + 1e-9
    assert 10 < np.any(sides != 0, axis=1).sum() < len(branch)
    grazing = branch.points("GR")[0]
    assert abs(grazing.value - 0.1) < 1e-12
    locus = jv.locus(grazing, ("frequency", "amplitude"), {"frequency": (0.5, 1.5), "amplitude": (0.01, 2.0)})
    frequency, amplitude = locus.values.T
    assert len(locus) > 20 and {frequency.min(), frequency.max()} == {0.5, 1.5}
    assert abs(amplitude - np.sqrt((1.0 - frequency**2) ** 2 + 0.01 * frequency**2)).max() < 1e-10
