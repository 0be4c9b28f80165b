"""Check the numbers of a scene by name, and its walls together."""

import jax

from . import check
from .wall_gap import minimum_gap

FRACTION = ("must lie between 0 and 1", lambda value: (value >= 0) & (value <= 1))
POSITIVE = ("must be greater than 0", lambda value: value > 0)
NOT_NEGATIVE = ("must not be negative", lambda value: value >= 0)
RULES = {
    "frequency": POSITIVE,
    "damping": NOT_NEGATIVE,
    "restitution": FRACTION,
    "left.restitution": FRACTION,
    "right.restitution": FRACTION,
    "left.stiffness": POSITIVE,
    "right.stiffness": POSITIVE,
    "left.damping": NOT_NEGATIVE,
    "right.damping": NOT_NEGATIVE,
    "mass": POSITIVE,
    "stiffness": POSITIVE,
    "length": POSITIVE,
}
PATH_KEYS = ("name", "key", "idx")  # attributes of the path entries of a dataclass, a dict, a tuple


def check_scene(scene):
    """Return the scene itself if it breaks no rule; values are checked if they are known."""
    leaves = [(leaf_name(path), leaf) for path, leaf in jax.tree_util.tree_leaves_with_path(scene)]
    check.require_broadcast(leaves)
    for key, leaf in leaves:
        check_value(key, leaf)
    if scene.left is not None and scene.right is not None:
        require_walls_apart(scene.left, scene.right)
    return scene


def check_value(key, value):
    """Check a known value against the rule of its key, if there is one."""
    if key in RULES and not check.is_traced(value):
        rule, holds = RULES[key]
        check.require(key, rule, value, holds(value))


def leaf_name(path):
    """Return the dotted name of a leaf from its path in the tree."""
    return ".".join(str(next(getattr(step, key) for key in PATH_KEYS if hasattr(step, key))) for step in path)


def require_walls_apart(left, right):
    """Check that the walls are in order, and that they neither touch nor cross in their motion."""
    if check.is_traced(left.position, right.position):
        return
    rule = "must lie to the right of left.position"
    check.require("right.position", rule, right.position, left.position < right.position)
    if check.is_traced(*jax.tree.leaves((left.motion, right.motion))):
        return
    if left.motion is not None or right.motion is not None:
        gap = minimum_gap(left, right)
        side = "left" if right.motion is None else "right"
        check.require(
            f"{side}.motion",
            "walls must not touch or cross in their motion: the smallest gap must exceed 0",
            gap,
            gap > 0,
        )
