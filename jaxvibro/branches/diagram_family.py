"""`diagrams`: what `explore` gives, for each value of another parameter."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from jaxtyping import ArrayLike, Real

from continuation.limits import EXPIRED_REASON, UNLIMITED, Results, limits_of, partial_reason

from ..scene import check
from ..scene.parameters import check_values
from ..scene.scene import Scene
from ..stores.filling import Store, complete_study
from .diagram import Diagram
from .diagram_study import DiagramStudy, unpack_diagram
from .explore import make_exploration_task, run_exploration, seed_orbits_of_tasks


@check.host_only("use strobe or monodromy")
def diagrams(
    scene: Scene,
    name: str,
    bounds: tuple[float, float],
    third: str,
    values: Real[ArrayLike, " values"] | Sequence[float],
    max_period: int = 8,
    seed: int = 0,
    budget: int | None = None,
    largest_step: float = 0.1,
    progress: Callable[[int], object] | None = None,
    store: Store | None = None,
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
) -> Results[Diagram]:
    """The periodic orbits along a parameter for each value of another: a tuple of `Diagram`, one a value.

    third: a parameter of the scene other than name; values: of it, a row of one at least, in any order; its value in
    the scene does not matter. The other arguments, and each diagram, are as of `explore`; the budget is of each, and
    progress is called with the number of branches of the one at hand. The random starts of all values are settled
    together, then one is explored after the other. store: a `Store` to keep the diagrams in, a value at a time, and to
    go on with; progress is then given values. Numbers in it are those of other runs to rounding.

    max_points: largest number of points of each branch; max_seconds: wall-clock time, s, of all diagrams; None is no
    limit. Once it is over the diagram at hand ends as in `explore`, or with a store is completed, and those of further
    values have no branches; their `reason` says so, and so does the attribute `stopped` of the tuple, else "". A later
    call with the same store goes on.

    Raises ArgumentError for arguments that cannot be, and what the store raises.
    """
    limits = limits_of(max_points, max_seconds, None, check.ArgumentError)
    check.require_single(scene)
    check.require_parameter(name, scene.names, name)
    third_values = check_values(scene, third, values)
    if third == name:
        raise check.ArgumentError("third", "must be another parameter than name", third)
    scenes = [scene.replace(**{third: value}) for value in third_values]
    tasks = [make_exploration_task(entry, name, bounds, max_period, seed, budget, largest_step) for entry in scenes]
    task_limits = (
        limits if store is None else replace(UNLIMITED, points=limits.points)
    )  # no diagram's bits depend on timing
    tasks = [entry._replace(step_settings=entry.step_settings | {"limits": task_limits}) for entry in tasks]
    if store is None:
        results = [run_exploration(*entry, progress) for entry in zip(tasks, seed_orbits_of_tasks(tasks), strict=True)]
    else:
        study = DiagramStudy(third, third_values, tuple(tasks))
        data = complete_study(study, store, progress and (lambda store_progress: progress(store_progress.done)), limits)
        rows = zip(tasks, data["content"].values, data["size"].values, strict=True)
        results = [
            _empty_diagram(task) if n_bytes < 0 else unpack_diagram(row[:n_bytes].tobytes())
            for task, row, n_bytes in rows
        ]
    n_complete = sum(diagram.reason != EXPIRED_REASON for diagram in results)
    return Results(results, "" if n_complete == len(results) else partial_reason(n_complete, len(results), "values"))


def _empty_diagram(task):
    """The `Diagram` of a task that has not been begun."""
    return Diagram(task.name, task.bounds, task.scene, (), (), False, EXPIRED_REASON, task.settings)
