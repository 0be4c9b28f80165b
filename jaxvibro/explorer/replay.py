"""What a file's [[view]] asked, done again."""

from collections.abc import Mapping, Sequence
from typing import Any

from ..scene.check import ArgumentError
from ..scene.scene import Scene
from ..studies.schema import ViewTable
from .lines import LOOKS, SCENE, evaluated
from .shown import Shown
from .work import Tell


def replayed(lines: Sequence[ViewTable], scene: Scene, tell: Tell) -> dict[str, Any]:
    """{name: result} of lines. Raises ArgumentError for one that no page can have asked, and what its call raises."""
    results: dict[str, Any] = {SCENE: scene}
    for place, line in enumerate(lines, 1):
        if line.name in results:
            raise ArgumentError("view.name", "must differ from those before", line.name)
        tell(f"line {place} of {len(lines)}")
        results[line.name] = evaluated(line, results, tell)
    return results


def shown_again(first: Shown, lines: Sequence[ViewTable], results: Mapping[str, Any]) -> Shown:
    """What is shown after lines: their last scene, orbit and parameters, the others as at first."""
    scenes = [line.name for line in lines if line.call == "replace"]
    looks = [line for line in lines if line.call in LOOKS]
    found: dict[str, Any] = {"scene": scenes[-1] if scenes else SCENE}
    if looks:
        last = looks[-1]
        is_point = last.call in ("orbit", "special")
        place = last.arguments.get("place") if is_point else None
        found |= {"current": last.name, "chosen": last.of if is_point else "", "place": place}
    along = [line.arguments for line in lines if line.call in ("follow", "explore")]
    if along:
        found |= {"parameter": along[-1]["parameter"], "bounds": (along[-1]["low"], along[-1]["high"])}
        others = [line.arguments["bounds"] for line in lines if line.call in ("locus", "map")]
        pair: dict[str, Any] = next((each for each in others if found["parameter"] in each), {})
        second = next((name for name in (*pair, first.second, first.parameter) if name != found["parameter"]), None)
        if second is not None:
            found["second"] = second
            found["second_bounds"] = tuple(pair[second]) if second in pair else _own(first, second)
    return first.having(*lines, **found)


def _own(first, name):
    return first.second_bounds if name == first.second else first.bounds
