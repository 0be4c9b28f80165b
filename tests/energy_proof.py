"""What rounding does to the energy of elastic impacts: `python -m tests.energy_proof [impacts [scenes]]`.

Nothing drives the mass, nothing damps it, and walls that stand still give all of its speed back: its energy is that of
the start. Printed is by how much of itself it has changed after ever more impacts, the root mean square over scenes
with walls anywhere and the largest, and the slope: 1/2 where roundings are as likely up as down, 1 where each turn
around has the same ones, as it has here.
"""

import sys

import jax
import numpy as np

import jaxvibro as jv


def scenes(count, rng):
    """(scenes of one wall or two, the other out of reach; speeds at x = 0)."""
    speed = rng.uniform(1.0, 20.0, count)
    near, far = rng.uniform(-0.9, 0.9, count) * speed, rng.uniform(0.05, 1.5, count) * speed
    side = rng.random(count) < 0.5
    left, right = np.where(side, near - far, -near), np.where(side, near, far - near)
    left, right = np.minimum(left, -0.01 * speed), np.maximum(right, 0.01 * speed)
    return jv.make_scene(0.0, rng.uniform(0.5, 3.0, count), 0.0, 1.0, (left, right)), speed


def main(impacts=1_000_000, count=64, seed=4):
    """Prints the table."""
    scene, speed = scenes(count, np.random.default_rng(seed))
    state, done, total = jv.State(np.zeros(count), speed), 0, np.zeros(count)
    rate = np.asarray(jv.strobe(scene, state, 20, 0)[1].count) / 20.0
    due, rows = 100, []
    while due <= impacts:
        periods = int(np.ceil(due / np.median(rate[rate > 0])))
        state, told = jv.strobe(scene, state, periods - done, 0)
        done, total = periods, total + np.asarray(told.count)
        hit = total > 0
        off = abs((np.asarray(state.x) ** 2 + np.asarray(state.v) ** 2) / speed**2 - 1.0)[hit]
        rows.append((np.median(total[hit]), np.sqrt(np.mean(off**2)), off.max()))
        print(f"{rows[-1][0]:>12,.0f} impacts in {hit.sum()} scenes: {rows[-1][1]:.2g}, at most {rows[-1][2]:.2g}")
        due *= 10
    number, spread, _ = np.log(np.array(rows).T)
    print(f"slope {np.polyfit(number, spread, 1)[0]:.2f}")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(*(int(each) for each in sys.argv[1:]))
