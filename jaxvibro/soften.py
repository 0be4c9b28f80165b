"""`soften`: a scene with soft walls in place of its rigid ones."""

from dataclasses import replace

from . import check
from .rebound import contact_damping


def soften(scene, stiffness):
    """The scene with each rigid wall replaced by a soft one that gives back the same part of the speed.

    stiffness k2 > 0, a number or an array that broadcasts with the scene; each wall's damping is the `contact_damping`
    of its restitution, so that the motions tend to those of the rigid scene like k2^(-1/2). Soft walls stay as they
    are; `scene.replace(hardness=...)` changes the stiffness of all of them afterwards.

    Raises SceneError for a stiffness that breaks its rule, and where no wall is rigid.
    """
    rigid = {side: wall for side, wall in scene.walls.items() if not wall.soft}
    if not rigid:
        raise check.SceneError("scene", "must have a rigid wall", "none")
    stiffness, changes = check.quantity("stiffness", stiffness, scene.dtype), {}
    for side, wall in rigid.items():
        damping = contact_damping(stiffness, scene.bounce(side))
        changes[side] = replace(wall, restitution=None, stiffness=stiffness, damping=damping)
    return replace(scene, **changes).replace()
