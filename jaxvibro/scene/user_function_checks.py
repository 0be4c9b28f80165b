"""Check user-defined forces and contact laws; each error names the key, the rule and the value."""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from importlib import import_module
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np

from . import check
from .force import MAX_TOLERANCE, MIN_TOLERANCE, Force, with_positional_params
from .force_operations import ops_without_series
from .predefined_forces import NAMED_FORCES, count_knots, expected_names_if_wrong, force_name, tabulated
from .push import PREDEFINED_CONTACT_LAWS, Push, hertz, hunt_crossley
from .scene_checks import NOT_NEGATIVE, POSITIVE, check_rule

N_PROBES = 64  # states at which a force is evaluated
PERIODIC_TOLERANCE = 1e-9  # largest relative difference of a force after one period
SYMMETRY_TOLERANCE = 1e-12  # largest difference from the mirror image, relative to the largest value
MAX_PROBED_SCENES = 4  # scenes of a batch whose forces are evaluated
FALLBACK_SOLVER = "Dopri8"  # the solver of a force that has an operation without a Taylor series
MIN_SOLVER_TOLERANCE = 1e-14
MAX_EXPLICIT_RATE = 1e4  # largest rate of a force, per drive period, for explicit steps
NO_EFFECTS = (
    "must not print or call Python while it runs (jax.debug.print): compiled steps may evaluate it any number of times"
)
TRACE_ADVICE = {  # advice by the name of JAX's exception
    "TracerBoolConversionError": "use jnp.where in place of if, and, or, while on t, x, v or its numbers",
    "ConcretizationTypeError": "use jax.numpy in place of math, and no float()",
    "TracerArrayConversionError": "use jax.numpy in place of numpy",
}


def check_force(key, force, to_checked_array, dtype):
    """Return the force with checked parameters and solver; ``to_checked_array(key, value)`` converts a number.

    `check_force_values` checks the rules that depend on other parameters of the scene.
    """
    class_rule = "must be a Force or None: jv.Force(function, {name: number})"
    function = check_callable("force", force, Force, class_rule, NAMED_FORCES, "t, x, v, numbers")
    expected_names_text = expected_names_if_wrong(function, force.numbers)
    if expected_names_text is not None:
        names_text = ", ".join(force.numbers) or "none"
        raise check.ArgumentError(
            "force.numbers", f"must be the parameters of {force_name(function)}: {expected_names_text}", names_text
        )
    tolerance = force.tolerance
    if not isinstance(tolerance, float) or not MIN_TOLERANCE <= tolerance <= MAX_TOLERANCE:
        raise check.ArgumentError(
            "force.tolerance", f"must be a number from {MIN_TOLERANCE} to {MAX_TOLERANCE}", tolerance
        )
    params = {name: to_checked_array(f"force.{name}", value) for name, value in force.numbers.items()}
    if function is tabulated:
        _check_tabulated_params(params)
    parameter_names, solver = tuple(params), force.solver
    _check_traceable(function, parameter_names, np.dtype(dtype))
    if solver is None and ops_without_series(function, parameter_names, np.dtype(dtype)):
        solver = FALLBACK_SOLVER
    if solver is not None:
        solver = _check_solver(solver)
        if tolerance < MIN_SOLVER_TOLERANCE:
            raise check.ArgumentError(
                "force.tolerance", f"must be at least {MIN_SOLVER_TOLERANCE} with a solver", tolerance
            )
    return replace(force, function=function, numbers=params, solver=solver)


def check_callable(key, argument, argument_class, class_rule, predefined_functions, signature_text):
    """Check the class, the function and the parameter names of a `Force` or a `Push` and return the function."""
    if not isinstance(argument, argument_class):
        raise check.ArgumentError(key, class_rule, argument)
    function = argument.function
    if isinstance(function, str):
        if function not in predefined_functions:
            choices_text = check.describe_choices(function, predefined_functions)
            rule = f"must be a function, or the name of a predefined one{choices_text}"
            raise check.ArgumentError(f"{key}.function", rule, function)
        function = predefined_functions[function]
    if not callable(function):
        raise check.ArgumentError(f"{key}.function", f"must be a function of ({signature_text})", function)
    if not isinstance(argument.numbers, Mapping):
        raise check.ArgumentError(f"{key}.numbers", "must be a dict {name: number}", argument.numbers)
    for name in argument.numbers:
        if not isinstance(name, str) or not name.isidentifier():
            raise check.ArgumentError(f"{key}.numbers", "must have names of letters, digits and _", name)
    return function


def _check_tabulated_params(params):
    """Check that the parameters of a `tabulated` force are a table."""
    n_knots = count_knots(params)
    expected_names = {f"{name_letter}{knot_index}" for name_letter in "xf" for knot_index in range(n_knots)} | {
        "damping"
    }
    if n_knots < 3 or expected_names != set(params):
        rule = "must be damping and x0, f0, x1, f1, ... of at least three positions"
        raise check.ArgumentError("force.numbers", rule, ", ".join(params))
    knot_positions = [params[f"x{knot_index}"] for knot_index in range(n_knots)]
    for knot_index, (position, next_position) in enumerate(pairwise(knot_positions)):
        if not check.is_traced(position, next_position) and not np.all(
            np.asarray(position) < np.asarray(next_position)
        ):
            raise check.ArgumentError(f"force.x{knot_index + 1}", f"must be greater than x{knot_index}", next_position)


def _check_solver(solver):
    """Check that a diffrax solver, or the name of one, has error estimates, and return the solver."""
    diffrax = import_module("diffrax")
    solver_class = getattr(diffrax, solver, None) if isinstance(solver, str) else type(solver)
    if not (isinstance(solver_class, type) and issubclass(solver_class, diffrax.AbstractAdaptiveSolver)):
        rule = "must be a diffrax solver with error estimates, such as diffrax.Dopri8(), or its name"
        raise check.ArgumentError("force.solver", rule, solver)
    try:
        solver_instance = solver_class() if isinstance(solver, str) else solver
        hash(solver_instance)
    except TypeError as error:
        raise check.ArgumentError("force.solver", f"cannot be used: {check.shorten_text(error, 80)}", solver) from None
    return solver_instance


def diffrax_solver_name(solver):
    """Return the class name of a diffrax solver with default options; raise ArgumentError for any other solver."""
    name = type(solver).__name__
    if getattr(import_module("diffrax"), name, None) is not type(solver) or solver != type(solver)():
        rule = "must be a solver that diffrax makes from its name alone to be saved"
        raise check.ArgumentError("force.solver", rule, solver)
    return name


def check_force_values(scene, is_explicit):
    """Check that the force of a scene is finite between the walls, not too stiff, and periodic with the drive.

    The force is evaluated at random states, in a batch only for the first scenes. A force may be stiff unless the steps
    are explicit.
    """
    force = scene.force
    parameter_names, dtype = tuple(force.numbers), np.dtype(scene.dtype)
    is_time_dependent = _check_traceable(force.function, parameter_names, dtype)
    params = (*force.numbers.values(), scene.frequency)
    wall_positions = [wall.position for wall in scene.walls.values()]
    if check.is_traced(*params, *wall_positions):
        return
    n_probed_scenes = min(int(np.prod(scene.shape)), MAX_PROBED_SCENES)
    values_by_lane = [
        np.broadcast_to(values, scene.shape).reshape(-1)[:n_probed_scenes] for values in (*params, *wall_positions)
    ]
    for lane_index, scene_values in enumerate(np.stack(values_by_lane, 1)):
        scene_index = (
            None
            if not scene.shape
            else tuple(int(axis_index) for axis_index in np.unravel_index(lane_index, scene.shape))
        )
        with jax.ensure_compile_time_eval():
            _probe_force(
                scene,
                scene_values[: len(parameter_names)],
                float(scene_values[len(parameter_names)]),
                list(scene_values[len(parameter_names) + 1 :]),
                is_time_dependent,
                is_explicit,
                scene_index,
            )


def is_force_odd(scene):
    """Return True if the force of a single scene is odd.

    An odd force satisfies ``force(t + T / 2, -x, -v) = -force(t, x, v)``, T being the period of the drive.
    The condition is tested at random states, up to rounding.
    """
    rng = np.random.default_rng(1)
    position_scale = max([1.0, *(abs(float(wall.position)) for wall in scene.walls.values())])
    half_period, dtype = np.pi / float(scene.frequency), scene.dtype
    t = rng.uniform(0.0, 2.0 * half_period, N_PROBES)
    x, v = position_scale * rng.uniform(-1.0, 1.0, (2, N_PROBES))
    evaluate_force = _compile_force(scene.force.function, tuple(scene.force.numbers))
    with jax.ensure_compile_time_eval():
        force_values = [
            np.asarray(
                evaluate_force(
                    *(coordinate.astype(dtype) for coordinate in force_arguments), *scene.force.numbers.values()
                )
            )
            for force_arguments in ((t, x, v), (t + half_period, -x, -v))
        ]
    return bool((abs(force_values[0] + force_values[1]) <= SYMMETRY_TOLERANCE * abs(force_values[0]).max()).all())


def _is_rigid(wall):
    return wall is not None and not wall.soft


def _probe_force(scene, params, frequency, wall_positions, is_time_dependent, is_explicit, scene_index):
    """Check the force of one scene at random states: finite, not too stiff for explicit steps, periodic."""
    force, rng = scene.force, np.random.default_rng(0)
    position_scale = max([1.0, *map(abs, wall_positions)])
    x_min = wall_positions[0] if _is_rigid(scene.left) else min([*wall_positions, 0.0]) - 2.0 * position_scale
    x_max = wall_positions[-1] if _is_rigid(scene.right) else max([*wall_positions, 0.0]) + 2.0 * position_scale
    drive_period = 2.0 * np.pi / frequency
    t, x = rng.uniform(0.0, drive_period, N_PROBES), rng.uniform(x_min, x_max, N_PROBES)
    v = rng.uniform(-2.0, 2.0, N_PROBES) * position_scale * (1.0 + frequency)
    evaluate_force = _compile_force(force.function, tuple(force.numbers))
    force_values = np.asarray(evaluate_force(*(coordinate.astype(scene.dtype) for coordinate in (t, x, v)), *params))
    invalid_indices = np.flatnonzero(~np.isfinite(force_values))
    if invalid_indices.size:
        invalid_state = {
            name: float(coordinate[invalid_indices[0]]) for name, coordinate in (("t", t), ("x", x), ("v", v))
        }
        raise check.ArgumentError(
            "force",
            f"must be finite at all possible states: it is {force_values[invalid_indices[0]]}",
            invalid_state,
            scene_index,
        )
    if is_explicit:
        motion_rates = _compile_motion_rates(force.function, tuple(force.numbers))(
            *(coordinate.astype(scene.dtype) for coordinate in (t, x, v)), *params
        )
        median_motion_rate = float(np.median(motion_rates))
        if median_motion_rate * drive_period > MAX_EXPLICIT_RATE:
            rule = f'is too stiff for explicit steps, at a rate of {median_motion_rate:.2g}: use solver="Kvaerno5"'
            raise check.ArgumentError("force", rule, force_name(force.function), scene_index)
    if is_time_dependent:
        values_after_period = np.asarray(
            evaluate_force(*(coordinate.astype(scene.dtype) for coordinate in (t + drive_period, x, v)), *params)
        )
        change_over_period = abs(values_after_period - force_values)
        is_aperiodic = change_over_period > max(PERIODIC_TOLERANCE, 64.0 * np.finfo(scene.dtype).eps) * (
            abs(force_values) + abs(force_values).max()
        )
        if is_aperiodic.any():
            worst_index = int(np.argmax(change_over_period))
            rule = (
                f"must repeat with the drive's period, {drive_period:.6g}: a period later it differs by"
                f" {change_over_period[worst_index]:.3g}"
            )
            raise check.ArgumentError("force", rule, {"t": float(t[worst_index])}, scene_index)


@lru_cache(256)
def _compile_force(function, parameter_names):
    """Return the compiled force, vectorised over states."""
    return jax.jit(
        jax.vmap(with_positional_params(function, parameter_names), (0, 0, 0, *[None] * len(parameter_names)))
    )


@lru_cache(256)
def _compile_motion_rates(function, parameter_names):
    """Return the compiled largest rate at which the linearised motion oscillates or decays, vectorised over states."""
    positional_force = with_positional_params(function, parameter_names)

    def evaluate_motion_rate(t, x, v, *params):
        ones, zeros = jnp.ones_like(x), jnp.zeros_like(x)
        stiffness, damping = (
            jax.jvp(lambda x, v: positional_force(t, x, v, *params), (x, v), x_v_direction)[1]
            for x_v_direction in ((ones, zeros), (zeros, ones))
        )
        discriminant = 0.25 * damping * damping + stiffness
        return jnp.where(discriminant < 0, jnp.sqrt(abs(stiffness)), 0.5 * abs(damping) + jnp.sqrt(abs(discriminant)))

    return jax.jit(jax.vmap(evaluate_motion_rate, (0, 0, 0, *[None] * len(parameter_names))))


@lru_cache(256)
def _check_traceable(function, parameter_names, dtype):
    """Check that two traces of a force succeed and agree; return True if the force depends on t."""
    jaxpr, second_jaxpr = (
        trace_user_function("force", function, parameter_names, dtype, 3, force_name(function), _explain_trace_error)
        for _ in range(2)
    )
    is_reproducible = len(jaxpr.consts) == len(second_jaxpr.consts)
    is_reproducible = is_reproducible and all(
        np.array_equal(first_constant, second_constant)
        for first_constant, second_constant in zip(jaxpr.consts, second_jaxpr.consts, strict=True)
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


def describe_trace_error(error, parameter_names):
    """Return the name and the text of an exception."""
    return check.shorten_text(f"{type(error).__name__}: {error}", 160) + ")"


def trace_user_function(
    key, function, parameter_names, dtype, n_arguments, function_name, explain_error=describe_trace_error
):
    """Return the `ClosedJaxpr` of a force or a contact law, traced without a cache.

    Raises ArgumentError if JAX cannot trace the function, if the function has effects, or if it returns anything but
    one number. `function_name` is the value that the message shows. `explain_error` is a function of the exception and
    the parameter names.
    """
    arguments = [jax.ShapeDtypeStruct((), dtype)] * (n_arguments + len(parameter_names))
    positional_function = with_positional_params(function, parameter_names, n_arguments)
    try:
        jaxpr, output_tree = jax.make_jaxpr(positional_function, return_shape=True)(*arguments)
    except Exception as error:
        explanation = explain_error(error, parameter_names)
        raise check.ArgumentError(key, f"cannot be traced by JAX ({explanation}", function_name) from None
    if jaxpr.effects:
        raise check.ArgumentError(key, NO_EFFECTS, function_name)
    outputs = jaxpr.out_avals
    returns_single_leaf = jax.tree.structure(output_tree) == jax.tree.structure(0.0)
    if not returns_single_leaf or outputs[0].shape != () or outputs[0].dtype != dtype:
        outputs_text = ", ".join(f"{output.dtype}{list(output.shape)}" for output in outputs) or "nothing"
        outputs_text = (
            outputs_text if returns_single_leaf or not outputs else f"{type(output_tree).__name__} of {outputs_text}"
        )
        raise check.ArgumentError(key, f"must return one number of type {dtype} for scalar arguments", outputs_text)
    return jaxpr


def _explain_trace_error(error, parameter_names):
    """Return the name and the text of an exception from tracing a force, with advice."""
    exception_name = type(error).__name__
    if exception_name in TRACE_ADVICE:
        return f"{exception_name}): {TRACE_ADVICE[exception_name]}"
    reason = describe_trace_error(error, parameter_names)
    if isinstance(error, KeyError):
        return f"{reason}: its numbers are {', '.join(parameter_names) or 'none'}"
    return f"{reason}: it is called with (t, x, v, numbers)" if "positional argument" in reason else reason


N_ARGUMENTS = 2  # depth and rate
PARAMETER_RULES = {"stiffness": POSITIVE, "dissipation": NOT_NEGATIVE}
LAW_PARAMETERS = {hertz: ("stiffness",), hunt_crossley: ("stiffness", "dissipation")}

_check_law_traceable = lru_cache(256)(trace_user_function)


def check_contact_law(key, contact_law, to_checked_array, dtype, scene_force):
    """Return a contact law with checked parameters; ``to_checked_array(key, value)`` converts a number."""
    rule = "must be a Push or None"
    function = check_callable(key, contact_law, Push, rule, PREDEFINED_CONTACT_LAWS, "depth, rate, numbers")
    if scene_force is None:
        rule = "needs a scene with a force; the spring is jv.Force('polynomial', {'c1': 1.0, 'damping': ...})"
        raise check.ArgumentError(key, rule, contact_law.function)
    params = {name: to_checked_array(f"{key}.{name}", value) for name, value in contact_law.numbers.items()}
    _check_predefined_params(key, function, params)
    _check_law_traceable(key, function, tuple(params), np.dtype(dtype), N_ARGUMENTS, function)
    if not check.is_traced(*params.values()):
        _check_zero_at_surface(key, function, params, dtype)
    return replace(contact_law, function=function, numbers=params)


def _check_predefined_params(key, function, params):
    """Check the names and the values of the parameters if the contact law is predefined."""
    if function not in LAW_PARAMETERS:
        return
    if set(params) != set(LAW_PARAMETERS[function]):
        raise check.ArgumentError(f"{key}.numbers", f"must be {', '.join(LAW_PARAMETERS[function])}", tuple(params))
    for name, value in params.items():
        check_rule(f"{key}.{name}", value, PARAMETER_RULES[name])


def _check_zero_at_surface(key, function, params, dtype):
    """Check that a contact law is 0 at depth 0 and rate 0."""
    zero = np.zeros((), dtype)
    with jax.ensure_compile_time_eval():
        surface_acceleration = np.asarray(
            _compile_positional_law(function, tuple(params))(zero, zero, *params.values())
        )
    check.require(key, "must be 0 where depth and rate are 0", surface_acceleration, surface_acceleration == 0)


@lru_cache(256)
def _compile_positional_law(function, parameter_names):
    """Return the compiled contact law as a function of depth, rate and positional parameters."""
    return jax.jit(with_positional_params(function, parameter_names, N_ARGUMENTS))
