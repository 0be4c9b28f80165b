"""`diagrams`: what `explore` gives, for each value of another parameter."""

from collections.abc import Callable, Sequence

from jaxtyping import ArrayLike, Real

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
) -> tuple[Diagram, ...]:
    """The periodic orbits along a parameter for each value of another: a tuple of `Diagram`, one a value.

    third: a parameter of the scene other than name; values: of it, a row of one at least, in any order; its value in
    the scene does not matter. The other arguments, and each diagram, are as of `explore`; the budget is of each, and
    progress is called with the number of branches of the one at hand. The random starts of all values are settled
    together, then one is explored after the other. store: a `Store` to keep the diagrams in, a value at a time, and to
    go on with; progress is then given values. Numbers in it are those of other runs to rounding.

    Raises ArgumentError for arguments that cannot be, and what the store raises.
    """
    check.require_single(scene)
    check.require_known(name, scene.names, name)
    given = values_of(scene, third, values)
    if third == name:
        raise check.ArgumentError("third", "must be another parameter than name", third)
    scenes = [scene.replace(**{third: value}) for value in given]
    tasks = [check_arguments(each, name, bounds, max_period, seed, budget, largest_step) for each in scenes]
    if store is not None:
        data = done(DiagramStudy(third, given, tuple(tasks)), store, progress and (lambda one: progress(one.done)))
        rows = zip(data["content"].values, data["size"].values, strict=True)
        return tuple(unpacked(row[:size].tobytes()) for row, size in rows)
    return tuple(explore_on(*each, progress) for each in zip(tasks, settled_on(tasks), strict=True))
