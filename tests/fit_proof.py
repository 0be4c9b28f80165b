"""Fits of records that random scenes made: `python -m tests.fit_proof WHAT N [seed]`.

coverage: N records of 50 impacts, transient or chaotic, noise 1e-3, from half of them 5 % of the impacts taken out; how
often the true numbers lie within the errors told. settled: N records of P111 that have settled, five numbers free.
soft: as coverage, the left wall a soft one, its stiffness and damping free.
chaotic: N records of 30 periods of a chaotic motion, from numbers 5 % off. samples: N records of x(t), 16 times in each
of 30 periods, of motions from anywhere, a third between a soft wall and a rigid one. sections: N records of (x, v) once
in each of 100 periods, of chaotic motions. points: the paper's figure 10 from N starts.
"""

import sys
import time

import jax
import numpy as np
from scipy import special

import jaxvibro as jv

NAMES = ("damping", "left.restitution", "right.restitution", "right.position", "frequency")
SOFT = {"left.stiffness": 5.0, "left.damping": 0.1}
SCALES = {"damping": 0.01, "left.restitution": 0.1, "right.restitution": 0.1, "right.position": 0.1, "frequency": 0.05}
NOISE, MISSING, IMPACTS = 1e-3, 0.05, 50
OFF = 0.05  # of each number, at most, where a fit begins


def scene(rng):
    """A random scene: rigid walls anywhere, a third of the left ones moving."""
    left = -rng.uniform(0.3, 1.5)
    motion = jv.Motion(rng.uniform(0.0, 0.1), rng.uniform(0.0, 6.0)) if rng.uniform() < 1 / 3 else None
    walls = (
        jv.Wall(left, rng.uniform(0.5, 0.95), motion=motion),
        jv.Wall(rng.uniform(0.3, 1.5), rng.uniform(0.5, 0.95)),
    )
    return jv.make_scene(rng.uniform(0.5, 3.0), rng.uniform(0.5, 2.5), rng.uniform(0.01, 0.2), 0.8, walls)


def impacts(one, start, periods, slots):
    """(times, sides) of a motion; none of one that comes to rest on a wall, by infinitely many."""
    _, found = jv.strobe(one, start, periods=periods, slots=slots)
    hit = (np.asarray(found.side) != 0) & (float(found.least_speed) > 0)
    return np.asarray(found.time)[hit], np.asarray(found.side)[hit]


def softened(one, rng):
    """The scene with a soft left wall."""
    wall = jv.Wall(-rng.uniform(0.3, 1.5), stiffness=rng.uniform(5, 100), damping=rng.uniform(0.0, 0.5))
    right = jv.Wall(one.numbers["right.position"], one.numbers["right.restitution"])
    return jv.make_scene(*(one.numbers[name] for name in ("amplitude", "frequency", "damping")), 0.8, (wall, right))


def free_of(one):
    """{name: scale} of the numbers of a scene that are not known."""
    return {name: scale for name, scale in (SCALES | SOFT).items() if name in one.names}


def begun(one, rng):
    """The scene where a fit begins."""
    return one.replace(**{name: one.numbers[name] * (1.0 + OFF * rng.uniform(-1, 1)) for name in free_of(one)})


def record(times, sides, rng, missing=False):
    """A noisy record; (the record, the places that were taken out)."""
    gone = rng.uniform(size=len(times)) < (MISSING if missing else 0.0)
    noisy = (times + NOISE * rng.normal(size=len(times)))[~gone]
    order = np.argsort(noisy)
    return jv.ImpactRecord(noisy[order], sides[~gone][order], NOISE), np.flatnonzero(gone)


def trials(count, seed, soft=False):
    """(scene, times, sides, rng) of so many records of motions that never rest, none of whose impacts are as near as
    errors."""
    rng = np.random.default_rng(seed)
    while count:
        one = softened(scene(rng), rng) if soft else scene(rng)
        times, sides = impacts(one, jv.State(0.0, rng.uniform(-2, 2)), 40, 64)
        if len(times) < IMPACTS:
            continue
        times, sides = times[:IMPACTS], sides[:IMPACTS]
        if np.min(np.diff(times)) < 20 * NOISE:
            continue
        count -= 1
        yield one, times, sides, rng


def apart(fitted, one):
    """(each number's error in sigma, the squared one of all together); of a fit that does not say all the combinations
    that it says in the numbers' place; infinite where it says nothing."""
    names = list(fitted.values)
    if fitted.status == jv.FitStatus.NONE:
        return np.full(len(names), np.inf), np.inf
    away = np.array([fitted.values[name] - one.numbers[name] for name in names])
    if fitted.unidentifiable:
        scales = SCALES | SOFT
        shares = np.array([[each.shares[name] / scales[name] for name in names] for each in fitted.identifiable])
        errors = shares @ away / np.array([each.sigma for each in fitted.identifiable])
        return errors, float(errors @ errors)
    sigma = np.array([fitted.sigma[name] for name in names])
    return away / sigma, float(away @ np.linalg.solve(fitted.covariance.values, away))


def explained(fitted, times, gone):
    """Whether what a fit says is missing is what was taken out, between the record's ends."""
    kept = np.delete(times, gone)
    inner = times[gone][(times[gone] > kept[0]) & (times[gone] < kept[-1])]
    found = np.array([time for time, _ in fitted.missed])
    return not fitted.spurious and len(found) == len(inner) and np.allclose(found, inner, rtol=0, atol=50 * NOISE)


class Tally:
    """The fits that were tried: their errors, their statuses, the time they took."""

    def __init__(self):
        self.errors, self.joint, self.kinds, self.spent = [], [], {}, []

    def fitted(self, one, data, rng):
        """The fit of a record of a scene, from numbers off its own; None where it is refused."""
        begin = time.process_time()
        try:
            found = jv.fit(begun(one, rng), data, free_of(one))
        except jv.ArgumentError as error:
            print("refused:", str(error)[:150], flush=True)
            self.kinds["refused"] = self.kinds.get("refused", 0) + 1
            return None
        self.spent.append(time.process_time() - begin)
        self.kinds[found.status.name] = self.kinds.get(found.status.name, 0) + 1
        errors, square = apart(found, one)
        self.errors.append(errors)
        self.joint.append(special.chdtr(len(errors), square))
        told = f"{np.round(errors, 2)} chi2 {found.chi2:.1f} of {found.dof}, {self.spent[-1]:.2f} s"
        print(found.status.name, told, end=" ")
        return found

    def told(self):
        """What part of all errors lies within one and three sigma, and of all together in the 95 % region."""
        size, joint = abs(np.concatenate(self.errors)), np.mean(np.array(self.joint) < 0.95)
        print(
            f"{self.kinds}, {np.median(self.spent):.2f} s at the median; of {len(size)} values within 1 sigma ", end=""
        )
        print(f"{np.mean(size < 1):.1%}, within 3 {np.mean(size < 3):.1%}, joint 95 % region {joint:.1%}")


def soft(count, seed=0):
    """As `coverage`, of scenes whose left wall is soft."""
    coverage(count, seed, soft=True)


def coverage(count, seed=0, soft=False):
    """Print of each trial its errors, and how often what is missing is found. None is left out but settled records,
    which are refused."""
    tally, right = Tally(), 0
    for k, (one, times, sides, rng) in enumerate(trials(10**9, seed, soft)):
        data, gone = record(times, sides, rng, missing=k % 2 == 1)
        fitted = tally.fitted(one, data, rng)
        if fitted is None:
            continue
        well = explained(fitted, times, gone)
        right += well
        print(f"gone {gone} {'found' if well else fitted.missed} {fitted.spurious}", flush=True)
        if len(tally.errors) == count:
            break
    print(f"what is missing is found in {right} of {count}")
    tally.told()


def points(count, seed=0):
    """Print the amplitude and the two dampings that the three frequencies of figure 10 say, from random starts."""

    def scene(k2):
        walls = (jv.Wall(place, stiffness=k2, damping=0.1) for place in (-1.0, 1.0))
        return jv.make_scene(0.3, 1.2, 0.0761, 0.8, tuple(walls))

    found = []
    for k2 in (10.0, 50.0):
        orbit = jv.find_orbit(scene(k2), jv.State(0.0, 1.5), periods=1, itinerary=("RL",))
        branch = jv.follow(orbit, "frequency", (1.1, 2.0), stop="GR")
        found.append(max(branch.points("SN"), key=lambda one: one.value))
    rest = jv.find_orbit(scene(10.0).replace(frequency=1.9), jv.State(0.0, 0.0), periods=1)
    found.append(max(jv.follow(rest, "frequency", (0.9, 2.0), stop="GR").points("GR"), key=lambda one: one.value))
    data = jv.PointRecord(tuple(found), [1.48, 1.74, 1.18], 0.005, (None, None, "right"))
    free, rng, right = {"amplitude": 0.1, "damping": 0.02, ("left.damping", "right.damping"): 0.1}, None, 0
    rng = np.random.default_rng(seed)
    for _ in range(count):
        start = rng.uniform((0.2, 0.03, 0.03), (1.0, 0.3, 0.5))
        walls = {"left.damping": start[2], "right.damping": start[2]}
        fitted = jv.fit(scene(10.0).replace(amplitude=start[0], damping=start[1], **walls), data, free)
        values = list(fitted.values.values())
        good = np.allclose(values, [0.489514, 0.124006, 0.165749], rtol=0, atol=1e-6)
        right += good
        print(np.round(start, 3), fitted.status.name, values, good, flush=True)
    spread = np.sqrt(np.linalg.eigvalsh(fitted.covariance.values))
    print(f"{right} of {count} starts come to the known numbers; condition {spread[-1] / spread[0]:.3g}")


def settled(count, seed=0):
    """Print what is said of records of P111 that have settled."""
    rng, found, refused = np.random.default_rng(seed), 0, 0
    while found < count:
        one = scene(rng)
        times, sides = impacts(one, jv.State(0.0, rng.uniform(-2, 2)), 440, 2000)
        late = times > 400 * 2 * np.pi / one.numbers["frequency"]
        first = times[late][:2]
        if late.sum() != 80 or np.any(sides[late][1:] == sides[late][:-1]):
            continue
        if not np.allclose(
            times[late].reshape(-1, 2), first + np.arange(40)[:, None] * 2 * np.pi / one.numbers["frequency"], atol=1e-9
        ):
            continue
        found += 1
        data, _ = record(times[late][:IMPACTS] - np.floor(first[0]), sides[late][:IMPACTS], rng)
        phase = one.numbers["frequency"] * np.floor(first[0])
        data = jv.ImpactRecord(data.times, data.sides, NOISE, float(phase))
        try:
            told = jv.fit(begun(one, rng), data, SCALES).table()
        except jv.ArgumentError as error:
            refused, told = refused + ("a settled motion with 3 is recorded" in str(error)), str(error)
        print(told, flush=True)
    print(f"{refused} of {count} refused with the combinations")


def chaotic(count, seed=0):
    """Print how many fits of 30 periods of a chaotic motion converge to the numbers that made it."""
    rng, found, good = np.random.default_rng(seed), 0, 0
    while found < count:
        one, start = scene(rng), jv.State(0.0, rng.uniform(-2, 2))
        settling, _ = jv.strobe(one, start, periods=200)
        if not exponent(one, settling) > 0.02:
            continue
        times, sides = impacts(one, settling, 30, 128)
        if len(times) < 20 or np.min(np.diff(times)) < 20 * NOISE:
            continue
        found += 1
        data, _ = record(times, sides, rng)
        try:
            fitted = jv.fit(begun(one, rng), data, SCALES)
        except jv.ArgumentError as error:
            print("refused:", str(error)[:100], flush=True)
            continue
        square = apart(fitted, one)[1] if fitted.status == jv.FitStatus.OK else np.inf
        good += square < special.chdtri(5, 1e-4)
        print(f"{fitted.status.name} {len(times)} impacts, squared error {square:.3g}", flush=True)
    print(f"{good} of {count} converge")


def samples(count, seed=0, often=16, periods=30, measured=1):
    """Print of each record of samples the errors of its fit."""
    rng, tally = np.random.default_rng(seed), Tally()
    while len(tally.errors) < count:
        one, start = scene(rng), jv.State(0.0, rng.uniform(-2, 2))
        if measured == 2:
            start, _ = jv.strobe(one, start, periods=200)
            if not exponent(one, start) > 0.02:
                continue
        elif rng.uniform() < 1 / 3:
            one = softened(one, rng)
        times = np.arange(often * periods + 1) * 2 * np.pi / one.numbers["frequency"] / often
        states, status = jv.sample(one, start, times)
        if int(status):
            continue
        true = np.stack([states.x, states.v][:measured])
        noisy = true + NOISE * rng.normal(size=true.shape)
        tally.fitted(one, jv.SampleRecord(times, noisy[0], NOISE, noisy[1] if measured == 2 else None), rng)
        print(flush=True)
    tally.told()


def sections(count, seed=0):
    """The same of sections, once a period, of chaotic motions."""
    samples(count, seed, 1, 100, 2)


def exponent(one, state):
    """How fast two motions part in a hundred periods, by the logarithm of their distance, a period."""
    total, away = 0.0, np.array([0.0, 1e-8])
    for _ in range(100):
        near = jv.State(state.x + away[0], state.v + away[1], state.phase)
        (state, _), (near, _) = jv.strobe(one, state), jv.strobe(one, near)
        away = np.array([float(near.x - state.x), float(near.v - state.v)])
        size = max(float(np.hypot(*away)), 1e-15)
        total += np.log(size / 1e-8)
        away = away / size * 1e-8
    return total / 100


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    proofs = {"coverage": coverage, "settled": settled, "chaotic": chaotic, "points": points}
    proofs |= {"samples": samples, "sections": sections, "soft": soft}
    proofs[sys.argv[1]](*map(int, sys.argv[2:]))
