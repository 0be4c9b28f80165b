"""`diagrams`: what `explore` gives, for each value of another parameter."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from jaxtyping import ArrayLike, Real

from continuation.limits import EXPIRED, UNLIMITED, Results, limits_of, partial_reason

from ..scene import check
from ..scene.parameters import values_of
from ..scene.scene import Scene
from ..stores.filling import Store, done
from .diagram import Diagram
from .diagram_study import DiagramStudy, unpacked
from .explore import check_arguments, explore_on, settled_on


@check.host("use strobe or monodromy")
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
    check.require_known(name, scene.names, name)
    given = values_of(scene, third, values)
    if third == name:
        raise check.ArgumentError("third", "must be another parameter than name", third)
    scenes = [scene.replace(**{third: value}) for value in given]
    tasks = [check_arguments(each, name, bounds, max_period, seed, budget, largest_step) for each in scenes]
    own = limits if store is None else replace(UNLIMITED, points=limits.points)  # no diagram's bits depend on timing
    tasks = [each._replace(steps=each.steps | {"limits": own}) for each in tasks]
    if store is None:
        found = [explore_on(*each, progress) for each in zip(tasks, settled_on(tasks), strict=True)]
    else:
        study = DiagramStudy(third, given, tuple(tasks))
        data = done(study, store, progress and (lambda one: progress(one.done)), limits)
        rows = zip(tasks, data["content"].values, data["size"].values, strict=True)
        found = [_empty(task) if size < 0 else unpacked(row[:size].tobytes()) for task, row, size in rows]
    count = sum(one.reason != EXPIRED for one in found)
    return Results(found, "" if count == len(found) else partial_reason(count, len(found), "values"))


def _empty(task):
    """The `Diagram` of a task that has not been begun."""
    return Diagram(task.name, task.bounds, task.scene, (), (), False, EXPIRED, task.settings)
