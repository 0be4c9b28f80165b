"""Write a scene as the Python code that makes it."""

from ..scene.scene_table import SceneTable


def scene_code(scene_table: SceneTable) -> str:
    """Return the expression that makes the scene of a table, without its scales."""
    scalar_values = {name: getattr(scene_table, name) for name in ("amplitude", "frequency", "damping", "restitution")}
    arguments = [f"{name}={value!r}" for name, value in scalar_values.items() if value is not None]
    if scene_table.left is not None or scene_table.right is not None:
        arguments.append(f"walls=({_wall_code(scene_table.left)}, {_wall_code(scene_table.right)})")
    if scene_table.force is not None:
        force_table = scene_table.force
        force_options = f"tolerance={force_table.tolerance!r}, solver={force_table.solver!r}"
        arguments.append(f"force=jv.Force({force_table.name!r}, {force_table.numbers!r}, {force_options})")
    if scene_table.drive:
        arguments.append(f"drive=[{', '.join(map(_motion_code, scene_table.drive))}]")
    return f"jv.make_scene({', '.join(arguments)})"


def scales_code(scene_table: SceneTable) -> str | None:
    """Return the expression that makes the `Scales` of a table; None if the table has no scales."""
    scales_table = scene_table.scales
    return (
        None
        if scales_table is None
        else f"jv.Scales({scales_table.mass!r}, {scales_table.stiffness!r}, {scales_table.length!r})"
    )


def _wall_code(wall_table):
    if wall_table is None:
        return "None"
    arguments = [repr(wall_table.position)]
    scalar_values = {name: getattr(wall_table, name) for name in ("restitution", "stiffness", "damping")}
    arguments += [f"{name}={value!r}" for name, value in scalar_values.items() if value is not None]
    if wall_table.motion is not None:
        arguments.append(f"motion={_motion_code(wall_table.motion)}")
    if wall_table.law is not None:
        arguments.append(f"law=jv.Push({wall_table.law.name!r}, {wall_table.law.numbers!r})")
    return f"jv.Wall({', '.join(arguments)})"


def _motion_code(motion_table):
    return f"jv.Motion({motion_table.amplitude!r}, {motion_table.phase!r}, {motion_table.harmonic!r})"
