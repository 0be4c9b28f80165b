"""Explore the periodic orbits for each value of a second parameter."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from jaxtyping import ArrayLike, Real

from continuation.computation_limits import EXPIRED_REASON, UNLIMITED, Results, make_limits, partial_result_reason

from ..scene import check
from ..scene.scene import Scene
from ..scene.scene_parameters import check_parameter_values
from ..stores.study_completion import Store, complete_study
from .diagram import Diagram
from .diagrams_study import DiagramStudy, unpack_diagram
from .explore import make_exploration_request, run_exploration, seed_orbits_of_requests


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
    """Explore the periodic orbits for each value of a second parameter.

    Parameters
    ----------
    scene : Scene
        A single scene.
    name : str
        Continuation parameter.
    bounds : tuple of float
        Lower and upper bound of the continuation parameter.
    third : str
        Another parameter of the scene. Its value in the scene is ignored.
    values : array_like
        Values of `third`, at least one, in any order.
    max_period : int, optional
        Largest number of drive periods, as in `explore`.
    seed : int, optional
        Seed of the random starts.
    budget : int, optional
        Number of branches at which the exploration of each diagram stops, as in `explore`.
    largest_step : float, optional
        Largest continuation step.
    progress : callable, optional
        Called with the number of branches of the current diagram, or with the number of completed values if `store` is
        given.
    store : Store, optional
        Store that keeps the diagram of each completed value, so that a later call resumes. Results with and without a
        store are equal up to rounding.
    max_points : int, optional
        Largest number of points of each branch. None is no limit.
    max_seconds : float, optional
        Largest wall-clock time in s for all diagrams. At this time the current diagram ends as in `explore`; with a
        store it is completed. The diagrams of further values have no branches. A later call with the same store
        resumes. None is no limit.

    Returns
    -------
    tuple of Diagram
        One diagram for each value. The attribute ``stopped`` of the tuple is empty, or states that the time limit was
        reached. The ``reason`` of each diagram that this limit ended states the same.

    Raises
    ------
    ArgumentError
        If an argument is invalid. Errors of the store are passed on.

    See Also
    --------
    explore : Explore the periodic orbits of a scene along a parameter.

    Notes
    -----
    The random starts of all values are simulated together, or one value at a time if `store` is given. The values are
    explored one after the other.

    Examples
    --------
    >>> family = jv.diagrams(scene, "amplitude", (1.8, 2.2), "restitution", [0.6, 0.7], max_period=1, budget=1)
    >>> [len(diagram) for diagram in family]
    [1, 1]
    """
    limits = make_limits(max_points, max_seconds, None, check.ArgumentError)
    check.require_single_scene(scene)
    check.require_parameter(name, scene.names, name)
    third_values = check_parameter_values(scene, third, values)
    if third == name:
        raise check.ArgumentError("third", "must differ from name", third)
    scenes = [scene.replace(**{third: value}) for value in third_values]
    requests = [
        make_exploration_request(entry, name, bounds, max_period, seed, budget, largest_step) for entry in scenes
    ]
    request_limits = (
        limits if store is None else replace(UNLIMITED, points=limits.points)
    )  # the bits of a stored diagram do not depend on timing
    requests = [entry._replace(step_settings=entry.step_settings | {"limits": request_limits}) for entry in requests]
    if store is None:
        results = [
            run_exploration(*entry, progress) for entry in zip(requests, seed_orbits_of_requests(requests), strict=True)
        ]
    else:
        study = DiagramStudy(third, third_values, tuple(requests))
        stored_data = complete_study(
            study, store, progress and (lambda store_progress: progress(store_progress.done)), limits
        )
        rows = zip(requests, stored_data["content"].values, stored_data["size"].values, strict=True)
        results = [
            _empty_diagram(request) if n_bytes < 0 else unpack_diagram(row[:n_bytes].tobytes())
            for request, row, n_bytes in rows
        ]
    n_complete = sum(diagram.reason != EXPIRED_REASON for diagram in results)
    return Results(
        results, "" if n_complete == len(results) else partial_result_reason(n_complete, len(results), "values")
    )


def _empty_diagram(request):
    """Make the `Diagram` of a request whose exploration has not started."""
    return Diagram(request.name, request.bounds, request.scene, (), (), False, EXPIRED_REASON, request.settings)
