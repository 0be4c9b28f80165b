"""Measure the structure of the packages: `python -m tests.architecture [calls]`.

Without an argument: statements without docstrings, long files and functions, and branches on the kind of flow, force or
contact (comparisons with None, isinstance, match, comparisons of kinds). `calls`: the files whose functions run
in a second call of `follow`, `locus` and `located`, when everything is compiled.
"""

import argparse
import ast
import re
import sys
from collections import Counter
from pathlib import Path

import jax

import jaxvibro as jv

ROOT = Path(__file__).parents[1]
PACKAGES = "jaxvibro", "continuation"
MAX_FILE, MAX_FUNCTION = 350, 60  # lines of code
KIND = re.compile(
    r"force|(?<!f)law|soft|stiffness|hardness|solver|spring|flow|push|contact_kind|(?<!inadmissible_)kinds|rigid",
    re.IGNORECASE,
)


def files():
    """Return the files of the packages."""
    return sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def is_docstring(node):
    """Return whether a statement is a text alone."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def statements(tree):
    """Return the number of statements."""
    return sum(isinstance(node, ast.stmt) and not is_docstring(node) for node in ast.walk(tree))


def code_lines(node):
    """Return the number of lines that contain code, docstrings excluded."""
    texts = {line for one in ast.walk(node) if is_docstring(one) for line in range(one.lineno, one.end_lineno + 1)}
    own = (one for one in ast.walk(node) if isinstance(one, ast.stmt | ast.expr | ast.arg))
    return len({line for one in own for line in range(one.lineno, one.end_lineno + 1)} - texts)


def tests_of(node):
    """Return the conditions of a node: of a statement, an expression or a comprehension."""
    if isinstance(node, ast.If | ast.IfExp | ast.While | ast.Assert):
        return [node.test]
    return node.ifs if isinstance(node, ast.comprehension) else []


def kind_branches(tree):
    """Return the lines of conditions that ask for the kind of a flow, a force or a contact."""
    rows = {(node.lineno, ast.unparse(node.subject)) for node in ast.walk(tree) if isinstance(node, ast.Match)}
    for node in ast.walk(tree):
        for test in tests_of(node):
            rows |= {(one.lineno, ast.unparse(one)) for one in ast.walk(test) if asks_for_a_kind(one, test)}
    return [row for row in rows if KIND.search(row[1])]


def asks_for_a_kind(node, test):
    """Return whether a part of a condition compares with None or a law, calls isinstance, or is its truth."""
    if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.Is | ast.IsNot):
        return True
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return node.func.id == "isinstance"
    return node is test and isinstance(node, ast.Name | ast.Attribute)


def report():
    """Print the structure of the packages."""
    trees = {str(path.relative_to(ROOT)): ast.parse(path.read_text("utf-8")) for path in files()}
    print(f"{sum(map(statements, trees.values()))} statements in {len(trees)} files")
    print("long files:", {name: code_lines(tree) for name, tree in trees.items() if code_lines(tree) > MAX_FILE})
    functions = [
        (f"{name}:{node.name}", code_lines(node))
        for name, tree in trees.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
    ]
    print("long functions:", {name: lines for name, lines in functions if lines > MAX_FUNCTION})
    branches = {name: kind_branches(tree) for name, tree in trees.items()}
    for name, rows in branches.items():
        for line, text in sorted(rows):
            print(f"{name}:{line}: {text}")
    print(sum(map(len, branches.values())), "branches on a kind")


def files_run_by(function):
    """Return {file: number of calls} of a call."""
    counts, begin = Counter(), str(ROOT)

    def profile(frame, event, _):
        name = frame.f_code.co_filename
        if event == "call" and name.startswith(begin) and "/.venv/" not in name and "/tests/" not in name:
            counts[name[len(begin) + 1 :]] += 1

    sys.setprofile(profile)
    try:
        function()
    finally:
        sys.setprofile(None)
    return counts


def calls():
    """Print the files on the paths of calls for the scene of the README."""
    jax.config.update("jax_enable_x64", True)
    scene = jv.make_scene(amplitude=2.0, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))
    orbit = jv.find_orbit(scene, jv.State(x=0.9, v=-1.1))
    branch = jv.follow(orbit, "amplitude", bounds=(0.0, 6.0))
    (fold,) = branch.points("SN")
    amplitude_of_fold = jv.located(fold)
    bounds = {"amplitude": (0.0, 12.0), "frequency": (1.5, 3.0)}
    actions = {
        "follow": lambda: jv.follow(orbit, "amplitude", bounds=(0.0, 6.0)),
        "locus": lambda: jv.locus(fold, ("amplitude", "frequency"), bounds=bounds),
        "located": lambda: amplitude_of_fold(scene),
    }
    for name, action in actions.items():
        action()
        counts = files_run_by(action)
        print(f"{name}: {len(counts)} files")
        for file, count in counts.most_common():
            print(f"  {count:8d}  {file}")


def main():
    """Run the action of the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.architecture", description=__doc__.split("\n")[0])
    parser.add_argument("action", nargs="?", choices=("structure", "calls"), default="structure")
    {"structure": report, "calls": calls}[parser.parse_args().action]()


if __name__ == "__main__":
    main()
