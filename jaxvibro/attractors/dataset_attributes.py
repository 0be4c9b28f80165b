"""Describe the scene of a survey in the attributes and coordinates of its Dataset."""

import numpy as np

from ..output.units import scales_attributes
from ..scene.state import Status

REBOUND_TEXT = "y+ - v_b = -restitution (y- - v_b) at a rigid wall"
STATUS_FLAGS = {"flag_values": [int(code) for code in Status], "flag_meanings": " ".join(code.word for code in Status)}
UNITS_TEXT = "lengths in that of the walls, time t in 1/w0"


def survey_attributes(scene, **survey_fields):
    """Return the attributes of the Dataset of a survey that describe its scene, except for the parameters.

    Parameters
    ----------
    scene : Scene
        Scene.
    **survey_fields : object
        Further attributes, for example the swept parameter.

    Returns
    -------
    dict of str to object
        Equation, units, further attributes, names of the walls, harmonics of the moving walls and of the drive terms,
        and scales.
    """
    return {
        "equation": equation_text(scene),
        "units": UNITS_TEXT,
        **survey_fields,
        "walls": " ".join(scene.walls) or "none",
        **{
            f"{side}.motion.harmonic": wall.motion.harmonic
            for side, wall in scene.walls.items()
            if wall.motion is not None
        },
        **{f"drive.{term_index}.harmonic": drive_term.harmonic for term_index, drive_term in enumerate(scene.drive)},
        **scales_attributes(scene),
    }


def add_fixed_values(coords, attrs, fixed_values, lane_dims, lane_shape):
    """Add values that are not swept to the coordinates of a Dataset if they have lanes, else to its attributes.

    Parameters
    ----------
    coords : dict
        Coordinates, which are changed.
    attrs : dict
        Attributes, which are changed.
    fixed_values : dict of str to array
        Values by name, numbers or arrays that broadcast with the lanes.
    lane_dims : str or list of str
        Dimensions of the lanes.
    lane_shape : tuple of int
        Number of lanes along each dimension.
    """
    for name, value in fixed_values.items():
        if np.ndim(value):
            coords[name] = (lane_dims, np.broadcast_to(value, lane_shape))
        else:
            attrs[name] = float(value)


def other_parameters(scene, name):
    """Return the parameters that are not swept.

    The result omits the hardness and the parameters that a wall takes from the scene. If the hardness is swept, the
    result also omits the stiffness and the damping of the soft walls.

    Parameters
    ----------
    scene : Scene
        Scene.
    name : str
        Swept parameter.

    Returns
    -------
    dict of str to array
        Values of the other parameters by name.
    """
    dependent_names = [f"{side}.{name}" for side, wall in scene.walls.items() for name in wall.taken]
    dependent_names += [
        f"{side}.{wall_parameter}"
        for side in scene.soft_sides
        for wall_parameter in ("stiffness", "damping")
        if name == "hardness"
    ]
    dependent_names.append("hardness")
    return {
        parameter_name: scene.parameter(parameter_name)
        for parameter_name in scene.names
        if parameter_name != name and parameter_name not in dependent_names
    }


def equation_text(scene):
    """Return the equation of motion and the impact law as text, for files.

    Parameters
    ----------
    scene : Scene
        Scene.

    Returns
    -------
    str
        Equation of motion and impact law.
    """
    drive_term_texts = [
        f" + drive.{term_index}.amplitude cos({drive_term.harmonic} frequency t + drive.{term_index}.phase)"
        for term_index, drive_term in enumerate(scene.drive)
    ]
    return f"{scene.flow_kind.equation(scene)}{''.join(drive_term_texts)}, {REBOUND_TEXT}"
