"""Write a scene as the Python code that makes it."""

from ..scene.scene_table import ForceTable, MotionTable, ScalesTable, SceneTable, WallLawTable, WallTable

# (name of the constructor, number of positional arguments) of each table below that of the scene.
CONSTRUCTORS = {
    WallTable: ("Wall", 1),
    MotionTable: ("Motion", 3),
    WallLawTable: ("Push", 2),
    ForceTable: ("Force", 2),
    ScalesTable: ("Scales", 3),
}


def scene_code(scene_table: SceneTable) -> str:
    """Return the expression that makes the scene of a table, without its scales."""
    scalar_values = {name: getattr(scene_table, name) for name in ("amplitude", "frequency", "damping", "restitution")}
    arguments = [f"{name}={value!r}" for name, value in scalar_values.items() if value is not None]
    if scene_table.left is not None or scene_table.right is not None:
        arguments.append(f"walls=({_value_code(scene_table.left)}, {_value_code(scene_table.right)})")
    optional_values = {"force": scene_table.force, "drive": scene_table.drive}
    arguments += [f"{name}={_value_code(value)}" for name, value in optional_values.items() if value]
    return f"jv.make_scene({', '.join(arguments)})"


def scales_code(scene_table: SceneTable) -> str | None:
    """Return the expression that makes the `Scales` of a table; None if the table has no scales."""
    return None if scene_table.scales is None else _value_code(scene_table.scales)


def _value_code(value):
    """Return the expression of a table, a list of tables, a number or a text; omit the arguments that are None."""
    if isinstance(value, list):
        return f"[{', '.join(map(_value_code, value))}]"
    if type(value) not in CONSTRUCTORS:
        return repr(value)
    constructor_name, n_positional = CONSTRUCTORS[type(value)]
    argument_codes = [(name, _value_code(getattr(value, name))) for name in value.__struct_fields__]
    positional_codes = [code for _, code in argument_codes[:n_positional]]
    keyword_codes = [f"{name}={code}" for name, code in argument_codes[n_positional:] if code != "None"]
    return f"jv.{constructor_name}({', '.join([*positional_codes, *keyword_codes])})"
