"""Fill JAX's compile cache with the code that the first calls for a scene compile."""

from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import NamedTuple

import jax

from continuation import numpy_evaluation
from continuation.cache_file import reason_for_distrust
from continuation.persistent_jit import cache_folder

from ..attractors.find import find_attractors
from ..branches.follow import follow
from ..branches.switch import switch
from ..loci.locus import locus
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
        Completed steps in order, with their processor time in s.
    left : tuple of str
        Steps that are not possible for this scene, with the reasons.
    """

    folder: Path
    done: tuple[tuple[str, float], ...]
    left: tuple[str, ...]


@check.host_only("call strobe or monodromy")
def warm(scene: Scene | None = None, progress: Callable[[str], object] | None = None) -> Warmed:
    """Run the usual first steps for a scene, so that JAX's compile cache keeps their code.

    The steps are a strobe, its orbit, the branch of that orbit along the amplitude, the branches that bifurcate from
    its special points, a locus of each kind of special point in amplitude and frequency, and the attractors.

    Parameters
    ----------
    scene : Scene, optional
        Single scene. None takes the scene of the README.
    progress : callable, optional
        Function that is called with the name of each step before it.

    Returns
    -------
    Warmed
        Cache folder, completed steps and omitted steps.

    Raises
    ------
    ArgumentError
        If the scene is a batch, JAX has no compile cache, or other users can write to its folder.

    Notes
    -----
    In a later process with this cache these steps compile nothing for scenes with the same kinds of walls, for orbits
    with as many impacts up to a power of two. JAX keeps only code that takes longer to compile than its setting
    ``jax_persistent_cache_min_compile_time_secs``, 1 s by default. Set it to 0.

    Examples
    --------
    >>> warmed = jv.warm(scene)  # doctest: +SKIP
    >>> [name for name, _ in warmed.done][:3]  # doctest: +SKIP
    ['strobe', 'find_orbit', 'follow']
    """
    folder = cache_folder()
    if not folder:
        raise check.ArgumentError("jax_compilation_cache_dir", "must be set: there is no cache to fill", folder)
    if reason := reason_for_distrust(Path(folder)):
        rule = "must be a folder that no other user can write to, because its contents are executed"
        raise check.ArgumentError("jax_compilation_cache_dir", rule, reason)
    scene = make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0)) if scene is None else scene
    check.require_single(scene)
    steps, failures = [], []

    def run_step(step_name, function, *arguments):
        start_time = process_time()
        if progress is not None:
            progress(step_name)
        try:
            result = function(*arguments)
        except (OrbitError, check.ArgumentError, ArithmeticError) as error:
            failures.append(f"{step_name}: {error}")
            return None
        steps.append((step_name, process_time() - start_time))
        return result

    previous_patience, numpy_evaluation.MAX_EVALUATIONS = numpy_evaluation.MAX_EVALUATIONS, 0
    try:
        _run_steps(scene, run_step)
    finally:
        numpy_evaluation.MAX_EVALUATIONS = previous_patience
    return Warmed(Path(folder), tuple(steps), tuple(failures))


def _run_steps(scene, run_step):
    """Run the steps in order; later steps need the results of earlier ones."""
    amplitude, frequency = (float(scene.parameter(name)) for name in ("amplitude", "frequency"))
    bounds = {"amplitude": (0.0, BOUND_FACTOR * max(1.0, amplitude)), "frequency": (0.7 * frequency, 1.4 * frequency)}
    start = jax.tree.map(lambda leaf: leaf[0], draw_initial_states(scene, 1, (0,)))
    strobe_result = run_step("strobe", strobe, scene, start)
    orbit = strobe_result and run_step("find_orbit", find_orbit, scene, strobe_result[0])
    branch = orbit and run_step("follow", follow, orbit, "amplitude", bounds["amplitude"])
    special_points = {special.kind: special for special in branch.special} if branch else {}
    for kind in (candidate for candidate in SWITCH_KINDS if candidate in special_points):
        run_step(f"switch at {kind}", switch, special_points[kind])
    for kind in (candidate for candidate in LOCUS_KINDS if candidate in special_points):
        run_step(f"locus of {kind}", locus, special_points[kind], ("amplitude", "frequency"), bounds)
    run_step("find_attractors", find_attractors, scene)
