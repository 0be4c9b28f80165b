"""`sample` held against exact motions over random scenes: `python -m tests.sample_proof 1000` prints numbers.

Rigid walls: states against ball arithmetic over 1e-12 scale (1 + norm of the derivative), derivatives by every number
and by the times, forward and reverse, against differences of exact replays. One scene in ten more has soft walls.
"""

import sys
from collections import defaultdict

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro as jv
from tests.proof import batch, gather, scene_of
from tests.reference import sampled, slopes, soft_draws
from tests.reference.scene import static_scale
from tests.reference.search import Discard, Undecided
from tests.soft_proof import structure as soft_structure

TIMES, PERIODS = 6, 2
CLEAR = 1e-6  # periods that a time keeps from impacts


def times_of(draw, record, seed):
    """Random times of a draw's two periods, away from its impacts: the start and a repeated one among them."""
    rng = np.random.default_rng(seed)
    whole = PERIODS * 2 * np.pi / draw.scene.omega
    hits = np.array([0.0, *(float(time) for time in record.times)])
    while True:
        times = np.sort(rng.uniform(0, whole, TIMES - 1))
        if np.min(abs(times[:, None] - hits)) > CLEAR * whole:
            return np.array([0.0, *times[:-1], times[-2] if rng.random() < 0.3 else times[-1]])


def state_errors(count, seed=0, kinds=None):
    """Errors of x and v over 1e-12 scale (1 + norm), a row a draw, and those of the slopes, over their largest.

    The norm is of the derivative by x and v at each time, and of the strobe's own parts where larger. A slope is
    measured by the largest of its number's, 1 and norm times scale.
    """
    found = []
    for members in gather(count, seed, kinds, PERIODS)[0]:
        drawn, records = zip(*members, strict=True)
        times = np.array([times_of(*member, seed + k) for k, member in enumerate(members)])
        true = np.array([sampled.states(*member, row) for member, row in zip(members, times, strict=True)])
        ways = np.array([sampled.slopes(*member, row) for member, row in zip(members, times, strict=True)])
        scale = np.array([record.scale for record in records])
        norms = np.linalg.norm(ways[..., :2], 2, axis=(2, 3))
        norms = np.maximum(norms, np.array([record.norm for record in records])[:, None])
        state, status = jv.sample(*batch(drawn), times)
        assert np.all(np.asarray(status) == 0)
        far = np.maximum(*(abs(np.asarray(each) - true[..., k]) for k, each in enumerate((state.x, state.v))))
        rows = [(far / (1e-12 * scale[:, None] * (1 + norms))).max(1)]
        for way in (jax.jacfwd, jax.jacrev):
            rows.append(_slope_errors(drawn, times, way, ways, norms * scale[:, None]))
        found.append(np.transpose(rows))
    return np.concatenate(found)


def _slope_errors(drawn, times, way, true, floor):
    """The largest error of each draw's slopes."""
    run = states_of(scene_of([draw.scene for draw in drawn]))
    points = jnp.array([slopes.numbers(draw) for draw in drawn])
    by, late = map(np.asarray, jax.jit(jax.vmap(way(run, argnums=(0, 1))))(points, jnp.array(times)))
    own = np.einsum("akii->aki", late)
    assert np.array_equal(abs(late).sum(-1), abs(own))  # of its own time alone
    found = np.moveaxis(np.concatenate([by, own[..., None]], -1), 1, 2)
    size = np.maximum(abs(true).max((1, 2)), np.maximum(1, floor.max(1))[:, None])
    return (abs(found - true).max((1, 2)) / size).max(1)


def states_of(scene):
    """The function of one draw's numbers (in the references' order) and times to (2, times) of x and v."""
    form = jax.tree.structure(scene)

    def at(numbers, times):
        x, v, phase, gamma, omega, amplitude, *walls = numbers  # the walls' own stand in the scene's order already
        scene = form.unflatten([amplitude, omega, gamma, jnp.asarray(0.5), *walls])
        state, _ = jv.sample(scene, jv.State(x, v, phase), times)
        return jnp.stack([state.x, state.v])

    return at


def soft_errors(count, seed=0):
    """(errors of states alone where one wall at least is soft, at one time each; how many draws were discarded)."""
    groups, discarded, fair = defaultdict(list), 0, 0
    while fair < count:
        draw = soft_draws.draw(seed)
        time = float(np.random.default_rng(seed).uniform(0, 2)) * 2 * np.pi / draw.scene.omega
        seed += 1
        try:
            record = sampled.soft_end(draw, time)
        except (Discard, Undecided):
            discarded += 1
            continue
        fair += 1
        groups[soft_structure(draw.scene)].append((draw, time, record))
    errors = []
    for members in groups.values():
        drawn, times, records = zip(*members, strict=True)
        state, _ = jv.sample(*batch(drawn), np.array(times)[:, None])
        for k, record in enumerate(records):
            far = max(abs(float(record.x - float(state.x[k, 0]))), abs(float(record.v - float(state.v[k, 0]))))
            errors.append(far / (1e-12 * max(record.scale, static_scale(drawn[k].scene)) * (1 + record.norm)))
    return np.array(errors), discarded


def main(count):
    """Print the largest errors."""
    jax.config.update("jax_enable_x64", True)
    rows = state_errors(count)
    for name, errors in zip(("state over its bound", "slopes forward", "slopes reverse"), rows.T, strict=True):
        print(f"{name}: {len(errors)} scenes, largest {errors.max():.3g}, middle {np.median(errors):.3g}", flush=True)
    errors, discarded = soft_errors(max(1, count // 10))
    print(f"soft: {len(errors)} scenes ({discarded} discarded), largest {errors.max():.3g}")


if __name__ == "__main__":
    main(int(sys.argv[1]))
