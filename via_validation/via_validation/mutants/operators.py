"""Small errors that a module could contain: every place where one operator, number or comparison can be wrong.

Source: R. A. DeMillo, R. J. Lipton, F. G. Sayward, Hints on test data selection: help for the practicing programmer,
Computer 11(4), 1978; operators after A. J. Offutt et al., An experimental determination of sufficient mutant operators,
ACM TOSEM 5(2), 1996: arithmetic, relational and logical operators, signs and constants.

Only code that computes is mutated. Declarations (annotations, defaults of parameters with their ranges, docstrings) and
messages of errors are left alone.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass

ARITHMETIC: dict[type[ast.operator], tuple[str, str]] = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"), ast.Pow: ("**", "*"),
}  # fmt: skip
RELATIONS: dict[type[ast.cmpop], tuple[str, str]] = {
    ast.Lt: ("<", ">="), ast.LtE: ("<=", ">"), ast.Gt: (">", "<="), ast.GtE: (">=", "<"), ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
}  # fmt: skip
EXTREMES = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "sin": "cos", "cos": "sin"}
GUARD = 1e-6  # smaller numbers only guard against division by zero; their size has no effect
DECLARING = {"parameter", "choice", "slots", "field", "Field", "njit"}  # calls whose arguments are no formula


@dataclass(frozen=True)
class Mutation:
    """Replacement of `before` at [start, end) of a module's source by `after`."""

    path: str  # of the module, from the root of the repository
    line: int
    start: int
    end: int
    before: str
    after: str
    code: str  # the line, stripped

    def applied(self, source: str) -> str:
        """The mutated source."""
        assert source[self.start : self.end] == self.before
        return source[: self.start] + self.after + source[self.end :]


def mutations_of(path: str, source: str) -> list[Mutation]:
    """Every mutation of a module, in the order of its source."""
    return sorted(_Finder(path, source).found(), key=lambda each: (each.start, each.after))


class _Finder:
    """Walks the syntax tree of a module."""

    def __init__(self, path: str, source: str) -> None:
        self.path, self.source, self.lines = path, source, source.splitlines(keepends=True)
        # Columns of a syntax tree count bytes, positions in a string count characters.
        self.encoded = [line.encode() for line in self.lines]
        self.offsets = [0]
        for line in self.lines:
            self.offsets.append(self.offsets[-1] + len(line))

    def found(self) -> Iterator[Mutation]:
        return self._walk(ast.parse(self.source))

    def _walk(self, node: ast.AST) -> Iterator[Mutation]:
        if isinstance(node, ast.Call) and _name(node.func) in DECLARING:
            return
        if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr | ast.Import | ast.ImportFrom):
            return
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            for statement in node.body:
                yield from self._walk(statement)
            return
        if isinstance(node, ast.AnnAssign):
            if node.value is not None:
                yield from self._walk(node.value)
            return
        yield from self._here(node)
        for child in ast.iter_child_nodes(node):
            yield from self._walk(child)

    def _here(self, node: ast.AST) -> Iterator[Mutation]:
        if isinstance(node, ast.BinOp) and type(node.op) in ARITHMETIC:
            yield from self._between(node.left, node.right, *ARITHMETIC[type(node.op)])
        elif isinstance(node, ast.AugAssign) and type(node.op) in ARITHMETIC:
            before, after = ARITHMETIC[type(node.op)]
            yield from self._between(node.target, node.value, before + "=", after + "=")
        elif isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            for left, right, operator in zip(sides, sides[1:], node.ops, strict=False):
                if type(operator) in RELATIONS:
                    yield from self._between(left, right, *RELATIONS[type(operator)])
        elif isinstance(node, ast.BoolOp):
            before, after = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
            for left, right in zip(node.values, node.values[1:], strict=False):
                yield from self._between(left, right, before, after)
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
            start, end = self._start(node), self._start(node.operand)
            text = self.source[start:end]
            if text.strip() in ("-", "not"):
                yield self._mutation(start, end, "")
        elif isinstance(node, ast.Call) and _name(node.func) in EXTREMES:
            end = self._end(node.func)
            word = _name(node.func)
            yield self._mutation(end - len(word), end, EXTREMES[word])
        elif (
            isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool)
        ):
            start, end, number = self._start(node), self._end(node), node.value
            if isinstance(number, int):
                yield self._mutation(start, end, repr(number + 1))
            elif number == 0.0 or number > GUARD:
                yield self._mutation(start, end, repr(2.0 * number or 1.0))

    def _between(self, left: ast.expr, right: ast.expr, before: str, after: str) -> Iterator[Mutation]:
        """The operator `before` between two operands, which may be surrounded by brackets, spaces and comments."""
        low, high = self._end(left), self._start(right)
        at = self.source.find(before, low, high)
        if at >= 0 and "#" not in self.source[low:at]:
            yield self._mutation(at, at + len(before), after)

    def _mutation(self, start: int, end: int, after: str) -> Mutation:
        line = next(k for k in range(len(self.lines)) if self.offsets[k + 1] > start)
        code = self.lines[line].strip()
        return Mutation(self.path, line + 1, start, end, self.source[start:end], after, code)

    def _start(self, node: ast.expr) -> int:
        return self._position(node.lineno, node.col_offset)

    def _end(self, node: ast.expr) -> int:
        assert node.end_lineno is not None and node.end_col_offset is not None
        return self._position(node.end_lineno, node.end_col_offset)

    def _position(self, line: int, column: int) -> int:
        return self.offsets[line - 1] + len(self.encoded[line - 1][:column].decode())


def _name(node: ast.expr) -> str:
    """Last part of a dotted name, '' for other expressions."""
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
