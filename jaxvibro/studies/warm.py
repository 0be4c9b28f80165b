"""Fill the compile cache of JAX by running the usual first calls for a scene."""

from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import NamedTuple

import jax

from continuation.hostcall import compile_at_once, jax_cache_folder, reason_for_distrust

from ..attractors.find import find_attractors
from ..branches.follow import follow
from ..loci.locus import locus
from ..loci.switch import switch
from ..maps.initial_conditions import draw_initial_states
from ..maps.strobe import strobe
from ..orbits.find import find_orbit
from ..orbits.orbit import OrbitError
from ..scene import check
from ..scene.scene import Scene, make_scene

# Kinds of special points for `switch` and for `locus`.
SWITCH_KINDS, LOCUS_KINDS = ("SB", "BP", "PD"), ("SN", "SB", "PD", "GR")
BOUND_FACTOR = 3.0  # upper bound of the amplitude over its value, or over 1 if that is larger


class Warmed(NamedTuple):
    """Results of `warm`.

    Attributes
    ----------
    folder : Path
        Folder of the compile cache.
    done : tuple of (str, float)
        Completed steps in order, each with its processor time in s.
    left : tuple of str
        Steps that are not possible for this scene, each with the reason.
    """

    folder: Path
    done: tuple[tuple[str, float], ...]
    left: tuple[str, ...]


@check.host_only("call strobe or monodromy")
def warm(scene: Scene | None = None, progress: Callable[[str], object] | None = None) -> Warmed:
    """Run the usual first steps for a scene, so that the compile cache of JAX stores their code.

    The first steps are a stroboscopic map, the orbit that its final state approaches, and the branch of this orbit
    along the amplitude. The next steps are the branches that bifurcate from the special points of this branch, and a
    locus of each kind of special point in amplitude and frequency. The last step finds the attractors.

    Parameters
    ----------
    scene : Scene, optional
        Single scene. None uses the scene of the README.
    progress : callable, optional
        Function that is called with the name of each step before the step runs.

    Returns
    -------
    Warmed
        Cache folder, completed steps and omitted steps.

    Raises
    ------
    ArgumentError
        If the scene is a batch, JAX has no compile cache, or other users can write to the folder of the cache.

    Notes
    -----
    A later process with this cache compiles nothing in these steps if the scene has the same kinds of walls, and the
    number of impacts of the orbit, rounded up to a power of two, is the same. JAX stores only code whose compilation
    takes longer than the setting ``jax_persistent_cache_min_compile_time_secs``, 1 s by default. Set it to 0.

    Examples
    --------
    >>> warmed = jv.warm(scene)  # doctest: +SKIP
    >>> [name for name, _ in warmed.done][:3]  # doctest: +SKIP
    ['strobe', 'find_orbit', 'follow']
    """
    cache_path = jax_cache_folder()
    if not cache_path:
        raise check.ArgumentError("jax_compilation_cache_dir", "must be set: there is no cache to fill", cache_path)
    if distrust_reason := reason_for_distrust(Path(cache_path)):
        rule = "must be a folder that no other user can write to, because its contents are executed"
        raise check.ArgumentError("jax_compilation_cache_dir", rule, distrust_reason)
    scene = make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0)) if scene is None else scene
    check.require_single_scene(scene)
    completed_steps, failed_step_texts = [], []

    def try_step(step_name, function, *arguments):
        start_time = process_time()
        if progress is not None:
            progress(step_name)
        try:
            step_result = function(*arguments)
        except (OrbitError, check.ArgumentError, ArithmeticError) as error:
            failed_step_texts.append(f"{step_name}: {error}")
            return None
        completed_steps.append((step_name, process_time() - start_time))
        return step_result

    with compile_at_once():
        _run_first_steps(scene, try_step)
    return Warmed(Path(cache_path), tuple(completed_steps), tuple(failed_step_texts))


def _run_first_steps(scene, try_step):
    """Run all steps in order; `try_step` returns None for a step that is not possible."""
    amplitude, frequency = (float(scene.parameter(parameter_name)) for parameter_name in ("amplitude", "frequency"))
    parameter_bounds = {
        "amplitude": (0.0, BOUND_FACTOR * max(1.0, amplitude)),
        "frequency": (0.7 * frequency, 1.4 * frequency),
    }
    initial_state = jax.tree.map(lambda leaf: leaf[0], draw_initial_states(scene, 1, (0,)))
    strobe_result = try_step("strobe", strobe, scene, initial_state)
    orbit = strobe_result and try_step("find_orbit", find_orbit, scene, strobe_result[0])
    branch = orbit and try_step("follow", follow, orbit, "amplitude", parameter_bounds["amplitude"])
    special_by_kind = {special_point.kind: special_point for special_point in branch.special} if branch else {}
    for kind in (available_kind for available_kind in SWITCH_KINDS if available_kind in special_by_kind):
        try_step(f"switch at {kind}", switch, special_by_kind[kind])
    for kind in (available_kind for available_kind in LOCUS_KINDS if available_kind in special_by_kind):
        try_step(f"locus of {kind}", locus, special_by_kind[kind], ("amplitude", "frequency"), parameter_bounds)
    try_step("find_attractors", find_attractors, scene)
