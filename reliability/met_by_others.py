"""What users of other packages met: their cases rebuilt as scenes, ours on each, and diffrax's as it is locked.

All is known in closed form: x'' + x = 0 between the walls, or a flight from rest under a cosine.
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

RIGHT = 1e-6  # an answer further than this from the truth is wrong: a missed contact costs 1e-3 at least
DAMPED, KEPT = 0.7, 0.9  # restitutions
DUE, RESTARTS = 20, 60  # impacts at which it is started again, and how often that is tried
HEAD = ("case", "met in", "what is true", "by", "what it gives", "error", "right")


class Told(NamedTuple):
    """An answer. by: whose, and how; says: in words; error: the largest of its numbers, inf where contacts differ."""

    by: str
    says: str
    error: float

    @property
    def right(self):
        """Whether it is the truth to RIGHT."""
        return self.error < RIGHT


class Case(NamedTuple):
    """A case. source: package and issue; scene, truth: in words; ours, others: functions that give `Told`, no others
    where the case was met in Julia; remark: what else is to be known of it."""

    name: str
    source: str
    scene: str
    truth: str
    ours: Callable[[], Told]
    others: tuple[Callable[[], Told], ...] = ()
    remark: str = ""


class Met(NamedTuple):
    """A case, and what was told of it."""

    case: Case
    ours: Told
    others: tuple[Told, ...]

    @property
    def words(self):
        """The scene and what is to be known, in a line; whether the fault shows no more."""
        case, gone = self.case, self.others and all(each.right for each in self.others)
        return " ".join(
            filter(None, [f"{case.name}: {case.scene}", case.remark, gone and "As locked, the fault is gone."])
        )


def cases():
    """All cases, none of them run."""
    made = swinging_wall, shallow_arc, section_beyond_a_wall, restarts, clipped_restart, stops, elastic
    return [each() for each in made]


def measure():
    """All cases run, a list of `Met`."""
    return [Met(case, case.ours(), tuple(each() for each in case.others)) for case in cases()]


def table(met):
    """Cases as a table in Markdown, a line for each answer, and their scenes below it."""
    lines = [
        (case.name, case.source, case.truth, told.by, told.says, f"{told.error:.1g}", "yes" if told.right else "**no**")
        for case, ours, others in met
        for told in (ours, *others)
    ]
    return "\n\n".join([page.table(HEAD, lines), page.listed(each.words for each in met)])


def by_diffrax(time, how, *given, **more):
    """Its answer where one contact is due at a time."""
    flight, by = spring.fly(*given, **more), f"diffrax {diffrax.__version__}{how}"
    if not any(flight.events):
        return Told(by, "no contact", math.inf)
    return Told(by, f"contact at t = {flight.time:.12g}", largest((flight.time, time)))


def largest(*pairs):
    """The largest difference between numbers found and true."""
    return max(abs(float(found) - float(true)) for found, true in pairs)


def one_impact(scene, state, time, end):
    """Our answer where one impact is due at a time in the first period, and the end of that is known."""
    final, impacts = jv.strobe(scene, state)
    if int(impacts.count) != 1:
        return Told("jaxvibro", f"{int(impacts.count)} impacts", math.inf)
    error = largest((impacts.time[0], time), (final.x, end[0]), (final.v, end[1]))
    return Told("jaxvibro", f"contact at t = {impacts.time[0]:.12g}", error)


def swinging_wall():
    """A mass at rest: steps are as long as they please, and a wall comes over it and goes within one."""
    wall = jv.Wall(1.0, motion=jv.Motion(spring.SWING, 0.0, 1))
    with mpmath.workdps(40):
        time = mpmath.acos(-1 / mpmath.mpf(spring.SWING)) / 2
        after = -2 * (1 + mpmath.mpf(DAMPED)) * mpmath.sqrt(mpmath.mpf(spring.SWING) ** 2 - 1)
        end = after * mpmath.sin(mpmath.pi - time), after * mpmath.cos(mpmath.pi - time)
    scene = jv.make_scene(0.0, 2.0, 0.0, DAMPED, (None, wall))
    return Case(
        "A wall that swings over a mass at rest",
        "diffrax #507",
        "x = v = 0, no drive, a wall at 1 + 1.001 cos 2t, which is beyond the mass for 0.045 of the period's 3.14.",
        f"hit at t = {mpmath.nstr(time, 12)}",
        functools.partial(one_impact, scene, jv.State(0.0, 0.0), time, end),
        (functools.partial(by_diffrax, time, "", math.pi, 0.0, (0.0, 0.0), spring.beyond_swinging),),
        "The issue's own: the motion is simple, so that steps grow, and the event's function has two roots within one.",
    )


def arc(radius):
    """Of x = radius sin t before a wall at 1 with R = 0.7: when it is hit, and the state at 2 pi."""
    with mpmath.workdps(40):
        time = mpmath.asin(1 / mpmath.mpf(radius))
        after, left = -mpmath.mpf(DAMPED) * mpmath.sqrt(mpmath.mpf(radius) ** 2 - 1), 2 * mpmath.pi - time
        cosine, sine = mpmath.cos(left), mpmath.sin(left)
        return time, (cosine + after * sine, after * cosine - sine)


def shallow_arc():
    """An arc that is beyond a wall by 1e-6: it is back before the step ends."""
    radius = 1.0 + 1e-6
    time, end = arc(radius)
    scene = jv.make_scene(0.0, 1.0, 0.0, DAMPED, (None, 1.0))
    return Case(
        "An arc 1e-6 deep",
        "diffrax #507",
        "x = 1.000001 sin t, a wall at 1: the arc is beyond it for 0.0028, from a speed of 0.0014.",
        f"hit at t = {mpmath.nstr(time, 12)}",
        functools.partial(one_impact, scene, jv.State(0.0, radius), time, end),
        (functools.partial(by_diffrax, time, "", 2 * math.pi, 0.0, (0.0, radius), spring.beyond_one),),
        "The same where nothing moves but the mass.",
    )


def section_beyond_a_wall():
    """A wall and a section of time within one step: the order in which they are written decides which comes first."""
    radius = 1.1
    time, end = arc(radius)
    scene, state = jv.make_scene(0.0, 1.0, 0.0, DAMPED, (None, 1.0)), (0.0, radius)
    fixed = {"control": diffrax.ConstantStepSize(), "solver": diffrax.Dopri8(), "step": 0.5}
    told = functools.partial(by_diffrax, time)
    return Case(
        "A wall and a section in a step",
        "diffrax #639",
        "x = 1.1 sin t, a wall at 1, an event for it and one at t = 1.4, steps of 0.5: both lie within the third.",
        f"hit at t = {mpmath.nstr(time, 12)}, before 1.4",
        functools.partial(one_impact, scene, jv.State(*state), time, end),
        (
            functools.partial(told, ", wall written first", 6.5, 0.0, state, spring.beyond_one, spring.later, **fixed),
            functools.partial(told, ", wall written last", 6.5, 0.0, state, spring.later, spring.beyond_one, **fixed),
        ),
        "The event that is written first wins; in the issue's version it was the last.",
    )


def restarts():
    """An integration started again at each impact, where the event's function is 0."""
    true = mpmath.mpf(KEPT) ** DUE
    return Case(
        "Restarts at impacts",
        "diffrax #492",
        "x = cos t, a wall at 0 with R = 0.9: an impact at pi / 2 and then each pi, each the start of a flight anew.",
        f"{DUE} impacts by t = {DUE * math.pi:.4g}, the last leaves with v = {mpmath.nstr(true, 12)}",
        functools.partial(returned, true),
        (
            functools.partial(restarted, true, True, ", rising events"),
            functools.partial(restarted, true, None, ", events of both directions"),
        ),
        "The issue's answer is a loop of restarts. Without a direction the start is found again, for ever.",
    )


def returned(true):
    """Our answer by return maps, one after the other."""
    scene = jv.make_scene(0.0, 1.0, 0.0, KEPT, (0.0, None))
    phase, speed, times = math.pi / 2, KEPT, []
    for _ in range(DUE - 1):
        back = jv.return_map(scene, "left", phase, speed)
        phase, speed = float(back.phase), float(back.velocity)
        times.append(float(back.time))
    error = largest((speed, true), *((each, math.pi) for each in times))
    return Told("jaxvibro", f"{1 + len(times)} impacts by t = {math.pi / 2 + sum(times):.4g}", error)


def restarted(true, direction, how):
    """diffrax's answer, the mass put on the wall at each start."""
    time, state, count = 0.0, np.array([1.0, 0.0]), 0
    for _ in range(RESTARTS):
        flight = spring.fly(DUE * math.pi, time, state, spring.below_zero, direction=direction)
        if not flight.events[0]:
            break
        time, count, state = flight.time, count + 1, np.array([0.0, -KEPT * flight.state[1]])
    error = largest((state[1], true)) if count == DUE else math.inf
    return Told(f"diffrax {diffrax.__version__}{how}", f"{count} impacts by t = {time:.4g}", error)


def clipped_restart():
    """A restart at an impact whose time the controller of steps was told too: there time went back."""
    true = 1.5 * math.pi
    return Case(
        "A restart where steps are cut",
        "diffrax #713",
        "The same mass; its first impact's time, pi / 2, is told to ClipStepSizeController as a jump.",
        f"the next at t = {true:.12g}",
        functools.partial(second_impact, true),
        (functools.partial(clipped, true),),
        "In the issue the second flight ended before it began.",
    )


def second_impact(true):
    """Our answer, started at the first impact."""
    scene = jv.make_scene(0.0, 1.0, 0.0, KEPT, (0.0, None))
    _, impacts = jv.strobe(scene, jv.State(0.0, KEPT, math.pi / 2, -1.0))
    time = math.pi / 2 + float(impacts.time[0])
    return Told("jaxvibro", f"contact at t = {time:.12g}", largest((time, true)))


def clipped(true):
    """diffrax's answer, both flights by the controller that cuts steps."""
    control = diffrax.ClipStepSizeController(spring.CONTROL, jump_ts=[math.pi / 2])
    first = spring.fly(3.0, 0.0, (1.0, 0.0), spring.below_zero, control=control)
    after = np.array([0.0, -KEPT * first.state[1]])
    return by_diffrax(true, "", 6.0, first.time, after, spring.below_zero, control=control)


def stops():
    """A piston between two stops, pressed by a spring and an oscillating pressure; the issue's numbers, SI units."""
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
        "The issue's mass, spring, preload, pressure, stops and R = 0.3, from rest on the left stop, 4 periods.",
        f"each period but the first meets the right stop {mpmath.nstr(hit, 10)} after its begin",
        functools.partial(stopped, *given, hit, end),
        remark="Cited, not run in Julia; the issue's friction of 1 N is left out, rests on both stops are in it.",
    )


def stopped(swing, omega, mean, stop, hit, end):
    """Our answer: impacts on both stops in each of four periods, the first on the right one, and the end."""
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
    """Of a mass that rests on the left stop, -mean, until the force swing cos lifts it: when it meets the right one,
    since the force last was 0 and rose; and its state then."""
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
    """Elastic impacts without end: their energy must stay."""
    speed, walls = 20.0, (-0.3, 1.0)
    with mpmath.workdps(40):
        # x = 20 sin of an angle that goes on with time and turns round at each wall.
        low, high = (mpmath.asin(mpmath.mpf(abs(each)) / speed) for each in walls)
        periods = int(impacts * (low + high) / (2 * mpmath.pi)) + 1
        due = int((2 * mpmath.pi * periods + low) / (low + high))
    return Case(
        f"Energy over {impacts:,} elastic impacts",
        "ChaosTools.jl #324",
        "x = 0, v = 20, no drive and no damping, walls at -0.3 and 1 with R = 1.",
        f"{due:,} impacts, and the energy of the start",
        functools.partial(kept, jv.make_scene(0.0, 1.0, 0.0, 1.0, walls), speed, periods, due),
        remark="Cited, not run in Julia: there the energy changed at each callback, of ellipses that collide.",
    )


def kept(scene, speed, periods, due):
    """Our answer: impacts, and by how much of itself the energy has changed."""
    final, told = jv.strobe(scene, jv.State(0.0, speed), periods, 0)
    drift = largest(((final.x**2 + final.v**2) / speed**2, 1.0))
    return Told("jaxvibro", f"{int(told.count):,} impacts; the energy", drift if told.count == due else math.inf)
