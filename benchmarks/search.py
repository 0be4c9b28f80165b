"""A search along gradients beside searches without: `python -m benchmarks.search 200` prints boundaries a second.

All begin with the same orbits, those that random scenes of a box settle on, and look for the same test to vanish. A
random search looks at scenes drawn from the box, Nelder and Mead's at the test's size, each with the orbit solved anew
from the seed's impacts; a boundary is met where the test is a thousandth of the seed's and its orbit one. All are given
as many orbits to solve as the search along gradients took, in lanes where the method has lanes.
"""

import sys
import time
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize

import jaxvibro as jv
from continuation.branch_segment import UNLIMITED
from continuation.implicit_function import make_lane_loop_function
from jaxvibro.compiled.kernel_calls import call_as_kernel
from jaxvibro.contact.kinds import flow_coefficients
from jaxvibro.design import search as ours
from jaxvibro.design.bifurcation_gradients import FLIP, FOLD
from jaxvibro.design.free_parameters import FreeParameters, bounds_of_changes
from jaxvibro.design.parameter_rays import bifurcation_test_values, sequence_at
from jaxvibro.orbits import impact_equations
from jaxvibro.orbits.impact_equations import ImpactSequence

FREE = {"amplitude": 1.0, "frequency": 0.5}
BOUNDS = {"amplitude": (0.5, 6.0), "frequency": (1.5, 3.0)}
KINDS = {"PD": FLIP, "SN": FOLD}
NEAR = 1e-3  # of the seed's test
SOLVES = 40  # orbits that a ray solves, about


@partial(jax.jit, static_argnums=0)
def _tested(tree, cycle, numbers):
    def one(cycle, numbers):
        scene = tree.unflatten(list(numbers))
        found, frame = impact_equations.solve_sequence(scene, cycle), flow_coefficients(scene)
        tests = bifurcation_test_values(frame, sequence_at(cycle, found.unknowns), found.unknowns)
        real = (found.status == 0) & (tests[2] > 0) & (tests[3] > 0)
        return jnp.where(real, tests, jnp.nan)

    return jax.vmap(make_lane_loop_function(one_kernel_of(one)), in_axes=(None, 0))(cycle, numbers)


def one_kernel_of(function):
    return lambda *arrays: call_as_kernel(function, *arrays)


def compared(kind, starts, seed=0):
    """{method: (the itineraries of the boundaries met, seconds, orbits solved)} of a kind."""
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    parameters = FreeParameters(scene, FREE, *bounds_of_changes(scene, FREE, BOUNDS))
    room = parameters.lower, parameters.upper
    seeds = [
        one
        for one in ours._limit_per_itinerary(ours._settled_orbit_seeds(parameters, starts, 2, seed))
        if len(one.impacts[0])
    ]
    tree, base, marks = parameters.scene_space()
    test, told = KINDS[kind], {}
    for _ in range(2):  # the second is warm
        begun = time.process_time()
        places, rays, _ = ours._follow_rays_from_seeds(parameters, seeds, (kind,), UNLIMITED)
        words = [ours._itinerary_key(one.orbit_seed) for one in places]
        told["gradient"] = words, time.process_time() - begun, rays * SOLVES
    each = max(1, rays * SOLVES // len(seeds))
    rng = np.random.default_rng(seed)
    draws = [room[0] + (room[1] - room[0]) * rng.random((each, len(FREE))) for _ in seeds]
    cycles = [
        ImpactSequence(*map(jnp.asarray, one.impacts), jnp.zeros(()), jnp.asarray(float(one.periods))) for one in seeds
    ]
    own = [
        float(_tested(tree, c, (base + one.offset @ marks)[None])[0, test])
        for one, c in zip(seeds, cycles, strict=True)
    ]

    def random(k):
        values = np.asarray(_tested(tree, cycles[k], base + draws[k] @ marks))[:, test]
        return np.nanmin(abs(values), initial=np.inf) < NEAR * abs(own[k]), each

    def simplex(k):
        def size(offset):
            if ((offset < room[0]) | (offset > room[1])).any():
                return 1e6
            value = abs(float(_tested(tree, cycles[k], (base + offset @ marks)[None])[0, test]))
            return value if np.isfinite(value) else 1e6

        found = minimize(size, seeds[k].offset, method="Nelder-Mead", options={"maxfev": each, "fatol": 0.0})
        return found.fun < NEAR * abs(own[k]), found.nfev

    for label, method in (("random", random), ("Nelder and Mead", simplex)):
        for k in {len(one.impacts[0]): k for k, one in enumerate(seeds)}.values():
            method(k)  # compiled
        begun, met, solved = time.process_time(), [], 0
        for k, one in enumerate(seeds):
            good, count = method(k)
            solved += count
            if good:
                met.append(ours._itinerary_key(one))
        told[label] = met, time.process_time() - begun, solved
    return told


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    for kind in KINDS:
        found = compared(kind, int(sys.argv[1]))
        rate = len(found["gradient"][0]) / found["gradient"][1]
        for label, (met, seconds, solved) in found.items():
            ratio = rate * seconds / len(met) if met else np.inf
            told = f"{len(met)} times a boundary, of {len(set(met))} itineraries, {solved} orbits, {seconds:.2f} s"
            print(f"{kind} {label}: {told}; boundaries a second, ours over these: {ratio:.3g}", flush=True)
