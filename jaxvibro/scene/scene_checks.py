"""Check each number of a scene against the rule for its name, and check that the walls do not touch."""

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
    """Check the numbers and the walls of a scene and return the scene; traced values are not checked."""
    named_leaves = [
        (dotted_leaf_name(leaf_path), leaf) for leaf_path, leaf in jax.tree_util.tree_leaves_with_path(scene)
    ]
    check.require_broadcast(named_leaves)
    for key, leaf in named_leaves:
        check_value(key, leaf)
    if scene.left is not None and scene.right is not None:
        require_walls_apart(scene.left, scene.right)
    return scene


def check_value(key, value):
    """Check a value against the rule of its key; a value that is traced or has no rule is not checked."""
    if key in RULES and not check.is_traced(value):
        rule, satisfies_rule = RULES[key]
        check.require(key, rule, value, satisfies_rule(value))


def dotted_leaf_name(leaf_path):
    """Return the dotted name of a leaf from its path in the tree."""
    return ".".join(
        str(next(getattr(path_entry, key) for key in PATH_KEYS if hasattr(path_entry, key))) for path_entry in leaf_path
    )


def require_walls_apart(left_wall, right_wall):
    """Check that the walls are in order, and that they neither touch nor cross while they move."""
    if check.is_traced(left_wall.position, right_wall.position):
        return
    rule = "must lie to the right of left.position"
    check.require("right.position", rule, right_wall.position, left_wall.position < right_wall.position)
    if check.is_traced(*jax.tree.leaves((left_wall.motion, right_wall.motion))):
        return
    if left_wall.motion is not None or right_wall.motion is not None:
        min_gap = minimum_gap(left_wall, right_wall)
        moving_side = "left" if right_wall.motion is None else "right"
        check.require(
            f"{moving_side}.motion",
            "walls must not touch or cross in their motion: the smallest gap must exceed 0",
            min_gap,
            min_gap > 0,
        )
