"""The house: imports go one way, stand at the top of a file, and files stay short."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted(path for package in ("jaxvibro", "continuation") for path in (ROOT / package).rglob("*.py"))
# A file imports only from files named before it; `plot` and `paper` stand for all files of those folders.
ORDER = [
    *("gap", "text", "check", "rebound", "scene", "soften", "physical"),
    *("whole", "sealed", "limits", "tables", "rules", "scenefile"),
    *("lanes", "blocks", "flow", "wall", "plunge", "contact", "path", "event", "impact", "frame", "leap", "flight"),
    *("log", "clearance", "entry", "journey", "state", "period", "taylor", "stay", "dwell", "replay", "slopes"),
    *("strobe", "monodromy", "simulate", "rest"),
    *("itinerary", "place", "section", "sweep", "starts", "trail", "exponent", "meetings", "recurrence", "settling"),
    *("tangent", "spread", "rates", "growth", "spectrum"),
    *("meet", "cycle", "passes", "orbit", "solve", "shoot", "find", "free", "orbits"),
    *("ring", "along", "look", "rows", "end", "image", "graze", "brush", "dips", "monitor", "piece", "walk"),
    *("told", "branch", "branchfile", "domain", "assemble", "follow", "switch", "mirror", "peaks", "tree"),
    *("curve", "codim", "track", "outset", "corner", "sensitivity", "locus", "family", "loci", "coexistence"),
    *("diagram", "probe", "explore", "diagrams"),
    *("share", "carry", "weak", "evidence", "tried", "attractors", "visits", "trap", "capture", "fractal", "basins"),
    *("backward", "germ", "strand", "manifold"),
    *("plot", "study", "stretch", "data", "report", "picture", "run", "paper"),
    *("cache", "starter", "command", "__main__"),
]


def home(path):
    """The name in ORDER of a file or of the dotted parts of an import."""
    return Path(path).with_suffix("").parts[1]


def imported(path):
    """The jaxvibro files that a file imports, as dotted names below the package."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = path.relative_to(ROOT).parts[: -node.level] if node.level else ()
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_house(path):
    package, name = path.relative_to(ROOT).parts[0], home(path.relative_to(ROOT))
    ours = [one.split(".") for one in imported(path) if one.split(".")[0] == "jaxvibro"]
    if package == "continuation":
        assert not ours
    elif name != "__init__":
        allowed = {*ORDER[: ORDER.index(name)], "__version__"} | ({name} & {"plot", "paper"})
        allowed |= {""} if name == "command" else set()  # the package itself, whose table loads `run` when it is due
        assert {".".join(parts[1:2]) for parts in ours} <= allowed
    inside = [
        one
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef)
        for one in ast.walk(node)
        if isinstance(one, ast.Import | ast.ImportFrom)
    ]
    assert inside == []
    assert len(path.read_text().splitlines()) <= 350
