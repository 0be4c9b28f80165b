"""Locate codimension-two points on curves of special points in two parameters.

They are intersections with curves of other kinds and zeros of normal-form coefficients.
"""

from functools import partial

import numpy as np

from . import augmented_systems, event_search
from .branch_closure import SystemEventDetector
from .driver import End
from .event_search import Event
from .intermediate_points import point_at_length
from .normal_forms import border_vectors, critical_eigenvalue, lyapunov_coefficient, normal_form_coefficient
from .problem import EQUILIBRIA, FIXED_POINTS, ORBITS, eigenvalues_at, is_hopf, is_neimark_sacker, matrix_at

# Tolerance of a double eigenvalue, relative to 1 + the largest: its error is the square root of a rounding error.
DOUBLE_TOLERANCE = 1e-4
CRITICAL_TOLERANCE = 1e-7  # tolerance of a critical pair of eigenvalues, relative to 1 + the largest
# Further matrices that become singular on a curve of each kind: {kind: {label: kind of the matrix}}
_MAP_INTERSECTIONS = {"SN": {"FF": "PD", "R1": "NS"}, "PD": {"FF": "SN", "R2": "NS"}, "NS": {"R1": "SN", "R2": "PD"}}
INTERSECTIONS = {
    EQUILIBRIA: {"SN": {"BT": "HB"}, "HB": {"BT": "SN"}},
    FIXED_POINTS: _MAP_INTERSECTIONS,
    ORBITS: _MAP_INTERSECTIONS,
}
# {label: (double eigenvalue, kind of the point if it is simple, condition in this case)}
DOUBLE_EIGENVALUES = {
    "BT": (0.0, "ZH", is_hopf),
    "R1": (1.0, "FN", is_neimark_sacker),
    "R2": (-1.0, "PN", is_neimark_sacker),
}
ZERO_COEFFICIENT = 1e-12  # largest absolute value of a vanishing coefficient
SELF_CROSSINGS = {"HB": "HH", "NS": "NN"}  # kinds of points where two pairs of eigenvalues are critical
RESONANCE_ANGLES = {"R3": 0.5, "R4": 0.0}  # negative cosine of the angle of the multipliers on a curve of NS


class CurveEventDetector(SystemEventDetector):
    """Detector of codimension-two points on a curve of special points of one kind."""

    def __init__(self, system, kind, names):
        super().__init__(system, names)
        self.kind = kind

    def find_events(self, task, points, diagnostics, branch_points, termination):
        values = event_search.test_function_values(task.problem, points, task.args)
        events = event_search.locate_events(task.problem, points, values, task.control, task.args, branch_points)
        classified_events = [
            self.classify_event(event, task.args) for event in events if event.kind in values or event.kind == "BP"
        ]
        return [*(event for event in classified_events if event), *self.locate_codim2_events(task, points)]

    def end_at_special_point(self, z, kind):
        """Return the end of a curve of HB or NS at a point where its two eigenvalues coincide; they are real beyond."""
        return End.STOPPED if self.kind in SELF_CROSSINGS and kind in DOUBLE_EIGENVALUES else None

    def classify_event(self, event, constants):
        """Return the event with the kind that its eigenvalues determine; None for a neutral saddle."""
        if event.kind == "BP":
            return self.classify_crossing(event, constants)
        if event.kind not in DOUBLE_EIGENVALUES:
            return event
        double_value, simple_kind, is_valid = DOUBLE_EIGENVALUES[event.kind]
        eigenvalues = eigenvalues_at(self.system, self.names, event.z, constants)
        if np.sum(abs(eigenvalues - double_value) < DOUBLE_TOLERANCE * (1.0 + abs(eigenvalues).max())) > 1:
            return event
        return event._replace(kind=simple_kind) if is_valid(self.system, self.names, event.z, constants) else None

    def classify_crossing(self, event, constants):
        """Return the event if two pairs of eigenvalues are critical, else None."""
        eigenvalues = eigenvalues_at(self.system, self.names, event.z, constants)
        pairs = eigenvalues[eigenvalues.imag > CRITICAL_TOLERANCE]
        critical_distances = abs(pairs.real) if self.kind == "HB" else abs(abs(pairs) - 1.0)
        is_double = (
            self.kind in SELF_CROSSINGS
            and np.sum(critical_distances < CRITICAL_TOLERANCE * (1.0 + abs(eigenvalues).max())) > 1
        )
        return event._replace(kind=SELF_CROSSINGS[self.kind]) if is_double else None

    def locate_codim2_events(self, task, points):
        """Yield the `Event` objects at zeros of the leading normal-form coefficient and at `RESONANCE_ANGLES` on NS."""
        for label, codim2_function in self.codim2_functions(task.args).items():
            if label == "CP":
                tangent_products = np.sum(points.tangent[1:, -2:] * points.tangent[:-1, -2:], axis=1)
                values = np.cumprod(np.append(1.0, np.sign(tangent_products)))
            else:
                values = np.array([codim2_function(z, z) for z in points.z])
            if abs(values).max() <= ZERO_COEFFICIENT:  # it vanishes along the curve, as in area-preserving systems
                continue
            for row_before in np.flatnonzero(values[:-1] * values[1:] < 0):
                event = self.locate_zero(label, codim2_function, task, points, int(row_before))
                if event is not None:
                    yield event

    def codim2_functions(self, constants):
        """Return {label: function of (z, nearby z) that vanishes there}; for orbits without third derivatives."""
        matrix_args, is_orbit = (self.system, self.kind, self.names), self.system.kind == ORBITS

        def coefficient(z, near_z):
            return normal_form_coefficient(
                *matrix_args, z, constants, border_vectors(matrix_at(*matrix_args, near_z, constants))
            )

        def first_lyapunov(z, near_z):
            return lyapunov_coefficient(*matrix_args, z, constants)

        def angle_difference(z, near_z, offset):
            return critical_eigenvalue(self.kind, eigenvalues_at(self.system, self.names, z, constants)).real + offset

        if self.kind == "SN":
            return {"CP": coefficient}
        label = {"PD": "GPD", "SB": "DSB", "HB": "GH", "NS": "CH"}[self.kind]
        functions = {label: coefficient if self.kind in ("PD", "SB") else first_lyapunov}
        angles = (
            {label: partial(angle_difference, offset=offset) for label, offset in RESONANCE_ANGLES.items()}
            if self.kind == "NS"
            else {}
        )
        return angles if is_orbit else functions | angles

    def locate_zero(self, label, codim2_function, task, points, row_before):
        """Locate the zero of a function on the curve by Newton's method; None if it fails or leaves the interval."""
        base_z, step_length = points.z[row_before], float(points.step[row_before + 1])
        midpoint = point_at_length(task, points, row_before, 0.5 * step_length)
        start = base_z + 0.5 * step_length * points.tangent[row_before] if midpoint is None else midpoint.z

        def augmented_system(z):
            residual, jacobian = (np.asarray(array) for array in augmented_systems.evaluate(task.problem, z, task.args))
            gradient = augmented_systems.central_differences(lambda z: codim2_function(z, start), z)
            return np.append(residual, codim2_function(z, start)), np.vstack([jacobian, gradient])

        solution = augmented_systems.solve_newton(augmented_system, start)
        if solution.z is None:
            return None
        event_length = float(np.sum(task.control.scale**2 * points.tangent[row_before] * (solution.z - base_z)))
        is_inside = -0.05 * step_length <= event_length <= 1.05 * step_length
        return (
            Event(label, row_before, min(max(event_length, 0.0), step_length), solution.z, solution.residual)
            if is_inside
            else None
        )
