"""Represent a program as lines, remove unused lines and write them as the text of one Python function.

A line computes variables, identified by numbers, from others. Loops and conditionals contain blocks of lines.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

INDENT = "    "


class Block:
    """Lines and their results by key; results of the enclosing blocks are known too."""

    def __init__(self, outer_block=None):
        self.lines, self.known_results, self.outer_block = [], {}, outer_block

    def find(self, key):
        block = self
        while block is not None:
            if key in block.known_results:
                return block.known_results[key]
            block = block.outer_block
        return None


@dataclass(frozen=True)
class Line:
    """Line that computes `results` from `operands` by the text; braces stand for the operands.

    The text gives a sequence if `gives_list` is true.
    """

    results: Sequence[int]
    operands: Sequence[int]
    text: str
    gives_list: bool = False

    def prune(self, needed_numbers: set[int]) -> "Line":
        needed_numbers.update(self.operands)
        return self

    def write(self, value_name: Callable[[int], str], indent: str) -> Iterator[str]:
        names = (
            "".join(f"{value_name(number)}, " for number in self.results)
            if self.gives_list
            else value_name(self.results[0])
        )
        yield f"{indent}{names} = {self.text.format(*map(value_name, self.operands))}"


@dataclass(frozen=True)
class Loop:
    """Loop that carries `results`, which start as `initial` and become `updated` after each iteration.

    `test` lines compute `condition`, which is true for a further iteration; None stands for one iteration per row.
    `lines` are those of an iteration. `rows` are (line with the text of the rows, variables of one row, is_array),
    `outputs` are (variable of a list, variables that an iteration appends, is_array).
    """

    results: Sequence[int]
    initial: Sequence[int]
    updated: Sequence[int]
    lines: "Lines"
    test: "Lines" = ()
    condition: int | None = None
    length: int = 0
    rows: Sequence[tuple[Line, Sequence[int], bool]] = ()
    outputs: Sequence[tuple[int, Sequence[int], bool]] = ()

    def prune(self, needed_numbers: set[int]) -> "Loop":
        """Remove unused variables and lines."""
        outputs = [entry for entry in self.outputs if entry[0] in needed_numbers]
        live_indices = {index for index, number in enumerate(self.results) if number in needed_numbers}
        while True:
            inner_numbers = {self.updated[index] for index in live_indices}.union(*(values for _, values, _ in outputs))
            inner_numbers.update(() if self.condition is None else [self.condition])
            lines = prune_lines(self.lines, inner_numbers)
            test_lines = prune_lines(self.test, inner_numbers)
            new_indices = {index for index, number in enumerate(self.results) if number in inner_numbers} - live_indices
            if not new_indices:
                break
            live_indices |= new_indices
        rows = [entry for entry in self.rows if not inner_numbers.isdisjoint(entry[1])]
        for line, _, _ in rows:
            inner_numbers.update(line.operands)
        needed_numbers |= inner_numbers | {self.initial[index] for index in live_indices}
        results, initial, updated = (
            [entry[index] for index in sorted(live_indices)] for entry in (self.results, self.initial, self.updated)
        )
        return replace(
            self,
            results=results,
            initial=initial,
            updated=updated,
            lines=lines,
            test=test_lines,
            rows=rows,
            outputs=outputs,
        )

    def write(self, value_name: Callable[[int], str], indent: str) -> Iterator[str]:
        inner_indent = indent + INDENT
        for number, initial_number in zip(self.results, self.initial, strict=True):
            yield f"{indent}{value_name(number)} = {value_name(initial_number)}"
        for number, _, _ in self.outputs:
            yield f"{indent}{value_name(number)} = []"
        yield indent + (self._head_text(value_name) if self.condition is None else "while True:")
        yield f"{inner_indent}spent += {len(self.lines) + len(self.test) + 1}"
        yield from write_lines(self.test, value_name, inner_indent)
        if self.condition is not None:
            yield f"{inner_indent}if not {value_name(self.condition)}: break"
        yield from write_lines(self.lines, value_name, inner_indent)
        for number, values, is_array in self.outputs:
            row_text = (
                value_name(values[0]) if is_array else f"({''.join(f'{value_name(number)}, ' for number in values)})"
            )
            yield f"{inner_indent}{value_name(number)}.append({row_text})"
        assignments = [number for number in zip(self.results, self.updated, strict=True) if number[0] != number[1]]
        if assignments:
            yield inner_indent + " = ".join(
                "".join(f"{value_name(number)}, " for number in column) for column in zip(*assignments, strict=True)
            )

    def _head_text(self, value_name):
        if not self.rows:
            return f"for _ in range({self.length}):"
        texts = (line.text.format(*map(value_name, line.operands)) for line, _, _ in self.rows)
        names = (
            value_name(numbers[0]) if is_array else f"({''.join(f'{value_name(number)}, ' for number in numbers)})"
            for _, numbers, is_array in self.rows
        )
        return f"for {''.join(f'{number}, ' for number in names)} in zip({', '.join(texts)}):"


@dataclass(frozen=True)
class Conditional:
    """One of several blocks, selected by a branch number; each with the variables of its results."""

    results: Sequence[int]
    branch_number: int
    blocks: Sequence[tuple["Lines", Sequence[int]]]

    def prune(self, needed_numbers: set[int]) -> "Conditional":
        live_indices = [index for index, number in enumerate(self.results) if number in needed_numbers]
        blocks = []
        for lines, results in self.blocks:
            results = [results[index] for index in live_indices]
            inner_numbers = set(results)
            blocks.append((prune_lines(lines, inner_numbers), results))
            needed_numbers |= inner_numbers
        needed_numbers.add(self.branch_number)
        return replace(self, results=[self.results[index] for index in live_indices], blocks=blocks)

    def write(self, value_name: Callable[[int], str], indent: str) -> Iterator[str]:
        for index, (lines, results) in enumerate(self.blocks):
            test = (
                f"if {value_name(self.branch_number)} <= {index}:"
                if index == 0
                else f"elif {value_name(self.branch_number)} == {index}:"
            )
            yield indent + (test if index + 1 < len(self.blocks) else "else:")
            yield from write_lines(lines, value_name, indent + INDENT)
            yield f"{indent}{INDENT}spent += {len(lines)}"
            for number, result in zip(self.results, results, strict=True):
                yield f"{indent}{INDENT}{value_name(number)} = {value_name(result)}"


Lines = Sequence[Line | Loop | Conditional]


def prune_lines(lines: Lines, needed_numbers: set[int]) -> list[Line | Loop | Conditional]:
    """Return the lines that the needed variables require, and add the variables these require to `needed_numbers`."""
    pruned = []
    for line in reversed(list(lines)):
        if not needed_numbers.isdisjoint([*line.results, *(entry[0] for entry in getattr(line, "outputs", ()))]):
            pruned.append(line.prune(needed_numbers))
    return pruned[::-1]


def write_lines(lines: Lines, value_name: Callable[[int], str], indent: str) -> Iterator[str]:
    """Write lines as text with an indent; `value_name` gives the text of a variable."""
    for line in lines:
        yield from line.write(value_name, indent)


def count_lines(lines: Lines) -> int:
    """Count lines, those in loops and conditionals included."""
    n_lines = 0
    for line in lines:
        inner_lines = [*getattr(line, "test", ()), *getattr(line, "lines", ())]
        inner_lines += [inner_line for lines, _ in getattr(line, "blocks", ()) for inner_line in lines]
        n_lines += 1 + count_lines(inner_lines)
    return n_lines
