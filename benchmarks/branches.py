"""What a branch costs: a point of P111 with multipliers and all monitors, one by one and under vmap; and SciPy's."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro
from benchmarks import harness, ours, page, scipy_arclength
from continuation import arclength
from jaxvibro.branches.follow import polish_orbit
from jaxvibro.compiled.compiler_hints import OPTIONS
from jaxvibro.problem import diagnostics
from jaxvibro.problem.equations import IMPACTS
from jaxvibro.problem.touches import scales

LANES, STEPS, POINTS = 1_000, 32, 8
FINE, COARSE = 0.005, 0.1  # largest steps
POINT = {"SN": 60, "PD": 150, "SB": 150, "GR": 40}  # microseconds asked of a point of a locus


def compare(rounds):
    """Lines (what, asked, measured), all of P111 from A = 2 on, at figure 4's values."""
    orbit = jaxvibro.find_orbit(ours.scene(2.0), jaxvibro.State(0.9, -1.1))
    fine, coarse = (lambda step=step: followed(orbit, step) for step in (FINE, COARSE))
    first, _ = harness.clock(coarse)
    fine()
    own, whole, ratios = [], [], []
    for _ in range(rounds):
        spent, branch = harness.clock(fine)
        own.append(1e6 * spent / len(branch))
        whole.append(1e3 * harness.clock(coarse)[0])
        rival, _ = harness.clock(lambda: scipy_arclength.branch(POINTS))
        ratios.append(1e6 * rival / POINTS / own[-1])
    return [
        ("a point of P111, multipliers and monitors, microseconds", "at most 20", spread(own)),
        (f"that branch at steps of {COARSE}, specials located, milliseconds in all", "(to be printed)", spread(whole)),
        ("SciPy's arclength shooting over ours, a point", "at least 500", spread(ratios)),
        ("first call of follow, s", "(to be printed)", f"{first:.1f}"),
        many(orbit, rounds),
        *loci(orbit, rounds),
    ]


def loci(orbit, rounds):
    """Lines for a point of a locus, amplitude and frequency: all of `jaxvibro.locus` over the number of its points."""
    branch = jaxvibro.follow(orbit, "amplitude", (0.0, 6.0))
    lopsided = jaxvibro.switch(branch.points("SB")[0])[1]
    bounds = {"amplitude": (0.0, 12.0), "frequency": (1.2, 3.0)}
    found = []
    asked = [(branch, "SN"), (branch, "SB"), (branch, "GR"), (lopsided, "SN"), (lopsided, "PD"), (lopsided, "GR")]
    for start, kind in asked:
        (point, *_), spent = start.points(kind), []
        locus = jaxvibro.locus(point, tuple(bounds), bounds, largest_step=FINE)
        for _ in range(rounds):
            seconds, locus = harness.clock(partial(jaxvibro.locus, point, tuple(bounds), bounds, largest_step=FINE))
            spent.append(1e6 * seconds / len(locus))
        what = f"a point of the locus of {kind} of {locus.label}, all included, microseconds"
        found.append((what, f"at most {POINT[kind]}", spread(spent)))
    return found


def spread(values):
    """Median and quartiles as text."""
    return page.spread(harness.spread(np.array(values)))


def followed(orbit, step):
    """P111 to A = 6."""
    return jaxvibro.follow(orbit, "amplitude", (0.6, 6.0), "forward", step, step)


def many(orbit, rounds):
    """The line for branches that start at as many amplitudes, under vmap: tracked, then every point looked at."""
    along, z = polish_orbit(orbit, "amplitude")
    scale = scales(along, 1.0)
    numbers = (jnp.asarray(each) for each in (1e-8, 0.1, 1e-10, 0.0, 1e3))
    control = arclength.Control(jnp.asarray(scale), *numbers)
    begun = jaxvibro.follow(orbit, "amplitude", (1.5, 2.5), "both", 0.01, 0.001)
    places = np.linspace(0, len(begun) - 1, LANES).astype(int)
    data = begun.data.isel(point=places)

    def columns(*names):
        return np.concatenate([np.reshape(data[name].values, (LANES, -1)) for name in names], axis=1)

    zs, tangents = columns("time", "speed", "amplitude"), columns("time_slope", "speed_slope", "value_slope")
    assert zs.shape[1] == len(z)
    start = arclength.Place(zs, tangents, np.full(LANES, 0.05), np.zeros(LANES, np.int32))

    def one(place, along):
        _, points = arclength.track(IMPACTS.function, IMPACTS.solve, place, control, along, STEPS)
        return points.kept, jax.vmap(lambda z: diagnostics.hitting(along, z, 1))(points.z)

    call = jax.jit(jax.vmap(one, in_axes=(0, None)), compiler_options=OPTIONS)
    jax.block_until_ready(call(start, along))
    spent = []
    for _ in range(rounds):
        seconds, (kept, _) = harness.clock(lambda: jax.block_until_ready(call(start, along)))
        spent.append(1e6 * seconds / float(kept.sum()))
    return (f"{LANES:,} branches under vmap, with monitors, microseconds a point", "at most 6", spread(spent))
