"""Scalar expressions: each array element of a program is a number or a node of an expression.

    a Python number                 known when the program is written: folded in
    Node(op, args)                  known when it runs; equal expressions are one node

Arrays are NumPy arrays of these, so slices, stacks and gathers cost nothing in the written program.
"""

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

FOLDED: dict[str, Callable] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": lambda a, b: float(np.divide(a, b)),
    "neg": operator.neg,
    "max": max,
    "min": min,
    "abs": abs,
    "sign": lambda a: float(np.sign(a)),
    "floor": lambda a: float(math.floor(a)),
    "ceil": lambda a: float(math.ceil(a)),
    "rem": math.fmod,
    "sqrt": lambda a: float(np.sqrt(a)),
    "exp": lambda a: float(np.exp(a)),
    "expm1": lambda a: float(np.expm1(a)),
    "log": lambda a: float(np.log(a)),
    "log1p": lambda a: float(np.log1p(a)),
    "tanh": math.tanh,
    "atanh": lambda a: float(np.arctanh(a)),
    "sin": math.sin,
    "cos": math.cos,
    "pow": lambda a, b: float(np.power(float(a), b)),
    "lt": operator.lt,
    "le": operator.le,
    "gt": operator.gt,
    "ge": operator.ge,
    "eq": operator.eq,
    "ne": operator.ne,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "xor": operator.ne,
    "not": operator.not_,
    "is_finite": math.isfinite,
    "real": float,
}
TRUTHS = ("lt", "le", "gt", "ge", "eq", "ne", "and", "or", "xor", "not", "is_finite")


@dataclass(frozen=True, eq=False)
class Node:
    """One scalar operation of a program.

    Attributes:
        op: its name in `FOLDED`, or "input", "select", "matrix", "loop", "item".
        args: nodes and numbers; of an "item" the block and a place in it.
        place: in the order of creation, in which they can be written.
        truth: whether it is true or false rather than a number.
        block: of a "matrix" its weights (numbers, or `Still` inputs), of a "loop" its `Loop`.
    """

    op: str
    args: tuple
    place: int
    truth: bool
    block: object


@dataclass(frozen=True, eq=False)
class Loop:
    """A loop: its body runs `count` times on (constants, carry, one row) and replaces the carry."""

    body: "Program"
    count: int
    known: int
    carry: int


@dataclass(frozen=True)
class Still:
    """A matrix of weights among the inputs: the place of its first element, its shape, and the steps between places."""

    first: int
    shape: tuple[int, ...]
    steps: tuple[int, int]

    def places(self) -> np.ndarray:
        """Return the number of the input of every element, shape (rows, columns)."""
        rows, columns = (np.arange(n) * by for n, by in zip(self.shape, self.steps, strict=True))
        return self.first + rows[:, None] + columns


@dataclass(frozen=True, eq=False)
class Program:
    """A function of scalars: the number of its inputs, and its outputs, which are nodes or numbers."""

    inputs: int
    outputs: tuple

    def nodes(self) -> list[Node]:
        """Return the nodes that the outputs need, each after its arguments."""
        # from the outputs backwards, so that unused nodes are never written
        needed, open_ = {}, [o for o in self.outputs if isinstance(o, Node)]
        while open_:
            node = open_.pop()
            if id(node) not in needed:
                needed[id(node)] = node
                open_ += [a for a in node.args if isinstance(a, Node)]
        return sorted(needed.values(), key=lambda n: n.place)  # a node is made after its arguments

    def operations(self) -> int:
        """Return the number of operations of one call, with all iterations of loops."""
        count = 0
        for node in self.nodes():
            if isinstance(node.block, Loop):
                count += node.block.count * node.block.body.operations()
            elif node.op == "matrix":
                count += 2 * np.asarray(node.block).size
            else:
                count += node.op not in ("input", "item")
        return count

    def constants(self) -> int:
        """Return the number of constants in the tables of the program."""
        blocks = [node.block for node in self.nodes() if node.block is not None]
        return sum(b.body.constants() if isinstance(b, Loop) else np.asarray(b).size for b in blocks)


@dataclass
class Builder:
    """A factory of nodes that creates equal nodes only once; the first `still` inputs do not change while it runs."""

    known: dict = field(default_factory=dict)
    count: int = 0
    still: int = 0

    def node(self, op: str, args: tuple = (), *, truth: bool = False, block: object = None) -> Node:
        """Return the node of an operation: the existing one, or a new one."""
        # by type too: 1, 1.0 and True are equal in Python, and different in C
        key = (op, tuple(id(a) if isinstance(a, Node) else (type(a), a) for a in args), id(block))
        if key not in self.known:
            self.known[key] = Node(op, args, self.count, truth, block)
            self.count += 1
        return self.known[key]

    def inputs(self, count: int) -> list[Node]:
        """Return the nodes of the program's inputs."""
        return [self.node("input", (k,)) for k in range(count)]

    def make(self, op: str, *args):
        """Return an operation's result: a number for known arguments, simplified if an argument is 0 or 1."""
        if not any(isinstance(a, Node) for a in args):
            return FOLDED[op](*args)
        simple = _simpler(op, args)
        if simple is not None:
            return self.make("neg", args[1]) if simple is _NEGATIVE else simple
        return self.node(op, args, truth=op in TRUTHS)

    def select(self, which, no, yes):
        """Return `yes` where the condition `which` is true, otherwise `no`."""
        if not isinstance(which, Node):
            return yes if which else no
        if no is yes or (not isinstance(no, Node) and not isinstance(yes, Node) and no == yes):
            return no
        truth = isinstance(yes, bool) or (isinstance(yes, Node) and yes.truth)
        return self.node("select", (which, no, yes), truth=truth)

    def total(self, terms: Sequence):
        """Return the sum of the terms, added in order."""
        result = 0.0
        for term in terms:
            result = self.make("add", result, term)
        return result

    def block(self, node: Node, count: int) -> list[Node]:
        """Return the results of a "matrix" or "loop" node, one node each."""
        return [self.node("item", (node, k)) for k in range(count)]


_NEGATIVE = object()


def _is(value, number: float) -> bool:
    return not isinstance(value, (Node, bool)) and value == number


def _simpler(op: str, args: tuple):
    """Simplify an operation with the argument 0, 1, true or false; None if it cannot be simplified.

    0 times a node is 0, because `steps` rejects inputs that are not finite.
    """
    first, last = args[0], args[-1]
    # an effect that is off, a weight of zero: whole branches of a step disappear
    if op in ("mul", "div") and _is(first, 0) or op == "mul" and _is(last, 0):
        return 0.0
    if op == "mul" and _is(first, 1) or op == "add" and _is(first, 0):
        return last
    if op in ("mul", "div") and _is(last, 1) or op in ("add", "sub") and _is(last, 0):
        return first
    if op == "sub" and _is(first, 0):
        return _NEGATIVE
    if op in ("and", "or") and (isinstance(first, bool) or isinstance(last, bool)):
        known, other = (first, last) if isinstance(first, bool) else (last, first)
        return other if known == (op == "and") else known
    return None
