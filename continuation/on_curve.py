"""What is watched along a curve of special points in two parameters: where others meet it, and where its own normal
form changes."""

from functools import partial

import numpy as np

from . import event_search, locate
from .driver import End
from .event_search import Event
from .normal_forms import bent, border, critical, lyapunov
from .phases import SystemWatch
from .points import between
from .problem import EQUILIBRIA, FIXED_POINTS, ORBITS, eigenvalues_at, is_oscillation, is_pair, matrix_at

NEAR = 1e-4  # eigenvalues as near, over 1 + the largest, are one: a double one is known to the root of a rounding
TWO = 1e-7  # two pairs as near to the axis, or the circle, over 1 + the largest, are there
# What else becomes singular on a curve of each kind: {kind: {label: the matrix of that kind}}
_OF_MAPS = {"SN": {"FF": "PD", "R1": "NS"}, "PD": {"FF": "SN", "R2": "NS"}, "NS": {"R1": "SN", "R2": "PD"}}
MEETING = {EQUILIBRIA: {"SN": {"BT": "HB"}, "HB": {"BT": "SN"}}, FIXED_POINTS: _OF_MAPS, ORBITS: _OF_MAPS}
# {label: (the eigenvalue that is double there, what it is where that is simple, what must hold then)}
DOUBLE = {"BT": (0.0, "ZH", is_oscillation), "R1": (1.0, "FN", is_pair), "R2": (-1.0, "PN", is_pair)}
NONE = 1e-12  # as small is a coefficient that is zero
CROSSING = {"HB": "HH", "NS": "NN"}  # where a curve meets another of its kind: two pairs are critical
ANGLES = {"R3": 0.5, "R4": 0.0}  # on a curve of NS: less the cosine of the multipliers' angle


class OnCurve(SystemWatch):
    """Events along a curve of special points of a kind."""

    def __init__(self, system, kind, names):
        super().__init__(system, names)
        self.kind = kind

    def events(self, task, points, view, known, end):
        values = event_search.watched(task.problem, points, task.args)
        found = event_search.events(task.problem, points, values, task.control, task.args, known)
        met = [self.named(one, task.args) for one in found if one.kind in values or one.kind == "BP"]
        return [*(one for one in met if one), *self.bends(task, points)]

    def stops(self, z, kind):
        """A curve of HB or NS ends where the two eigenvalues are one: beyond they are real."""
        return End.STOPPED if self.kind in CROSSING and kind in DOUBLE else None

    def named(self, event, given):
        """The event as what it is by the eigenvalues there; None where these are a neutral saddle's."""
        if event.kind == "BP":
            return self.crossed(event, given)
        if event.kind not in DOUBLE:
            return event
        value, other, holds = DOUBLE[event.kind]
        found = eigenvalues_at(self.system, self.names, event.z, given)
        if np.sum(abs(found - value) < NEAR * (1.0 + abs(found).max())) > 1:
            return event
        return event._replace(kind=other) if holds(self.system, self.names, event.z, given) else None

    def crossed(self, event, given):
        """The event where two pairs are critical, None where the curve meets itself for another reason."""
        found = eigenvalues_at(self.system, self.names, event.z, given)
        pairs = found[found.imag > TWO]
        off = abs(pairs.real) if self.kind == "HB" else abs(abs(pairs) - 1.0)
        both = self.kind in CROSSING and np.sum(off < TWO * (1.0 + abs(found).max())) > 1
        return event._replace(kind=CROSSING[self.kind]) if both else None

    def bends(self, task, points):
        """The `Event`s where the first coefficient of the normal form is zero, or the angle of NS one of `ANGLES`."""
        for label, value in self.numbers(task.args).items():
            if label == "CP":
                turned = np.sum(points.tangent[1:, -2:] * points.tangent[:-1, -2:], axis=1)
                values = np.cumprod(np.append(1.0, np.sign(turned)))
            else:
                values = np.array([value(z, z) for z in points.z])
            if abs(values).max() <= NONE:  # it is zero all along, as where areas are kept
                continue
            for after in np.flatnonzero(values[:-1] * values[1:] < 0):
                found = self.located(label, value, task, points, int(after))
                if found is not None:
                    yield found

    def numbers(self, given):
        """{label: the function of (z, a point near) that is zero there}; of orbits those without third derivatives."""
        own, flown = (self.system, self.kind, self.names), self.system.kind == ORBITS

        def bend(z, near):
            return bent(*own, z, given, border(matrix_at(*own, near, given)))

        def first(z, near):
            return lyapunov(*own, z, given)

        def turned(z, near, more):
            return critical(self.kind, eigenvalues_at(self.system, self.names, z, given)).real + more

        if self.kind == "SN":
            return {"CP": bend}
        label = {"PD": "GPD", "SB": "DSB", "HB": "GH", "NS": "CH"}[self.kind]
        found = {label: bend if self.kind in ("PD", "SB") else first}
        angles = {label: partial(turned, more=more) for label, more in ANGLES.items()} if self.kind == "NS" else {}
        return angles if flown else found | angles

    def located(self, label, value, task, points, after):
        """Newton's method on the curve's equations and a number: the `Event`, None where it leads to none."""
        here, length = points.z[after], float(points.step[after + 1])
        near = between(task, points, after, 0.5 * length)
        start = here + 0.5 * length * points.tangent[after] if near is None else near.z

        def system(z):
            left, slopes = (np.asarray(each) for each in locate.evaluated(task.problem, z, task.args))
            more = locate.differences(lambda z: value(z, start), z)
            return np.append(left, value(z, start)), np.vstack([slopes, more])

        found = locate.newton(system, start)
        if found.z is None:
            return None
        along = float(np.sum(task.control.scale**2 * points.tangent[after] * (found.z - here)))
        inside = -0.05 * length <= along <= 1.05 * length
        return Event(label, after, min(max(along, 0.0), length), found.z, found.residual) if inside else None
