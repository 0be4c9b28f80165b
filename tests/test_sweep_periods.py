"""What a sweep's table says of values at which the recorded states do not come back."""

from types import SimpleNamespace

import numpy as np

import jaxvibro as jv
from jaxvibro.studies import sweep_report
from jaxvibro.studies.sweep_periods import NOT_SETTLED, find_motion_periods, find_sweep_stretches


def swept(scene, values, settle, keep):
    start = jv.State(np.array([0.5]), np.array([0.1]))
    found = jv.sweep(scene, "amplitude", np.array(values)[:, None], start, settle, keep)
    return found.rename(lane="leg").assign_coords(leg=["up"])


def growth(scene, state, periods=300, apart=1e-8):
    """The mean growth rate per period of a small distance between two motions, by plain runs of both."""
    x, v = np.array([state.x, state.x + apart]), np.array([state.v, state.v])
    rates = []
    for _ in range(periods):
        end, _ = jv.strobe(scene, jv.State(x, v))
        x, v = np.array(end.x), np.array(end.v)
        far = np.hypot(x[1] - x[0], v[1] - v[0])
        rates.append(np.log(far / apart))
        x[1], v[1] = x[0] + apart * (x[1] - x[0]) / far, v[0] + apart * (v[1] - v[0]) / far
    return np.mean(rates)


def test_chaos_and_transients_are_told_apart():
    """Between walls at 1 chaos at 6; a linear response that decays like exp(-.015 t) has not settled after 100 periods,
    and has after 400."""
    scene = jv.make_scene(6.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    data = swept(scene, [2.0, 5.6, 6.0], 300, 40)
    assert find_motion_periods(data, scene, 300).ravel().tolist() == [1, 2, 0]
    last = data.isel(step=-1, leg=0, period=-1)
    assert growth(scene, jv.State(float(last["x"]), float(last["v"]))) > 0.1
    linear = jv.make_scene(0.2, 1.3, 0.015, 0.7, (-1.0, 1.0))
    assert find_motion_periods(swept(linear, [0.2, 0.25], 100, 20), linear, 100).ravel().tolist() == [NOT_SETTLED] * 2
    assert find_motion_periods(swept(linear, [0.2, 0.25], 400, 20), linear, 400).ravel().tolist() == [1, 1]


def test_the_words_of_a_table():
    scene = jv.make_scene(0.2, 1.3, 0.015, 0.7, (-1.0, 1.0))
    data = swept(scene, [0.2, 0.25], 10, 6)
    (one,) = find_sweep_stretches(data, scene, 10)  # too few periods were left out to tell
    assert one.periods == 0 and one.motion == "not settled" and one.count == 2
    asked = SimpleNamespace(parameter="amplitude", count=2, settle=10, keep=6)
    found = SimpleNamespace(file=SimpleNamespace(sweep=asked), scene=scene, swept=data, stretches=[one])
    told = "\n".join(sweep_report.sweep_lines(found, "scene"))
    assert "not settled: a transient: more periods must be discarded" in told and " -" not in told
    assert told.splitlines()[2].split() == ["up", "0.2", "0.25", "2", "not", "settled"]
