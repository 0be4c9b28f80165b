"""Invalid arguments of studies of attractors are refused before any computation, with the argument and the rule."""

import inspect
from functools import cache

import numpy as np
import pytest

import jaxvibro as jv

SCENE, START = jv.make_scene(4.65, 2.1, 0.05, 0.7, (-1.0, 1.0)), jv.State(0.9, -1.1)
BATCH = jv.make_scene(np.array([1.0, 2.0]), 2.1, 0.05, 0.7, (-1.0, 1.0))
ROW = {"scene": SCENE, "name": "amplitude", "values": [1.0, 2.0]}
VALID = {
    jv.find_attractors: {"scene": SCENE},
    jv.spectrum: ROW | {"state": START, "progress": pytest.fail},
    jv.sweep: ROW | {"state": START, "progress": pytest.fail},
    jv.fractions: ROW,
    jv.map_parameters: {"scene": SCENE, "grid": {"frequency": [1.0, 2.0]}},
    jv.basins: {"scene": SCENE, "x": [0.0, 1.0], "v": [0.0, 1.0], "attractors": ()},
    jv.manifold: {"kind": "stable"},
    jv.least_shock: {"scene": SCENE},
}
LANES = (
    ({"name": "amplitud"}, "amplitud", "is not a parameter of this scene"),
    ({"values": [1.0, np.nan]}, "amplitude", "must be finite; got nan at index"),
    ({"values": []}, "amplitude", "at least one"),
    ({"name": "frequency", "values": [1.0, 0.0]}, "frequency", "must be greater than 0; got 0.0 at index (1,)"),
    ({"name": "restitution", "values": [0.5, 1.5]}, "restitution", "must lie between 0 and 1; got 1.5"),
    ({"name": "left.motion.phase"}, "left.motion.phase", "is not a parameter of this scene"),
    ({"name": "right.position", "values": [0.5, 3.0]}, "state.x", "must lie between the walls"),
    ({"name": "right.position", "values": [2.0, -1.0]}, "right.position", "must lie to the right of left.position"),
    ({"state": jv.State(np.inf, 0.0)}, "state.x", "must be finite; got inf"),
    ({"state": jv.State(0.0, np.nan)}, "state.v", "must be finite; got nan"),
)
INVALID = {
    jv.find_attractors: [({"scene": BATCH}, "scene", "must be a single scene, not a batch; got ")],
    jv.spectrum: [
        *LANES,
        ({"values": [[1.0, 2.0]]}, "amplitude", "must be a sequence of at least one value"),
        ({"state": jv.State(0.0, [0.0, 1.0, 2.0])}, "state.v", "must broadcast"),
        ({"error": 0.0}, "error", "must be greater than 0; got 0.0"),
        ({"error": np.nan}, "error", "must be finite; got nan"),
        ({"scene": BATCH}, "scene", "must be a single scene"),
    ],
    jv.sweep: [
        *LANES,
        ({"values": [[1.0, 2.0, 3.0]], "state": jv.State(np.array([0.5, 0.2]), 0.0)}, "state.x", "must broadcast"),
    ],
    jv.fractions: [
        ({"name": "amplitud"}, "amplitud", "perhaps amplitude"),
        ({"values": [2.0, 1.0]}, "amplitude", "increasing order"),
        ({"values": [1.0, 1.0]}, "amplitude", "increasing order"),
        ({"values": []}, "amplitude", "increasing order"),
        ({"values": [1.0, np.nan]}, "amplitude", "finite"),
        ({"name": "restitution", "values": [0.5, 1.5]}, "restitution", "between 0 and 1"),
        ({"scene": BATCH}, "scene", "must be a single scene"),
    ],
    jv.map_parameters: [
        ({"grid": {}}, "grid", "must be a mapping {name: values}"),
        ({"grid": {"omega": [1.0]}}, "omega", "is not a parameter of this scene, perhaps frequency"),
        ({"grid": {"frequency": [2.0, 1.0]}}, "frequency", "must be one or more numbers in increasing order"),
        ({"grid": {"frequency": [1.0, np.nan]}}, "frequency", "must be finite"),
        ({"grid": {"restitution": [0.5, 1.5]}}, "restitution", "between 0 and 1"),
        ({"start": 0}, "start", "must be a whole number from 1 on"),
        ({"start": jv.State(3.0, 0.0)}, "state.x", "must lie between the walls at each cell"),
        ({"start": 5, "along": "frequency"}, "start", "must be a State if the motion is carried along a parameter"),
        ({"along": "amplitude"}, "along", "must be a parameter of the grid (frequency)"),
        ({"quantities": ("speed",)}, "quantities", "must be some of label, period"),
        ({"quantities": ("attractors",)}, "quantities", "must not contain attractors if a cell has one initial state"),
    ],
    jv.basins: [
        ({"x": [0.0]}, "x", ""),
        ({"x": [1.0, 0.0]}, "x", ""),
        ({"v": [0.0, np.nan]}, "v", ""),
        ({"phase": np.nan}, "phase", ""),
    ],
    jv.manifold: [
        ({"kind": "centre"}, "kind", ""),
        ({"length": 0.0}, "length", ""),
        ({"spacing": np.nan}, "spacing", ""),
    ],
    jv.least_shock: [
        ({"place": 9}, "place", ""),
        ({"phase": []}, "phase", ""),
        ({"phase": np.nan}, "phase", ""),
        ({"direction": "x"}, "direction", ""),
        ({"reach": 0.0}, "reach", ""),
        ({"scene": BATCH}, "scene", ""),
    ],
}
COUNTS = {"starts": 1, "seed": 0, "settle": 0, "keep": 1, "chunk": 1, "shocks": 1, "patience": 1, "place": 0, "most": 1}
LEAST = {(jv.fractions, "shocks"): 0, (jv.manifold, "most"): 100}


@cache
def computed(function):
    """Return the arguments of a valid call that must be computed."""
    if function is jv.manifold:
        return {"orbit": jv.find_orbit(SCENE, START)}
    return {"attractors": jv.find_attractors(SCENE, 4)} if function is jv.least_shock else {}


@pytest.mark.parametrize(("function", "row"), [(function, row) for function, rows in INVALID.items() for row in rows])
def test_invalid_arguments_are_refused_before_any_computation(function, row):
    change, key, rule = row
    with pytest.raises(jv.ArgumentError) as caught:
        function(**VALID[function] | computed(function) | change)
    assert caught.value.key == key and rule in str(caught.value)


@pytest.mark.parametrize("function", VALID)
def test_counts_below_the_least_are_refused(function):
    for name in COUNTS.keys() & inspect.signature(function).parameters.keys():
        least = LEAST.get((function, name), COUNTS[name])
        with pytest.raises(jv.ArgumentError, match=f"^{name}: must be a whole number .*; got {least - 1}"):
            function(**VALID[function] | computed(function) | {name: least - 1})


@pytest.mark.parametrize("function", VALID)
def test_invalid_limits_of_time_are_refused(function):
    with pytest.raises(jv.ArgumentError, match="max_seconds: must be a positive number"):
        function(**VALID[function] | computed(function) | {"max_seconds": -1.0})
