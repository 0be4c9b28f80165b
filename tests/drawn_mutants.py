"""Draw mutants of the packages: `python -m tests.mutate draw COUNT SEED` writes `tests/mutants/drawn.toml`.

A mutant changes an expression: a comparison, an arithmetic operator, a constant, a negated condition, or a term or
factor that is left out. Every folder of the packages has the same share of the mutants, and in a folder each of these
kinds is equally probable. The result depends on the sources and the seed alone.
"""

import ast
import random
from collections import defaultdict
from pathlib import Path

import tomli_w

ROOT = Path(__file__).parents[1]
DRAWN = ROOT / "tests" / "mutants" / "drawn.toml"
COMPARISONS = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
OPERATORS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
TERMS = ast.Add, ast.Sub, ast.Mult, ast.Div
CONDITIONS = ast.If, ast.IfExp, ast.While, ast.Assert
# Nodes without code that a test could notice: texts, annotations, and the types of `isinstance`.
WITHOUT_CODE = ast.JoinedStr, ast.Import, ast.ImportFrom


def package_folders():
    """Return {folder: files}: the folders of jaxvibro, and continuation."""
    folders = {path.name: path for path in sorted((ROOT / "jaxvibro").iterdir()) if (path / "__init__.py").exists()}
    folders["continuation"] = ROOT / "continuation"
    return {name: sorted(folder.glob("*.py")) for name, folder in folders.items()}


def expressions(node, condition=False):
    """Yield (expression, whether it is a condition) of code that is run."""
    if isinstance(node, WITHOUT_CODE) or (isinstance(node, ast.Call) and ast.unparse(node.func) == "isinstance"):
        return
    if isinstance(node, ast.expr):
        yield node, condition
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not (isinstance(child, ast.keyword) and child.arg == "strict"):
                yield from expressions(child, field == "test" and isinstance(node, CONDITIONS))


def changed_nodes(node, condition):
    """Yield (kind, changed expression) of an expression."""
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        for operator in COMPARISONS[type(node.ops[0])]:
            yield "comparison", ast.Compare(node.left, [operator()], node.comparators)
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        yield "operator", ast.BinOp(node.left, OPERATORS[type(node.op)](), node.right)
        if isinstance(node.op, TERMS):
            yield "dropped term", node.left
            if isinstance(node.op, ast.Add | ast.Mult):
                yield "dropped term", node.right
    if isinstance(node, ast.UnaryOp):
        yield "negation" if isinstance(node.op, ast.Not | ast.Invert) else "operator", node.operand
    if isinstance(node, ast.BoolOp):
        operator = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield "negation", ast.BoolOp(operator, node.values)
        for k in range(len(node.values)):
            rest = node.values[:k] + node.values[k + 1 :]
            yield "dropped term", rest[0] if len(rest) == 1 else ast.BoolOp(node.op, rest)
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield "negation", ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int):
        yield "constant", ast.Constant(node.value + 1)
    elif isinstance(node, ast.Constant) and isinstance(node.value, float):
        yield "constant", ast.Constant(2.0 * node.value or 1.0)
    if condition and not isinstance(node, ast.UnaryOp | ast.Compare | ast.BoolOp):
        yield "negation", ast.UnaryOp(ast.Not(), node)


def mutants_of(source):
    """Return {kind: [(line, text, replacement)]} of a file; text: its whole lines from that line on."""
    lines, mutants = source.splitlines(keepends=True), defaultdict(list)
    for node, condition in expressions(ast.parse(source)):
        for kind, changed in changed_nodes(node, condition):
            text = "".join(lines[node.lineno - 1 : node.end_lineno])
            # Offsets of nodes count bytes.
            before = lines[node.lineno - 1].encode()[: node.col_offset].decode()
            after = lines[node.end_lineno - 1].encode()[node.end_col_offset :].decode()
            inner = ast.unparse(changed)
            atom = isinstance(changed, ast.Constant | ast.Name | ast.Call | ast.Attribute)
            becomes = f"{before}{inner if atom else f'({inner})'}{after}"
            mutants[kind].append((node.lineno, text, becomes))
    return mutants


def draw(count, seed, folders=None):
    """Return {folder: [table]}, count tables in all; a table has the fields file, line, text, becomes and kind."""
    rng, drawn = random.Random(seed), {}
    folders = folders or package_folders()
    share, more = divmod(count, len(folders))
    favoured = rng.sample(sorted(folders), more)
    for folder, files in folders.items():
        sites = defaultdict(list)
        for path in files:
            for kind, rows in mutants_of(path.read_text("utf-8")).items():
                file = str(path.relative_to(ROOT))
                sites[kind] += [
                    dict(zip(("file", "line", "text", "becomes"), (file, *row), strict=True)) for row in rows
                ]
        tables = []
        while sites and len(tables) < share + (folder in favoured):
            kind = rng.choice(sorted(sites))
            table = sites[kind].pop(rng.randrange(len(sites[kind]))) | {"kind": kind}
            if not sites[kind]:
                del sites[kind]
            if not any(table["becomes"] == other["becomes"] and table["line"] == other["line"] for other in tables):
                tables.append(table)
        drawn[folder] = tables
    return drawn


def write(count, seed, path=DRAWN):
    """Write drawn mutants to a file: a table for each, named by its folder and number."""
    tables = {f"{folder} {k}": row for folder, rows in draw(count, seed).items() for k, row in enumerate(rows)}
    path.write_text(f"# Written by `python -m tests.mutate draw {count} {seed}`.\n\n" + tomli_w.dumps(tables), "utf-8")
    return len(tables)
