"""Write a scene as the Python code that makes it."""

from ..scene.scene_table import SceneTable


def scene_code(table: SceneTable) -> str:
    """Return the expression that makes the scene of a table, without its scales."""
    numbers = {name: getattr(table, name) for name in ("amplitude", "frequency", "damping", "restitution")}
    arguments = [f"{name}={value!r}" for name, value in numbers.items() if value is not None]
    if table.left is not None or table.right is not None:
        arguments.append(f"walls=({_wall_code(table.left)}, {_wall_code(table.right)})")
    if table.force is not None:
        force = table.force
        options = f"tolerance={force.tolerance!r}, solver={force.solver!r}"
        arguments.append(f"force=jv.Force({force.name!r}, {force.numbers!r}, {options})")
    if table.drive:
        arguments.append(f"drive=[{', '.join(map(_motion_code, table.drive))}]")
    return f"jv.make_scene({', '.join(arguments)})"


def scales_code(table: SceneTable) -> str | None:
    """Return the expression that makes the `Scales` of a table; None without scales."""
    scales = table.scales
    return None if scales is None else f"jv.Scales({scales.mass!r}, {scales.stiffness!r}, {scales.length!r})"


def _wall_code(table):
    if table is None:
        return "None"
    arguments = [repr(table.position)]
    numbers = {name: getattr(table, name) for name in ("restitution", "stiffness", "damping")}
    arguments += [f"{name}={value!r}" for name, value in numbers.items() if value is not None]
    if table.motion is not None:
        arguments.append(f"motion={_motion_code(table.motion)}")
    if table.law is not None:
        arguments.append(f"law=jv.Push({table.law.name!r}, {table.law.numbers!r})")
    return f"jv.Wall({', '.join(arguments)})"


def _motion_code(table):
    return f"jv.Motion({table.amplitude!r}, {table.phase!r}, {table.harmonic!r})"
