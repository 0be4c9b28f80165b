"""Exponents and basins of Duffing's oscillator between two walls against runs by heyoka, of which nothing is shared."""

import heyoka
import numpy as np

import jaxvibro as jv

from .force_specials import duffing

OMEGA, CUBIC, DAMPING, R = 2.1, 0.5, 0.05, 0.7
AMPLITUDES = (2.0, 3.0, 4.2, 5.5, 6.0, 6.5, 7.0, 8.0, 9.0, 10.0)
SHARED = 4.2  # an amplitude at which attractors share the plane
SETTLE, LONG, BATCHES = 300, 20_000, 40  # periods
GRID = 20, 10  # starts
ENOUGH = 600  # periods until a start is at its attractor
TOLERANCE = 1e-14
PERIOD = 2 * np.pi / OMEGA


class Run:
    """An oscillator at an amplitude; with two tangent vectors where asked."""

    def __init__(self, tangents):
        names = ("x", "v", "a", "b", "c", "d")[: 6 if tangents else 2]
        self.tangents, (x, v, *rest) = tangents, heyoka.make_vars(*names)
        amplitude = heyoka.par[0]
        pull = amplitude * heyoka.cos(OMEGA * heyoka.time) - x - CUBIC * x * x * x - 2.0 * DAMPING * v
        equations = [(x, v), (v, pull)]
        for place, speed in (rest[:2], rest[2:]) if tangents else ():
            change = -(1.0 + 3.0 * CUBIC * x * x) * place - 2.0 * DAMPING * speed
            equations += [(place, speed), (speed, change)]
        events = [
            heyoka.t_event(
                side * x - 1.0,
                callback=self.meet(side),
                direction=heyoka.event_direction.positive,
                cooldown=1e-12,
            )
            for side in (-1, 1)
        ]
        start = np.zeros(len(names))
        self.integrator = heyoka.taylor_adaptive(equations, start, tol=TOLERANCE, t_events=events)

    def meet(self, side):
        """What is done at a wall."""

        def rebound(integrator, _):
            state, time = integrator.state, integrator.time
            before = self.pull(integrator, time)
            state[0], fast = side, state[1]
            state[1] = -R * fast
            if self.tangents:
                slope = (self.pull(integrator, time) + R * before) / fast
                for k in (2, 4):
                    state[k], state[k + 1] = -R * state[k], -R * state[k + 1] + slope * state[k]
            return True

        return rebound

    def pull(self, integrator, time):
        """The acceleration."""
        x, v = integrator.state[:2]
        return integrator.pars[0] * np.cos(OMEGA * time) - x - CUBIC * x**3 - 2.0 * DAMPING * v

    def period(self, state):
        """A state after a period of the drive."""
        one = self.integrator
        one.time, one.state[:] = 0.0, state
        one.reset_cooldowns()
        one.propagate_until(PERIOD)
        return one.state.copy()


def exponents(amplitude, state):
    """(both exponents per period, their standard errors) of one long run."""
    run, grown = Run(True), []
    run.integrator.pars[0] = amplitude
    now = np.array([*state, 1.0, 0.0, 0.0, 1.0])
    for k in range(SETTLE + LONG):
        now = run.period(now)
        turned, triangle = np.linalg.qr(now[2:].reshape(2, 2).T)
        now[2:] = turned.T.ravel()
        if k >= SETTLE:
            grown.append(np.log(abs(np.diag(triangle))))
    means = np.array(grown).reshape(BATCHES, -1, 2).mean(axis=1)
    return means.mean(axis=0), means.std(axis=0, ddof=1) / np.sqrt(BATCHES)


def attractors():
    """Print exponents beside those of long runs, in standard errors of the difference, and how many of 200 starts end
    at another attractor than their basin's."""
    start = jv.State(0.3, 0.2)
    data = jv.spectrum(duffing(), "amplitude", np.array(AMPLITUDES), start)
    ours, errors = data["exponent"].values, data["error"].values
    for k, amplitude in enumerate(AMPLITUDES):
        true, error = exponents(amplitude, (0.3, 0.2))
        apart = abs(ours[k] - true) / (np.hypot(errors[k], error) + 1e-9)
        print(
            f"amplitude {amplitude}: {ours[k]} +- {errors[k]}, {true} +- {error}: {apart.max():.2g} errors", flush=True
        )
    scene = duffing(amplitude=SHARED)
    found = jv.find_attractors(scene)
    x, v = np.linspace(-0.95, 0.95, GRID[0]), np.linspace(-3.0, 3.0, GRID[1])
    label = jv.basins(scene, x, v, 0.0, found)["label"].values
    print([one.label for one in found], "starts of each:", np.bincount(label.ravel() + 1)[1:], flush=True)
    run, wrong, far = Run(False), 0, 0.0
    run.integrator.pars[0] = SHARED
    for row, fast in enumerate(v):
        for column, place in enumerate(x):
            state = np.array([place, fast])
            for _ in range(ENOUGH):
                state = run.period(state)
            apart = [abs(one.points - state).max(axis=-1).min() for one in found]
            wrong += int(np.argmin(apart)) != label[row, column]
            far = max(far, min(apart))
    print(f"{label.size} starts, {wrong} at another attractor than their basin's, {far:.1e} from it at most")
