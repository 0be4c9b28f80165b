"""Rebuild cases that users of other packages reported, for this package and for diffrax at its locked version.

All solutions are in closed form: x'' + x = 0 between the walls, or a flight from rest under a cosine.
"""

import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import diffrax
import mpmath
import numpy as np

import jaxvibro as jv
from benchmarks import page
from reliability import spring_by_diffrax as spring

RIGHT = 1e-6  # largest error of a right result; a missed contact costs at least 1e-3
DAMPED, KEPT = 0.7, 0.9  # restitutions
DUE, RESTARTS = 20, 60  # impacts at which it is started again, and how often that is tried
HEAD = ("case", "reported in", "true result", "method", "result", "error", "correct")


class Told(NamedTuple):
    """Result: method and setting `by`, text `says`, largest error of its numbers, inf if contacts differ."""

    by: str
    says: str
    error: float

    @property
    def right(self):
        """Return True if the error is at most RIGHT."""
        return self.error < RIGHT


class Case(NamedTuple):
    """Case: package and issue, descriptions of scene and solution, functions that return `Told`, and a remark.

    `others` is empty if the case was reported in Julia.
    """

    name: str
    source: str
    scene: str
    truth: str
    ours: Callable[[], Told]
    others: tuple[Callable[[], Told], ...] = ()
    remark: str = ""


class Met(NamedTuple):
    """Case and its results."""

    case: Case
    ours: Told
    others: tuple[Told, ...]

    @property
    def words(self):
        """Format the scene and the solution in a line, with a note if the fault no longer occurs."""
        case, gone = self.case, self.others and all(each.right for each in self.others)
        return " ".join(
            filter(
                None,
                [
                    f"{case.name}: {case.scene}",
                    case.remark,
                    gone and "The tested version of the package no longer has this fault.",
                ],
            )
        )


def cases():
    """Return all cases, not yet run."""
    made = swinging_wall, shallow_arc, section_beyond_a_wall, restarts, clipped_restart, stops, elastic
    return [each() for each in made]


def measure():
    """Run all cases; returns a list of `Met`."""
    return [Met(case, case.ours(), tuple(each() for each in case.others)) for case in cases()]


def table(met):
    """Format cases as a Markdown table, one line per result, followed by their scenes."""
    lines = [
        (case.name, case.source, case.truth, told.by, told.says, f"{told.error:.1g}", "yes" if told.right else "**no**")
        for case, ours, others in met
        for told in (ours, *others)
    ]
    return "\n\n".join([page.table(HEAD, lines), page.listed(each.words for each in met)])


def by_diffrax(time, how, *given, **more):
    """Return diffrax's result with one contact due at a time."""
    flight, by = spring.fly(*given, **more), f"diffrax {diffrax.__version__}{how}"
    if not any(flight.events):
        return Told(by, "no impact", math.inf)
    return Told(by, f"impact at t = {flight.time:.12g}", largest((flight.time, time)))


def largest(*pairs):
    """Return the largest difference between computed and true numbers."""
    return max(abs(float(found) - float(true)) for found, true in pairs)


def one_impact(scene, state, time, end):
    """Return this package's result with one impact due at a time in the first period and a known end of the period."""
    final, impacts = jv.strobe(scene, state)
    if int(impacts.count) != 1:
        return Told("jaxvibro", f"{int(impacts.count)} impacts", math.inf)
    error = largest((impacts.time[0], time), (final.x, end[0]), (final.v, end[1]))
    return Told("jaxvibro", f"impact at t = {impacts.time[0]:.12g}", error)


def swinging_wall():
    """Return the case of a mass at rest: steps are long, and a wall passes over it within one."""
    wall = jv.Wall(1.0, motion=jv.Motion(spring.SWING, 0.0, 1))
    with mpmath.workdps(40):
        time = mpmath.acos(-1 / mpmath.mpf(spring.SWING)) / 2
        after = -2 * (1 + mpmath.mpf(DAMPED)) * mpmath.sqrt(mpmath.mpf(spring.SWING) ** 2 - 1)
        end = after * mpmath.sin(mpmath.pi - time), after * mpmath.cos(mpmath.pi - time)
    scene = jv.make_scene(0.0, 2.0, 0.0, DAMPED, (None, wall))
    return Case(
        "A moving wall that passes over a mass at rest",
        "diffrax #507",
        "x = v = 0, no drive, and a wall at 1 + 1.001 cos 2t, which is beyond the mass for 0.045 of the period 3.14.",
        f"impact at t = {mpmath.nstr(time, 12)}",
        functools.partial(one_impact, scene, jv.State(0.0, 0.0), time, end),
        (functools.partial(by_diffrax, time, "", math.pi, 0.0, (0.0, 0.0), spring.beyond_swinging),),
        "As in the issue, the motion is simple, so that the steps grow, and the event function has two roots in one "
        "step.",
    )


def arc(radius):
    """Return impact time and state at 2 pi of x = radius sin t before a wall at 1 with R = 0.7."""
    with mpmath.workdps(40):
        time = mpmath.asin(1 / mpmath.mpf(radius))
        after, left = -mpmath.mpf(DAMPED) * mpmath.sqrt(mpmath.mpf(radius) ** 2 - 1), 2 * mpmath.pi - time
        cosine, sine = mpmath.cos(left), mpmath.sin(left)
        return time, (cosine + after * sine, after * cosine - sine)


def shallow_arc():
    """Return the case of an arc that penetrates a wall by 1e-6 and is back before the step ends."""
    radius = 1.0 + 1e-6
    time, end = arc(radius)
    scene = jv.make_scene(0.0, 1.0, 0.0, DAMPED, (None, 1.0))
    return Case(
        "A contact 1e-6 deep",
        "diffrax #507",
        "x = 1.000001 sin t and a wall at 1: the mass is beyond the wall for a time of 0.0028 and hits it with the "
        "speed 0.0014.",
        f"impact at t = {mpmath.nstr(time, 12)}",
        functools.partial(one_impact, scene, jv.State(0.0, radius), time, end),
        (functools.partial(by_diffrax, time, "", 2 * math.pi, 0.0, (0.0, radius), spring.beyond_one),),
        "As in the previous case, but with a fixed wall.",
    )


def section_beyond_a_wall():
    """Return the case of a wall and a section of time within one step: the order of the events decides."""
    radius = 1.1
    time, end = arc(radius)
    scene, state = jv.make_scene(0.0, 1.0, 0.0, DAMPED, (None, 1.0)), (0.0, radius)
    fixed = {"control": diffrax.ConstantStepSize(), "solver": diffrax.Dopri8(), "step": 0.5}
    told = functools.partial(by_diffrax, time)
    return Case(
        "A wall and a section in one step",
        "diffrax #639",
        "x = 1.1 sin t, a wall at 1, an event for the wall and one at t = 1.4, steps of 0.5: both are in the third "
        "step.",
        f"impact at t = {mpmath.nstr(time, 12)}, before 1.4",
        functools.partial(one_impact, scene, jv.State(*state), time, end),
        (
            functools.partial(told, ", wall event first", 6.5, 0.0, state, spring.beyond_one, spring.later, **fixed),
            functools.partial(told, ", wall event last", 6.5, 0.0, state, spring.later, spring.beyond_one, **fixed),
        ),
        "The event that is listed first is reported; the version of diffrax in the issue reported the event that is "
        "listed last.",
    )


def restarts():
    """Return the case of an integration restarted at each impact, where the event function is 0."""
    true = mpmath.mpf(KEPT) ** DUE
    return Case(
        "Restarts at impacts",
        "diffrax #492",
        "x = cos t and a wall at 0 with R = 0.9: impacts at pi / 2 and then every pi, each the start of a new flight.",
        f"{DUE} impacts by t = {DUE * math.pi:.4g}, v = {mpmath.nstr(true, 12)} after the last",
        functools.partial(returned, true),
        (
            functools.partial(restarted, true, True, ", rising events"),
            functools.partial(restarted, true, None, ", events of both directions"),
        ),
        "The answer in the issue is a loop of restarts. If the event has no direction, each restart detects its "
        "own start as an event, without end.",
    )


def returned(true):
    """Return this package's result by successive return maps."""
    scene = jv.make_scene(0.0, 1.0, 0.0, KEPT, (0.0, None))
    phase, speed, times = math.pi / 2, KEPT, []
    for _ in range(DUE - 1):
        back = jv.return_map(scene, "left", phase, speed)
        phase, speed = float(back.phase), float(back.velocity)
        times.append(float(back.time))
    error = largest((speed, true), *((each, math.pi) for each in times))
    return Told("jaxvibro", f"{1 + len(times)} impacts by t = {math.pi / 2 + sum(times):.4g}", error)


def restarted(true, direction, how):
    """Return diffrax's result with the mass placed on the wall at each start."""
    time, state, count = 0.0, np.array([1.0, 0.0]), 0
    for _ in range(RESTARTS):
        flight = spring.fly(DUE * math.pi, time, state, spring.below_zero, direction=direction)
        if not flight.events[0]:
            break
        time, count, state = flight.time, count + 1, np.array([0.0, -KEPT * flight.state[1]])
    error = largest((state[1], true)) if count == DUE else math.inf
    return Told(f"diffrax {diffrax.__version__}{how}", f"{count} impacts by t = {time:.4g}", error)


def clipped_restart():
    """Return the case of a restart at an impact whose time the step controller was given too: time went back there."""
    true = 1.5 * math.pi
    return Case(
        "A restart with clipped steps",
        "diffrax #713",
        "The mass of the previous case. ClipStepSizeController receives the time of its first impact, pi / 2, as a "
        "jump.",
        f"next impact at t = {true:.12g}",
        functools.partial(second_impact, true),
        (functools.partial(clipped, true),),
        "In the issue the second flight ended before it began.",
    )


def second_impact(true):
    """Return this package's result, started at the first impact."""
    scene = jv.make_scene(0.0, 1.0, 0.0, KEPT, (0.0, None))
    _, impacts = jv.strobe(scene, jv.State(0.0, KEPT, math.pi / 2, -1.0))
    time = math.pi / 2 + float(impacts.time[0])
    return Told("jaxvibro", f"impact at t = {time:.12g}", largest((time, true)))


def clipped(true):
    """Return diffrax's result, both flights by the controller that clips steps."""
    control = diffrax.ClipStepSizeController(spring.CONTROL, jump_ts=[math.pi / 2])
    first = spring.fly(3.0, 0.0, (1.0, 0.0), spring.below_zero, control=control)
    after = np.array([0.0, -KEPT * first.state[1]])
    return by_diffrax(true, "", 6.0, first.time, after, spring.below_zero, control=control)


def stops():
    """Return the case of a piston between two stops under a spring and an oscillating pressure, in SI units."""
    mass, stiffness, preload, area, gap = (
        3.361185937456267e-4,
        1488.578099595049,
        8.54503372291542,
        7.37366e-5,
        1.016e-3,
    )
    omega = 2 * math.pi * 250 / math.sqrt(stiffness / mass)
    mean, swing = 6895 * 18 * area - preload, 6895 * 4 * area
    given = swing, omega, mean, gap * stiffness - mean
    hit, end = lifted(*given)
    return Case(
        "A piston between two stops",
        "OrdinaryDiffEq.jl #3222",
        "Mass, spring, preload, pressure, stops and R = 0.3 of the issue, from rest on the left stop, 4 periods.",
        f"each period except the first hits the right stop {mpmath.nstr(hit, 10)} after its start",
        functools.partial(stopped, *given, hit, end),
        remark="The case is cited and was not run in Julia. The friction of 1 N is omitted; sticking on both stops is "
        "included.",
    )


def stopped(swing, omega, mean, stop, hit, end):
    """Return this package's result: impacts on both stops in each of four periods, right stop first, and the end."""
    scene, period = jv.make_scene(swing, omega, 0.0, 0.3, (-mean, stop)), 2 * math.pi / omega
    final, impacts = jv.strobe(scene, jv.State(-mean, 0.0, -math.pi / 2, -2.0), 4, 64)
    times, sides = np.asarray(impacts.time), np.asarray(impacts.side)
    pairs, met = [(final.x, end[0]), (final.v, end[1])], 0
    for k in range(4):
        within = (times > k * period) & (times < (k + 1) * period)
        met += {-1, 1} <= set(sides[within])
        if k:
            pairs.append((np.min(times, where=within & (sides > 0), initial=math.inf), hit + k * period))
    return Told("jaxvibro", f"both stops in {met} of 4 periods", largest(*pairs) if met == 4 else math.inf)


def lifted(swing, omega, mean, stop):
    """Return time and state of the impact on the right stop of a mass that sticks to the left one.

    It is released from -mean by the force swing cos; the time is measured from the last upward zero of the force.
    """
    with mpmath.workdps(30):
        omega, lift = mpmath.mpf(omega), -mpmath.acos(-mpmath.mpf(mean) / swing)
        answer = swing / (1 - omega**2)
        x, v = -mean - answer * mpmath.cos(lift), answer * omega * mpmath.sin(lift)

        def motion(time):
            cosine, sine, phase = mpmath.cos(time), mpmath.sin(time), lift + omega * time
            place = x * cosine + v * sine + answer * mpmath.cos(phase)
            return place, v * cosine - x * sine - answer * omega * mpmath.sin(phase)

        begin = (-mpmath.pi / 2 - lift) / omega
        met = mpmath.findroot(lambda time: motion(time)[0] - stop, (begin + 1, begin + 2), solver="anderson")
        return met - begin, motion(begin)


def elastic(impacts=1_000_000):
    """Return the case of many elastic impacts, which conserve energy."""
    speed, walls = 20.0, (-0.3, 1.0)
    with mpmath.workdps(40):
        # x = 20 sin of an angle that increases with time and reverses at each wall.
        low, high = (mpmath.asin(mpmath.mpf(abs(each)) / speed) for each in walls)
        periods = int(impacts * (low + high) / (2 * mpmath.pi)) + 1
        due = int((2 * mpmath.pi * periods + low) / (low + high))
    return Case(
        f"Energy over {impacts:,} elastic impacts",
        "ChaosTools.jl #324",
        "x = 0, v = 20, no drive and no damping, walls at -0.3 and 1 with R = 1.",
        f"{due:,} impacts, and the initial energy",
        functools.partial(kept, jv.make_scene(0.0, 1.0, 0.0, 1.0, walls), speed, periods, due),
        remark="The case is cited and was not run in Julia. In the issue, the energy of colliding ellipses changed at "
        "each callback.",
    )


def kept(scene, speed, periods, due):
    """Return this package's result: number of impacts and relative change of the energy."""
    final, told = jv.strobe(scene, jv.State(0.0, speed), periods, 0)
    drift = largest(((final.x**2 + final.v**2) / speed**2, 1.0))
    return Told(
        "jaxvibro", f"{int(told.count):,} impacts; relative energy drift", drift if told.count == due else math.inf
    )
