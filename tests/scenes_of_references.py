"""Batches of scenes of the package from records of the references."""

import numpy as np

import jaxvibro as jv

from .reference.scene import Soft


def scene_of(scenes):
    """Return one batched scene from reference scenes of one structure."""

    def columns(records, names):
        return {name: np.array([getattr(each, name) for each in records]) for name in names}

    def wall(side):
        walls = [getattr(scene, side) for scene in scenes]
        if walls[0] is None:
            return None
        motion = None
        if walls[0].motion is not None:
            motions = [each.motion for each in walls]
            motion = jv.Motion(**columns(motions, ("amplitude", "phase")), harmonic=motions[0].harmonic)
        names = ("position", "stiffness", "damping") if isinstance(walls[0], Soft) else ("position", "restitution")
        return jv.Wall(**columns(walls, names), motion=motion)

    def term(k):
        terms = [scene.drive[k] for scene in scenes]
        return jv.Motion(**columns(terms, ("amplitude", "phase")), harmonic=terms[0].harmonic)

    plain = columns(scenes, ("amplitude", "omega", "gamma")).values()
    drive = [term(k) for k in range(len(scenes[0].drive))]
    return jv.make_scene(*plain, 0.5, (wall("left"), wall("right")), drive=drive)
