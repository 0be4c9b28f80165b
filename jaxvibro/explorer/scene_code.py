"""A scene as the Python that makes it."""

from ..scene.scene_table import SceneTable


def scene_code(table: SceneTable) -> str:
    """The expression that makes the scene of a table, scales left out."""
    plain = {name: getattr(table, name) for name in ("amplitude", "frequency", "damping", "restitution")}
    told = [f"{name}={value!r}" for name, value in plain.items() if value is not None]
    if table.left is not None or table.right is not None:
        told.append(f"walls=({_wall(table.left)}, {_wall(table.right)})")
    if table.force is not None:
        force = table.force
        how = f"tolerance={force.tolerance!r}, solver={force.solver!r}"
        told.append(f"force=jv.Force({force.name!r}, {force.numbers!r}, {how})")
    if table.drive:
        told.append(f"drive=[{', '.join(map(_motion, table.drive))}]")
    return f"jv.make_scene({', '.join(told)})"


def scales_code(table: SceneTable) -> str | None:
    """The expression that makes its `Scales`, None where it has none."""
    scales = table.scales
    return None if scales is None else f"jv.Scales({scales.mass!r}, {scales.stiffness!r}, {scales.length!r})"


def _wall(table):
    if table is None:
        return "None"
    told = [repr(table.position)]
    numbers = {name: getattr(table, name) for name in ("restitution", "stiffness", "damping")}
    told += [f"{name}={value!r}" for name, value in numbers.items() if value is not None]
    if table.motion is not None:
        told.append(f"motion={_motion(table.motion)}")
    if table.law is not None:
        told.append(f"law=jv.Push({table.law.name!r}, {table.law.numbers!r})")
    return f"jv.Wall({', '.join(told)})"


def _motion(table):
    return f"jv.Motion({table.amplitude!r}, {table.phase!r}, {table.harmonic!r})"
