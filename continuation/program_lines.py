"""Represent a program as lines, remove unused lines and write them as the text of one Python function.

A line computes variables from other variables. Variables are identified by numbers. Loops and conditionals contain
blocks of lines.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

INDENT = "    "


class Block:
    """Block of lines, with their results by key; `find` also searches the enclosing blocks."""

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
    """Line that assigns the value of an expression to variables.

    Attributes
    ----------
    results : sequence of int
        Variables to which the value is assigned.
    operands : sequence of int
        Variables in the expression.
    text : str
        Text of the expression; ``{0}``, ``{1}``, ... stand for the operands.
    returns_list : bool
        True if the value is a sequence with one entry per result.
    """

    results: Sequence[int]
    operands: Sequence[int]
    text: str
    returns_list: bool = False

    def prune(self, needed_numbers: set[int]) -> "Line":
        needed_numbers.update(self.operands)
        return self

    def write(self, variable_name: Callable[[int], str], indent: str) -> Iterator[str]:
        result_names = (
            "".join(f"{variable_name(number)}, " for number in self.results)
            if self.returns_list
            else variable_name(self.results[0])
        )
        yield f"{indent}{result_names} = {self.text.format(*map(variable_name, self.operands))}"


@dataclass(frozen=True)
class Loop:
    """Loop that updates carried variables.

    Attributes
    ----------
    results : sequence of int
        Carried variables.
    initial : sequence of int
        Variables with the initial values of the carried variables.
    next_results : sequence of int
        Variables with the values of the carried variables after an iteration.
    lines : sequence of Line, Loop or Conditional
        Lines of an iteration.
    test : sequence of Line, Loop or Conditional
        Lines that compute `condition` before each iteration.
    condition : int or None
        Variable that is true if a further iteration follows. None stands for `length` iterations.
    length : int
        Number of iterations if `condition` is None.
    rows : sequence of tuple
        Arrays of which an iteration reads one row: (line whose text gives the rows, variables of one row, True if the
        row is one array).
    outputs : sequence of tuple
        Lists to which an iteration appends: (variable of the list, appended variables, True if an array is appended).
    """

    results: Sequence[int]
    initial: Sequence[int]
    next_results: Sequence[int]
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
            needed_inner_numbers = {self.next_results[index] for index in live_indices}.union(
                *(values for _, values, _ in outputs)
            )
            needed_inner_numbers.update(() if self.condition is None else [self.condition])
            lines = prune_lines(self.lines, needed_inner_numbers)
            condition_lines = prune_lines(self.test, needed_inner_numbers)
            new_live_indices = {
                index for index, number in enumerate(self.results) if number in needed_inner_numbers
            } - live_indices
            if not new_live_indices:
                break
            live_indices |= new_live_indices
        rows = [entry for entry in self.rows if not needed_inner_numbers.isdisjoint(entry[1])]
        for line, _, _ in rows:
            needed_inner_numbers.update(line.operands)
        needed_numbers |= needed_inner_numbers | {self.initial[index] for index in live_indices}
        results, initial, live_next_results = (
            [entry[index] for index in sorted(live_indices)]
            for entry in (self.results, self.initial, self.next_results)
        )
        return replace(
            self,
            results=results,
            initial=initial,
            next_results=live_next_results,
            lines=lines,
            test=condition_lines,
            rows=rows,
            outputs=outputs,
        )

    def write(self, variable_name: Callable[[int], str], indent: str) -> Iterator[str]:
        inner_indent = indent + INDENT
        for number, initial_number in zip(self.results, self.initial, strict=True):
            yield f"{indent}{variable_name(number)} = {variable_name(initial_number)}"
        for number, _, _ in self.outputs:
            yield f"{indent}{variable_name(number)} = []"
        yield indent + (self._loop_head(variable_name) if self.condition is None else "while True:")
        yield f"{inner_indent}spent += {len(self.lines) + len(self.test) + 1}"
        yield from write_lines(self.test, variable_name, inner_indent)
        if self.condition is not None:
            yield f"{inner_indent}if not {variable_name(self.condition)}: break"
        yield from write_lines(self.lines, variable_name, inner_indent)
        for number, values, is_array in self.outputs:
            appended_text = (
                variable_name(values[0])
                if is_array
                else f"({''.join(f'{variable_name(number)}, ' for number in values)})"
            )
            yield f"{inner_indent}{variable_name(number)}.append({appended_text})"
        assignments = [number for number in zip(self.results, self.next_results, strict=True) if number[0] != number[1]]
        if assignments:
            yield inner_indent + " = ".join(
                "".join(f"{variable_name(number)}, " for number in column) for column in zip(*assignments, strict=True)
            )

    def _loop_head(self, variable_name):
        if not self.rows:
            return f"for _ in range({self.length}):"
        row_texts = (line.text.format(*map(variable_name, line.operands)) for line, _, _ in self.rows)
        row_variables = (
            variable_name(numbers[0])
            if is_array
            else f"({''.join(f'{variable_name(number)}, ' for number in numbers)})"
            for _, numbers, is_array in self.rows
        )
        return f"for {''.join(f'{number}, ' for number in row_variables)} in zip({', '.join(row_texts)}):"


@dataclass(frozen=True)
class Conditional:
    """Conditional that executes one of several blocks.

    Attributes
    ----------
    results : sequence of int
        Variables to which the results of the block are assigned.
    branch_number : int
        Variable with the index of the block, which is clipped to the valid range.
    blocks : sequence of tuple
        (lines, variables of the results) of each block.
    """

    results: Sequence[int]
    branch_number: int
    blocks: Sequence[tuple["Lines", Sequence[int]]]

    def prune(self, needed_numbers: set[int]) -> "Conditional":
        live_indices = [index for index, number in enumerate(self.results) if number in needed_numbers]
        blocks = []
        for lines, results in self.blocks:
            results = [results[index] for index in live_indices]
            needed_inner_numbers = set(results)
            blocks.append((prune_lines(lines, needed_inner_numbers), results))
            needed_numbers |= needed_inner_numbers
        needed_numbers.add(self.branch_number)
        return replace(self, results=[self.results[index] for index in live_indices], blocks=blocks)

    def write(self, variable_name: Callable[[int], str], indent: str) -> Iterator[str]:
        for index, (lines, results) in enumerate(self.blocks):
            branch_condition = (
                f"if {variable_name(self.branch_number)} <= {index}:"
                if index == 0
                else f"elif {variable_name(self.branch_number)} == {index}:"
            )
            yield indent + (branch_condition if index + 1 < len(self.blocks) else "else:")
            yield from write_lines(lines, variable_name, indent + INDENT)
            yield f"{indent}{INDENT}spent += {len(lines)}"
            for number, result in zip(self.results, results, strict=True):
                yield f"{indent}{INDENT}{variable_name(number)} = {variable_name(result)}"


Lines = Sequence[Line | Loop | Conditional]


def prune_lines(lines: Lines, needed_numbers: set[int]) -> list[Line | Loop | Conditional]:
    """Return the lines that compute needed variables, and add the operands of these lines to `needed_numbers`."""
    pruned_lines = []
    for line in reversed(list(lines)):
        if not needed_numbers.isdisjoint([*line.results, *(entry[0] for entry in getattr(line, "outputs", ()))]):
            pruned_lines.append(line.prune(needed_numbers))
    return pruned_lines[::-1]


def write_lines(lines: Lines, variable_name: Callable[[int], str], indent: str) -> Iterator[str]:
    """Write lines as text with an indent; `variable_name` returns the text of a variable."""
    for line in lines:
        yield from line.write(variable_name, indent)


def count_lines(lines: Lines) -> int:
    """Count lines, including those in loops and conditionals."""
    n_lines = 0
    for line in lines:
        inner_lines = [*getattr(line, "test", ()), *getattr(line, "lines", ())]
        inner_lines += [inner_line for lines, _ in getattr(line, "blocks", ()) for inner_line in lines]
        n_lines += 1 + count_lines(inner_lines)
    return n_lines
