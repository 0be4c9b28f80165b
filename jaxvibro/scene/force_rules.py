"""Check user-defined forces; each error names the key, the rule and the value."""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from importlib import import_module
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np

from . import check
from .force import MAX_TOLERANCE, MIN_TOLERANCE, Force, flat_function, trace_jaxpr
from .force_trace import ops_without_series
from .named_forces import NAMED_FORCES, count_knots, expected_parameters, force_name, tabulated

N_PROBES = 64  # states at which a force is evaluated
PERIODIC_TOLERANCE = 1e-9  # largest relative difference of a force after one period
SYMMETRY_TOLERANCE = 1e-12  # largest difference from the mirror image, relative to the largest value
MAX_PROBED_SCENES = 4  # scenes of a batch whose forces are evaluated
FALLBACK_SOLVER = "Dopri8"  # the solver of a force that has an operation without a Taylor series
MIN_SOLVER_TOLERANCE = 1e-14
MAX_EXPLICIT_RATE = 1e4  # largest rate of a force, per drive period, for explicit steps
TRACE_ADVICE = {  # advice by the name of JAX's exception
    "TracerBoolConversionError": "use jnp.where in place of if, and, or, while on t, x, v or its numbers",
    "ConcretizationTypeError": "use jax.numpy in place of math, and no float()",
    "TracerArrayConversionError": "use jax.numpy in place of numpy",
}


def check_force(force, to_array, dtype):
    """Return the force with checked parameters and its solver; ``to_array(key, value)`` converts a number.

    Rules that need other numbers of the scene are checked by `check_force_values`.
    """
    if not isinstance(force, Force):
        raise check.ArgumentError("force", "must be a Force or None: jv.Force(function, {name: number})", force)
    function = check_callable("force", force, NAMED_FORCES, "t, x, v, numbers")
    expected_names = expected_parameters(function, force.numbers)
    if expected_names is not None:
        names_text = ", ".join(force.numbers) or "none"
        raise check.ArgumentError(
            "force.numbers", f"must be the parameters of {force_name(function)}: {expected_names}", names_text
        )
    tolerance = force.tolerance
    if not isinstance(tolerance, float) or not MIN_TOLERANCE <= tolerance <= MAX_TOLERANCE:
        raise check.ArgumentError(
            "force.tolerance", f"must be a number from {MIN_TOLERANCE} to {MAX_TOLERANCE}", tolerance
        )
    params = {name: to_array(f"force.{name}", value) for name, value in force.numbers.items()}
    if function is tabulated:
        _check_table(params)
    names, solver = tuple(params), force.solver
    _check_traceable(function, names, np.dtype(dtype))
    if solver is None and ops_without_series(function, names, np.dtype(dtype)):
        solver = FALLBACK_SOLVER
    if solver is not None:
        solver = _check_solver(solver)
        if tolerance < MIN_SOLVER_TOLERANCE:
            raise check.ArgumentError(
                "force.tolerance", f"must be at least {MIN_SOLVER_TOLERANCE} with a solver", tolerance
            )
    return replace(force, function=function, numbers=params, solver=solver)


def check_callable(key, law, known_functions, signature):
    """Return the function of a `Force` or a `Push`, predefined or not, after a check of it and its parameter names."""
    function = law.function
    if isinstance(function, str):
        if function not in known_functions:
            choices_text = check.describe_choices(function, known_functions)
            rule = f"must be a function, or the name of a predefined one{choices_text}"
            raise check.ArgumentError(f"{key}.function", rule, function)
        function = known_functions[function]
    if not callable(function):
        raise check.ArgumentError(f"{key}.function", f"must be a function of ({signature})", function)
    if not isinstance(law.numbers, Mapping):
        raise check.ArgumentError(f"{key}.numbers", "must be a dict {name: number}", law.numbers)
    for name in law.numbers:
        if not isinstance(name, str) or not name.isidentifier():
            raise check.ArgumentError(f"{key}.numbers", "must have names of letters, digits and _", name)
    return function


def _check_table(params):
    """Check that the parameters of a `tabulated` force are a table."""
    n_knots = count_knots(params)
    expected_names = {f"{letter}{knot}" for letter in "xf" for knot in range(n_knots)} | {"damping"}
    if n_knots < 3 or expected_names != set(params):
        rule = "must be damping and x0, f0, x1, f1, ... of at least three positions"
        raise check.ArgumentError("force.numbers", rule, ", ".join(params))
    knot_positions = [params[f"x{knot}"] for knot in range(n_knots)]
    for knot, (position, next_position) in enumerate(pairwise(knot_positions)):
        if not check.is_traced(position, next_position) and not np.all(
            np.asarray(position) < np.asarray(next_position)
        ):
            raise check.ArgumentError(f"force.x{knot + 1}", f"must be greater than x{knot}", next_position)


def _check_solver(solver):
    """Return a diffrax solver, given by itself or by its name, after a check that it estimates errors."""
    diffrax = import_module("diffrax")
    solver_class = getattr(diffrax, solver, None) if isinstance(solver, str) else type(solver)
    if not (isinstance(solver_class, type) and issubclass(solver_class, diffrax.AbstractAdaptiveSolver)):
        rule = "must be a diffrax solver with error estimates, such as diffrax.Dopri8(), or its name"
        raise check.ArgumentError("force.solver", rule, solver)
    try:
        instance = solver_class() if isinstance(solver, str) else solver
        hash(instance)
    except TypeError as error:
        raise check.ArgumentError("force.solver", f"cannot be used: {check.shorten(error, 80)}", solver) from None
    return instance


def solver_name(solver):
    """Return the name with which diffrax makes an equal solver, or None."""
    name = type(solver).__name__
    return name if getattr(import_module("diffrax"), name, None) is type(solver) and solver == type(solver)() else None


def flow_text(force, dtype):
    """Return the sentence that names the steps under a force, and the reason."""
    accuracy_text = f"to {force.tolerance:g}"
    operations = ops_without_series(force.function, tuple(force.numbers), np.dtype(dtype))
    if force.solver is None:
        return f"Taylor steps {accuracy_text}: each operation of the force has a Taylor series"
    reason = f"no Taylor series is known for {', '.join(operations)}" if operations else "selected by the user"
    return f"steps of diffrax's {type(force.solver).__name__} {accuracy_text}: {reason}"


def check_force_values(scene):
    """Check that the force of a scene is real and finite between the walls, and repeats with the drive."""
    force = scene.force
    if force.solver is not None and scene.soft_sides:
        operations = ops_without_series(force.function, tuple(force.numbers), np.dtype(scene.dtype))
        reason = f", which do not exist for {', '.join(operations)}" if operations else ""
        raise check.ArgumentError(
            "force.solver", f"must be None with a soft wall, where a force needs Taylor steps{reason}", force.solver
        )
    names, dtype = tuple(force.numbers), np.dtype(scene.dtype)
    is_time_dependent = _check_traceable(force.function, names, dtype)
    params = (*force.numbers.values(), scene.frequency)
    wall_positions = [wall.position for wall in scene.walls.values()]
    if check.is_traced(*params, *wall_positions):
        return
    n_scenes = min(int(np.prod(scene.shape)), MAX_PROBED_SCENES)
    lane_values = [np.broadcast_to(values, scene.shape).reshape(-1)[:n_scenes] for values in (*params, *wall_positions)]
    for lane, scene_values in enumerate(np.stack(lane_values, 1)):
        index = None if not scene.shape else tuple(int(i) for i in np.unravel_index(lane, scene.shape))
        with jax.ensure_compile_time_eval():
            _probe_force(
                scene,
                scene_values[: len(names)],
                float(scene_values[len(names)]),
                list(scene_values[len(names) + 1 :]),
                is_time_dependent,
                index,
            )


def is_odd(scene):
    """Return True if the force of a single scene is odd: -force(t, x, v) half a period later at -x, -v."""
    rng = np.random.default_rng(1)
    scale = max([1.0, *(abs(float(wall.position)) for wall in scene.walls.values())])
    half_period, dtype = np.pi / float(scene.frequency), scene.dtype
    t = rng.uniform(0.0, 2.0 * half_period, N_PROBES)
    x, v = scale * rng.uniform(-1.0, 1.0, (2, N_PROBES))
    evaluate = _compile_force(scene.force.function, tuple(scene.force.numbers))
    with jax.ensure_compile_time_eval():
        forces = [
            np.asarray(evaluate(*(coordinate.astype(dtype) for coordinate in point), *scene.force.numbers.values()))
            for point in ((t, x, v), (t + half_period, -x, -v))
        ]
    return bool((abs(forces[0] + forces[1]) <= SYMMETRY_TOLERANCE * abs(forces[0]).max()).all())


def _is_rigid(wall):
    return wall is not None and not wall.soft


def _probe_force(scene, params, frequency, wall_positions, is_time_dependent, index):
    """Check the force of one scene at random states: finite, not too stiff for the solver, periodic."""
    force, rng = scene.force, np.random.default_rng(0)
    scale = max([1.0, *map(abs, wall_positions)])
    x_min = wall_positions[0] if _is_rigid(scene.left) else min([*wall_positions, 0.0]) - 2.0 * scale
    x_max = wall_positions[-1] if _is_rigid(scene.right) else max([*wall_positions, 0.0]) + 2.0 * scale
    period = 2.0 * np.pi / frequency
    t, x = rng.uniform(0.0, period, N_PROBES), rng.uniform(x_min, x_max, N_PROBES)
    v = rng.uniform(-2.0, 2.0, N_PROBES) * scale * (1.0 + frequency)
    evaluate = _compile_force(force.function, tuple(force.numbers))
    values = np.asarray(evaluate(*(coordinate.astype(scene.dtype) for coordinate in (t, x, v)), *params))
    invalid = np.flatnonzero(~np.isfinite(values))
    if invalid.size:
        location = {name: float(coordinate[invalid[0]]) for name, coordinate in (("t", t), ("x", x), ("v", v))}
        raise check.ArgumentError(
            "force", f"must be finite at all possible states: it is {values[invalid[0]]}", location, index
        )
    if force.solver is None or not isinstance(force.solver, import_module("diffrax").AbstractImplicitSolver):
        rates = _compile_rates(force.function, tuple(force.numbers))(
            *(coordinate.astype(scene.dtype) for coordinate in (t, x, v)), *params
        )
        median_rate = float(np.median(rates))
        if median_rate * period > MAX_EXPLICIT_RATE:
            rule = f'is too stiff for explicit steps, at a rate of {median_rate:.2g}: use solver="Kvaerno5"'
            raise check.ArgumentError("force", rule, force_name(force.function), index)
    if is_time_dependent:
        next_values = np.asarray(
            evaluate(*(coordinate.astype(scene.dtype) for coordinate in (t + period, x, v)), *params)
        )
        change = abs(next_values - values)
        differs = change > max(PERIODIC_TOLERANCE, 64.0 * np.finfo(scene.dtype).eps) * (abs(values) + abs(values).max())
        if differs.any():
            worst = int(np.argmax(change))
            rule = (
                f"must repeat with the drive's period, {period:.6g}: a period later it differs by {change[worst]:.3g}"
            )
            raise check.ArgumentError("force", rule, {"t": float(t[worst])}, index)


@lru_cache(256)
def _compile_force(function, names):
    """Return the compiled force at many states."""
    return jax.jit(jax.vmap(flat_function(function, names), (0, 0, 0, *[None] * len(names))))


@lru_cache(256)
def _compile_rates(function, names):
    """Return the compiled rate at which a motion turns or decays: the larger rate of the linearised force."""
    flat_force = flat_function(function, names)

    def evaluate_rate(t, x, v, *params):
        ones, zeros = jnp.ones_like(x), jnp.zeros_like(x)
        stiffness, damping = (
            jax.jvp(lambda x, v: flat_force(t, x, v, *params), (x, v), direction)[1]
            for direction in ((ones, zeros), (zeros, ones))
        )
        discriminant = 0.25 * damping * damping + stiffness
        return jnp.where(discriminant < 0, jnp.sqrt(abs(stiffness)), 0.5 * abs(damping) + jnp.sqrt(abs(discriminant)))

    return jax.jit(jax.vmap(evaluate_rate, (0, 0, 0, *[None] * len(names))))


@lru_cache(256)
def _check_traceable(function, names, dtype):
    """Return whether the force depends on t; check that it can be traced, and twice with the same result."""
    try:
        jaxpr, second_jaxpr = (trace_jaxpr(function, names, dtype) for _ in range(2))
        output_shapes = jax.eval_shape(
            flat_function(function, names), *[jax.ShapeDtypeStruct((), dtype)] * (3 + len(names))
        )
    except Exception as error:
        raise check.ArgumentError(
            "force", f"cannot be traced by JAX ({_error_reason(error, names)}", force_name(function)
        ) from None
    outputs = jaxpr.out_avals
    is_single = jax.tree.structure(output_shapes) == jax.tree.structure(0.0)
    if not is_single or outputs[0].shape != () or outputs[0].dtype != dtype:
        outputs_text = ", ".join(f"{output.dtype}{list(output.shape)}" for output in outputs) or "nothing"
        outputs_text = outputs_text if is_single or not outputs else f"{type(output_shapes).__name__} of {outputs_text}"
        raise check.ArgumentError("force", f"must return one number of type {dtype} for scalar arguments", outputs_text)
    is_reproducible = len(jaxpr.consts) == len(second_jaxpr.consts)
    is_reproducible = is_reproducible and all(
        np.array_equal(a, b) for a, b in zip(jaxpr.consts, second_jaxpr.consts, strict=True)
    )
    if not is_reproducible or str(jaxpr) != str(second_jaxpr):
        raise check.ArgumentError(
            "force",
            "must be the same in each trace: it depends on something besides its arguments",
            force_name(function),
        )
    time_variable = jaxpr.jaxpr.invars[0]
    return (
        any(variable is time_variable for eqn in jaxpr.jaxpr.eqns for variable in eqn.invars)
        or jaxpr.jaxpr.outvars[0] is time_variable
    )


def _error_reason(error, names):
    """Return the name and text of an exception from tracing a force, with the advice for it."""
    name = type(error).__name__
    if name in TRACE_ADVICE:
        return f"{name}): {TRACE_ADVICE[name]}"
    reason = check.shorten(f"{name}: {error}", 160) + ")"
    if isinstance(error, KeyError):
        return f"{reason}: its numbers are {', '.join(names) or 'none'}"
    return f"{reason}: it is called with (t, x, v, numbers)" if "positional argument" in reason else reason
