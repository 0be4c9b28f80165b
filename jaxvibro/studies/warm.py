"""`warm`: jax's compile cache filled with what the first questions about a scene compile."""

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

SWITCH_KINDS, LOCUS_KINDS = (
    ("SB", "BP", "PD"),
    ("SN", "SB", "PD", "GR"),
)  # kinds of points: left by `switch`, followed by `locus`
BOUND_FACTOR = 3.0  # times the amplitude, or 1 where that is less: its upper bound


class Warmed(NamedTuple):
    """What was done. folder: of the cache; done: (what was asked, processor seconds) in order; left: what could not be
    asked of this scene, and why."""

    folder: Path
    done: tuple[tuple[str, float], ...]
    left: tuple[str, ...]


@check.host_only("call strobe or monodromy")
def warm(scene: Scene | None = None, progress: Callable[[str], object] | None = None) -> Warmed:
    """Ask of a scene what is asked first, all of it compiled, so that jax's compile cache keeps it: a `Warmed`.

    scene: a single one, None that of the README; progress: called with what is asked next. Asked are a strobe, the
    orbit it settles on, the branch through that along the amplitude, the branches that leave its special points, a
    locus of each kind of these in amplitude and frequency, and what the scene settles on. Scenes of the same kind of
    walls then compile nothing for these in a later process with this cache, for orbits with as many impacts, up to a
    power of two. jax keeps what took longer to compile than its jax_persistent_cache_min_compile_time_secs, a second: 0
    is meant here.

    Raises ArgumentError for a batch of scenes, where jax has no compile cache, and where others can write to it.
    """
    folder = cache_folder()
    if not folder:
        raise check.ArgumentError("jax_compilation_cache_dir", "must be set: there is no cache to fill", folder)
    if reason := reason_for_distrust(Path(folder)):
        rule = "must be a folder that no one else can write to, as what lies in it is executed"
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
