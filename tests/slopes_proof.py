"""The strobe's derivatives held against differences of exact replays.

`python -m tests.slopes_proof first 100` prints errors of the first derivatives, `... higher 100` of the second and the
third. Two more words may follow: the ways, "f,r" or "ff,rf,fff" for instance, and the number of periods.
"""

import sys
from collections import defaultdict

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro as jv
from tests.proof import STRUCTURES, gather, scene_of
from tests.reference import slopes

WAYS = {"f": jax.jacfwd, "r": jax.jacrev}
FASTER = 0.05  # higher derivatives are compared where every impact is faster than this
HIGHER = ((0, 0), (1, 2))  # and for these structures, as each takes minutes to compile
DIRECTIONS = 4


def ends(scene, periods, slots):
    """The function of one draw's numbers (in the reference's order) to x and v at the end, impact times and speeds."""
    form = jax.tree.structure(scene)

    def end(numbers):
        x, v, phase, gamma, omega, amplitude, *walls = numbers  # the walls' own stand in the scene's order already
        scene = form.unflatten([amplitude, omega, gamma, jnp.asarray(0.5), *walls])
        last, impacts = jv.strobe(scene, jv.State(x, v, phase), periods, slots)
        return jnp.concatenate([jnp.stack([last.x, last.v]), impacts.time, impacts.speed])

    return end


def first_errors(count, seed=0, kinds=STRUCTURES, ways="fr", periods=1):
    """{(way, what): errors of the draws}; what is "state", the name of another number, or "impacts".

    state: of d(x, v)/d(x, v), over record.product. A number: of d(x, v) by it, over the largest of that column, 1
    and product * scale. impacts: of the times and speeds by every number, over the same with their own rows in the
    column.
    """
    errors = defaultdict(list)
    for members in gather(count, seed, kinds, periods)[0]:
        drawn, records = zip(*members, strict=True)
        slots = max(record.count for record in records)
        run = ends(scene_of([draw.scene for draw in drawn]), periods, slots)
        points = jnp.array([slopes.numbers(draw) for draw in drawn])
        true = np.array([_filled(slopes.jacobian(draw, record, periods), slots) for draw, record in members])
        for way in ways:
            found = np.asarray(jax.jit(jax.vmap(WAYS[way](run)))(points))
            for what, values in _first(found, true, records, slopes.names(drawn[0].scene)):
                errors[way, what] += list(values)
    return {key: np.array(values) for key, values in errors.items()}


def _filled(rows, slots):
    """The reference's rows with zeros for slots that stay empty: their inf and 0 are constants."""
    times, speeds = np.zeros((2, slots, rows.shape[1]))
    count = (len(rows) - 2) // 2
    times[:count], speeds[:count] = rows[2 : 2 + count], rows[2 + count :]
    return np.concatenate([rows[:2], times, speeds])


def _first(found, true, records, names):
    """Pairs (what, errors of the draws) of one structure."""
    far, size = abs(found - true), abs(true)
    product = np.array([record.product for record in records])
    floor = np.maximum(1, product * [record.scale for record in records])[:, None]
    yield "state", far[:, :2, :2].max((1, 2)) / product
    over = far[:, :2].max(1) / np.maximum(size[:, :2].max(1), floor)
    yield from zip(names[2:], over.T[2:], strict=True)
    yield "impacts", (far[:, 2:].max(1, initial=0) / np.maximum(size.max(1), floor)).max(1)


def higher_errors(count, seed=0, kinds=HIGHER, ways=("ff", "rf", "fff"), periods=1):
    """{way: array (draws, 2)} for d^k/ds^k of (x, v) along random directions, k letters: the innermost is the first.

    Columns: the largest error over the largest derivative of a few directions; what one rounding of every number does
    to that derivative, by the next higher order, over the same: an error that no method can be blamed for.
    """
    errors = defaultdict(list)
    for members in gather(count, seed, kinds, periods, FASTER)[0]:
        slots = max(record.count for _, record in members)
        run = ends(scene_of([draw.scene for draw, _ in members]), periods, slots)
        points = np.array([slopes.numbers(draw) for draw, _ in members])
        directions = np.random.default_rng(seed).normal(size=(len(members), DIRECTIONS, points.shape[1]))
        lanes = np.repeat(points, DIRECTIONS, axis=0), directions.reshape(-1, points.shape[1])
        orders = {k for way in ways for k in (len(way), len(way) + 1)}
        known = {order: _directional(members, directions, order, periods) for order in orders}
        for way in ways:
            true, next_one = known[len(way)], known[len(way) + 1]
            found = np.asarray(jax.jit(jax.vmap(_along(run, way)))(*lanes)).reshape(true.shape)
            size, far = (abs(each).max((1, 2)) for each in (true, found - true))
            rounding = np.finfo(float).eps * abs(next_one).max((1, 2))
            errors[way] += list(np.transpose([far, rounding] / size))
    return {way: np.array(rows) for way, rows in errors.items()}


def _along(run, way):
    """The function of a point and a direction to the derivative of x and v along it, taken in a way."""

    def along(point, direction):
        def line(s):
            return run(point + s * direction)[:2]

        for letter in way:
            line = WAYS[letter](line)
        return line(0.0)

    return along


def _directional(members, directions, order, periods):
    """The reference's derivatives: (draws, directions, 2)."""
    return np.array(
        [
            [slopes.directional(draw, record, direction, order, periods) for direction in own]
            for (draw, record), own in zip(members, directions, strict=True)
        ]
    )


def main(what, count, ways=None, periods=1):
    """Print the largest errors."""
    jax.config.update("jax_enable_x64", True)
    named = {} if ways is None else {"ways": ways.split(",")}
    if what == "first":
        for (way, name), values in sorted(first_errors(count, periods=periods, **named).items()):
            print(f"first {way} {name}: {len(values)} draws, largest error {values.max():.3g}", flush=True)
    if what == "higher":
        for way, rows in higher_errors(count, periods=periods, **named).items():
            error, floor = rows.T
            print(f"higher {way}: {len(rows)} draws, largest error {error.max():.3g}, middle {np.median(error):.3g},")
            print(f"    over what one rounding does: largest {(error / floor).max():.3g}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), *sys.argv[3:4], *map(int, sys.argv[4:5]))
