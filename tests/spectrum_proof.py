"""`spectrum` held against long runs of another method: `python -m tests.spectrum_proof` prints a table.

The other method is tests/reference/lyapunov.py: NumPy, a grid in time, closed forms, both tangents measured. For each
value many starts, a little apart, are run on; the error is that of the mean over starts, at least 1 / periods, as what
does not spread still has its ends. 720 periods are whole orbits of most periods.
"""

import sys
import time

import jax
import numpy as np

import jaxvibro as jv
from tests.reference.lyapunov import Oscillator, exponents

OMEGA, GAMMA, BOUNCE = 2.1, 0.05, 0.7
CHAOTIC = (5.24, 5.66, 5.95, 8.0)
STARTS = 512


def values(count=20, seed=38):
    """Amplitudes in [0, 10]: some that are chaotic, the others random."""
    rest = np.random.default_rng(seed).uniform(0.0, 10.0, count - len(CHAOTIC))
    return np.sort(np.concatenate([CHAOTIC[:count], rest]))


def other(amplitudes, state, periods, settle=300, count=STARTS):
    """(exponents, standard errors, impacts) of the other method: (values, 2), (values, 2), (values,)."""
    rng = np.random.default_rng(1)
    lanes = np.repeat(amplitudes, count)
    x = np.full(lanes.size, state.x)
    v = state.v + 1e-7 * rng.normal(size=lanes.size)
    growth, hits = exponents(Oscillator(lanes, OMEGA, GAMMA, BOUNCE, (-1.0, 1.0)), x, v, periods, settle)
    growth = growth.reshape(-1, count, 2)
    error = np.maximum(growth.std(axis=1, ddof=1) / count**0.5, 1.0 / periods)
    return growth.mean(axis=1), error, hits.reshape(-1, count).mean(axis=1)


def main(count, periods):
    """Print the table."""
    jax.config.update("jax_enable_x64", True)
    scene, state, given = jv.make_scene(1.0, OMEGA, GAMMA, BOUNCE, (-1.0, 1.0)), jv.State(0.9, -1.1), values(count)
    began = time.perf_counter()
    ours = jv.spectrum(scene, "amplitude", given, state)
    spent = time.perf_counter() - began
    rates, errors, hits = other(given, state, periods)
    print("A, then for each exponent: ours, error, the other's, error, difference in errors of both")
    worst = 0.0
    for k, value in enumerate(given):
        row, pulls = f"{value:9.6f}", []
        for i in range(2):
            own, error = float(ours.exponent[k, i]), float(ours.error[k, i])
            pulls.append((own - rates[k, i]) / np.hypot(error, errors[k, i]))
            row += f"  {own:9.5f} {error:7.5f} {rates[k, i]:9.5f} {errors[k, i]:7.5f} {pulls[i]:6.2f}"
        print(row, f" periods {int(ours.periods[k])}, impacts {float(ours.impacts[k]):.4f} {hits[k]:.4f}")
        worst = max(worst, *map(abs, pulls))
    length = 2 * np.pi / OMEGA
    off = ours.exponent.sum("order") + 2 * GAMMA * length - 2 * np.log(BOUNCE) * ours.impacts
    print(
        f"largest difference {worst:.2f} errors; sum rule kept to {float(abs(off).max()):.1e}; ours took {spent:.1f} s"
    )
    print(f"largest error, ours {float(ours.error.max()):.5f}, the other's {errors.max():.5f}")


if __name__ == "__main__":
    main(*(int(each) for each in (sys.argv[1:] or (20, 720))))
