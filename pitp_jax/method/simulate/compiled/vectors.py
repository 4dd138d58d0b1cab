"""Print a split step as LLVM text: every number is a vector of the same number of several runs.

    %v12 = fmul <16 x double> %v7, %v9

    for every block of runs:   load parameters and states;  once(p)
        for every time step:   gather inputs;  always(p, s, u);  scatter outputs

The text is the same for every processor; LLVM cuts the vectors into those that the processor has. The arithmetic of
laws may be re-ordered (`reassoc arcp`), so that reciprocals and products of parameters leave the loop over time.
"""

import struct
from collections.abc import Iterable, Sequence
from itertools import count
from typing import Any

import numpy as np

from ....common.errors import BadInput
from ...numerics.scalar.scalars import Loop, Node, Still
from .functions import Functions
from .split import Split

_FLAGS = {True: "nsz contract arcp reassoc", False: "nsz contract"}
_ARITHMETIC = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_TESTS = {"lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge", "eq": "oeq", "ne": "une"}
_TRUTHS = ("and", "or", "xor")
_INTRINSICS = {"abs": "fabs", "sqrt": "sqrt", "floor": "floor", "ceil": "ceil"}
LIBRARY = {"log": 1, "log1p": 1, "atanh": 1, "pow": 2, "fmod": 2}  # functions of the C library, number by number
_BIAS = 1023 - 0x4338000000000000  # from the last bits of n + 1.5 * 2^52 to the exponent of 2^n
_AT_ONCE = 4  # rows of a matrix, whose sums do not wait for each other


class Vectors(Functions):
    """The text of one function in LLVM's language, in vectors of `width` doubles.

    Values are names of vectors, or numbers.
    """

    def __init__(self, width: int, *, equal: bool):
        """`equal`: all runs have the same parameters."""
        self.width, self.equal = width, equal
        self.lines: list[str] = []
        self.memory: list[str] = []  # reserved once, before all loops
        self.tables: list[str] = []
        self.label, self.numbers, self.truths = "start", count(), set()
        self.V, self.M, self.I = f"<{width} x double>", f"<{width} x i1>", f"<{width} x i64>"

    def put(self, text: str, *, truth: bool = False) -> str:
        """Add an instruction; return the name of its value."""
        name = f"%v{next(self.numbers)}"
        self.lines.append(f"  {name} = {text}")
        if truth:
            self.truths.add(name)
        return name

    def begin(self, label: str) -> None:
        """Begin a block of instructions."""
        self.lines.append(f"{label}:")
        self.label = label

    def constant(self, kind: str, text: str) -> str:
        """Return a vector of equal constants."""
        return f"splat ({kind} {text})"

    def value(self, a) -> str:
        """Return the text of a value: its name, or a vector of its number."""
        if isinstance(a, str):
            return a
        if isinstance(a, (bool, np.bool_)):
            return self.constant("i1", str(bool(a)).lower())
        return self.constant("double", _exact(a))

    def kind(self, a) -> str:
        """Return the type of a value: truths or numbers."""
        return self.M if isinstance(a, (bool, np.bool_)) or a in self.truths else self.V

    def op(self, op: str, *values) -> Any:
        """Write one operation of a program; return its value."""
        a = [self.value(x) for x in values]
        if op in _ARITHMETIC:
            return self.put(f"{_ARITHMETIC[op]} {_FLAGS[self.loose]} {self.V} {a[0]}, {a[1]}")
        if op in _TESTS and self.kind(values[0]) == self.M:
            differ = self.put(f"xor {self.M} {a[0]}, {a[1]}", truth=True)
            return differ if op == "ne" else self.op("not", differ)
        if op in _TESTS:
            return self.put(f"fcmp {_TESTS[op]} {self.V} {a[0]}, {a[1]}", truth=True)
        if op in _TRUTHS:
            return self.put(f"{op} {self.M} {a[0]}, {a[1]}", truth=True)
        if op == "not":
            return self.put(f"xor {self.M} {a[0]}, {self.value(True)}", truth=True)
        if op == "select":
            kind = self.kind(values[1])
            return self.put(f"select {self.M} {a[0]}, {kind} {a[2]}, {kind} {a[1]}", truth=kind == self.M)
        if op == "neg":
            return self.put(f"fneg {self.V} {a[0]}")
        if op in _INTRINSICS:
            return self.put(f"call {self.V} @llvm.{_INTRINSICS[op]}.v{self.width}f64({self.V} {a[0]})")
        if op in ("power", "odd"):
            return self._bits(op, a[0])
        if op == "rem" or op in LIBRARY:
            return self._called("fmod" if op == "rem" else op, a)
        raise BadInput(f"the operation {op} has no compiled form")

    def _bits(self, op: str, number: str) -> str:
        """Return 2^n, or whether n is odd, from n + 1.5 * 2^52."""
        bits = self.put(f"bitcast {self.V} {number} to {self.I}")
        if op == "odd":
            return self.put(f"trunc {self.I} {bits} to {self.M}", truth=True)
        bits = self.put(f"add {self.I} {bits}, {self.constant('i64', str(_BIAS))}")
        bits = self.put(f"shl {self.I} {bits}, {self.constant('i64', '52')}")
        return self.put(f"bitcast {self.I} {bits} to {self.V}")

    def _called(self, function: str, arguments: Sequence[str]) -> str:
        result = "poison"
        for k in range(self.width):
            one = [self.put(f"extractelement {self.V} {a}, i32 {k}") for a in arguments]
            y = self.put(f"call double @{function}({', '.join(f'double {a}' for a in one)})")
            result = self.put(f"insertelement {self.V} {result}, double {y}, i32 {k}")
        return result

    def write(self, nodes: Iterable[Node], values: dict) -> None:
        """Write the nodes of a program in order; `values` maps nodes to values and is extended."""
        simple: list[Node] = []
        for n in nodes:
            if n in values or n.op not in ("matrix", "loop", "item"):
                simple.append(n)
                continue
            super().write(simple, values)
            simple = []
            if n.op == "item":
                values[n] = values[n.args[0]][n.args[1]]
            else:
                arguments = [values[a] if isinstance(a, Node) else a for a in n.args]
                block: Any = n.block
                values[n] = self._loop(block, arguments) if n.op == "loop" else self._matrix(block, arguments)
        super().write(simple, values)

    def reserve(self, numbers: int) -> str:
        """Reserve memory for vectors; return its name."""
        name = f"%m{next(self.numbers)}"
        self.memory.append(f"  {name} = alloca [{max(numbers, 1)} x {self.V}], align 64")
        return name

    def load(self, base: str, place: int | str) -> str:
        """Load a vector, by its place in memory."""
        return self.put(f"load {self.V}, ptr {self.at(base, place)}, align 8")

    def store(self, base: str, place: int | str, value: str) -> None:
        """Store a vector, by its place in memory."""
        self.lines.append(f"  store {self.V} {value}, ptr {self.at(base, place)}, align 8")

    def at(self, base: str, place: int | str, kind: str = "") -> str:
        """Return the address of a place in an array of vectors (or of another type)."""
        return self.put(f"getelementptr {kind or self.V}, ptr {base}, i64 {place}")

    def spread(self, number: str) -> str:
        """Return a vector with one number in all places."""
        one = self.put(f"insertelement {self.V} poison, double {number}, i32 0")
        return self.put(f"shufflevector {self.V} {one}, {self.V} poison, <{self.width} x i32> zeroinitializer")

    def parameter(self, place: int | str) -> str:
        """Load a parameter: one number for all runs, or a vector."""
        if self.equal:
            return self.spread(self.put(f"load double, ptr {self.at('%L', place, 'double')}, align 8"))
        return self.load("%Lb", place)

    def rows(self, base: str, places: str) -> str:
        """Return the address of every run's row in `base`, by its place in a table of the block."""
        place = self.put(f"load {self.I}, ptr {self.at(places, '%b', self.I)}, align 8")
        return self.put(f"getelementptr double, ptr {base}, {self.I} {place}")

    def _column(self, rows: str, place: str, number: int) -> str:
        """Return the address of a number of this time step in every run's row, with the arguments that follow it."""
        here = self.put(f"add i64 {place}, {number}")
        here = self.put(f"getelementptr double, <{self.width} x ptr> {rows}, i64 {here}")
        return f"<{self.width} x ptr> {here}, i32 8, {self.M} {self.value(True)}"

    def gather(self, rows: str, place: str, number: int) -> str:
        """Load one number of every run's row."""
        where = self._column(rows, place, number)
        name = f"@llvm.masked.gather.v{self.width}f64.v{self.width}p0"
        return self.put(f"call {self.V} {name}({where}, {self.V} poison)")

    def scatter(self, rows: str, place: str, number: int, value: str) -> None:
        """Store one number of every run's row."""
        where = self._column(rows, place, number)
        name = f"@llvm.masked.scatter.v{self.width}f64.v{self.width}p0"
        self.lines.append(f"  call void {name}({self.V} {value}, {where})")

    def repeat(self, times: int, carried: Sequence, body) -> list[str]:
        """Write a loop: `body`(counter, values) -> values; return the last values."""
        k = next(self.numbers)
        before, start = self.label, f"loop{k}"
        self.lines.append(f"  br label %{start}")
        self.begin(start)
        place = len(self.lines)
        names = [f"%c{k}.{j}" for j in range(len(carried))]
        self.truths.update(name for name, a in zip(names, carried, strict=True) if self.kind(a) == self.M)
        after = body(f"%i{k}", names)
        self.lines[place:place] = [
            f"  %i{k} = phi i64 [0, %{before}], [%j{k}, %{self.label}]",
            *(
                f"  {name} = phi {self.kind(a)} [{self.value(a)}, %{before}], [{self.value(b)}, %{self.label}]"
                for name, a, b in zip(names, carried, after, strict=True)
            ),
        ]
        self.lines += [
            f"  %j{k} = add i64 %i{k}, 1",
            f"  %more{k} = icmp slt i64 %j{k}, {times}",
            f"  br i1 %more{k}, label %{start}, label %end{k}",
        ]
        self.begin(f"end{k}")
        return [self.value(b) for b in after]

    def _loop(self, loop: Loop, arguments: list) -> list[str]:
        """Write a scan whose body is a program: constants, carry and one row -> carry."""
        first, last = loop.known, loop.known + loop.carry
        rows, wide = arguments[last:], loop.body.inputs - last
        memory = self.reserve(len(rows))
        for k, a in enumerate(rows):
            self.store(memory, k, self.value(a))

        def body(counter, carried):
            row = self.put(f"mul i64 {counter}, {wide}")
            inputs = [*arguments[:first], *carried]
            inputs += [self.load(self.at(memory, row), k) for k in range(wide)]
            nodes = loop.body.nodes()
            values = {n: inputs[n.args[0]] for n in nodes if n.op == "input"}
            self.write(nodes, values)
            return [values[o] if isinstance(o, Node) else o for o in loop.body.outputs]

        return self.repeat(loop.count, arguments[first:last], body)

    def _matrix(self, weights: np.ndarray | Still, vector: list) -> list[str]:
        """Write a matrix times a vector as two loops."""
        rows, columns = weights.shape
        entered, result = self.reserve(columns), self.reserve(rows)
        for k, a in enumerate(vector):
            self.store(entered, k, self.value(a))
        table = self._table(weights) if isinstance(weights, np.ndarray) else ""

        def element(row, column):
            if isinstance(weights, np.ndarray):
                place = self.put(f"add i64 {self.put(f'mul i64 {row}, {columns}')}, {column}")
                return self.spread(self.put(f"load double, ptr {self.at(table, place, 'double')}, align 8"))
            down, along = (self.put(f"mul i64 {k}, {by}") for k, by in zip((row, column), weights.steps, strict=True))
            place = self.put(f"add i64 {self.put(f'add i64 {down}, {along}')}, {weights.first}")
            return self.parameter(place)

        for start, size in ((0, rows // _AT_ONCE * _AT_ONCE), (rows // _AT_ONCE * _AT_ONCE, rows % _AT_ONCE)):
            at_once = _AT_ONCE if not start and size else 1
            if not size:
                continue

            def group(counter, _, start=start, at_once=at_once):
                first = self.put(f"add i64 {self.put(f'mul i64 {counter}, {at_once}')}, {start}")
                some = [self.put(f"add i64 {first}, {k}") for k in range(at_once)]

                def sums(column, totals):
                    x = self.load(entered, column)
                    terms = [self.put(f"fmul contract {self.V} {element(row, column)}, {x}") for row in some]
                    return [self.put(f"fadd contract {self.V} {a}, {b}") for a, b in zip(totals, terms, strict=True)]

                for row, total in zip(some, self.repeat(columns, [0.0] * at_once, sums), strict=True):
                    self.store(result, row, total)
                return []

            self.repeat(size // at_once, [], group)
        return [self.load(result, k) for k in range(rows)]

    def _table(self, weights: np.ndarray) -> str:
        name = f"@t{next(self.numbers)}"
        numbers = ", ".join(f"double {_exact(a)}" for a in weights.ravel())
        self.tables.append(f"{name} = private constant [{weights.size} x double] [{numbers}], align 64")
        return name


def _exact(number) -> str:
    return f"0x{struct.unpack('>Q', struct.pack('>d', float(number)))[0]:016X}"


def text_of(step: Split, width: int, *, equal: bool) -> str:
    """Print the function `run` of a split step.

    run(blocks, steps, L, S, O, U, P, Y)
    L     parameters, [blocks][parameters][width]; `equal`: [parameters], the same for all runs
    S     initial states, [blocks][states][width]
    O, P  [blocks][width]: the place in U of each run's first input, and in Y of its first output
    U, Y  inputs (..., steps, k) and outputs (..., steps, o)
    """
    e = Vectors(width, equal=equal)
    parameters, states, inputs = step.sizes
    known: dict = {}
    e.label = "block"
    block = e.put(f"mul i64 %b, {max(parameters, 1)}")
    e.lines.append(f"  %Lb = getelementptr {e.V}, ptr %L, i64 {block}")
    start = e.at("%S", e.put(f"mul i64 %b, {states}"))
    known.update((n, e.parameter(n.args[0])) for n in step.once if n.op == "input")
    first = [e.load(start, k) for k in step.states]
    sources, targets = e.rows("%U", "%O"), e.rows("%Y", "%P")
    e.write(step.once, known)
    before = e.label
    e.lines.append("  br label %time")
    e.begin("time")
    place = len(e.lines)
    now = e.put(f"mul i64 %t, {inputs}")
    names = {parameters + k: f"%s{k}" for k in step.states}
    for n in step.always:
        if n.op == "input":
            k = n.args[0]
            known[n] = names[k] if k in names else e.gather(sources, now, k - parameters - states)
    e.write(step.always, known)

    def of(a) -> str:
        value = known[a] if isinstance(a, Node) else float(a)
        return e.value(e.real(value) if e.kind(value) == e.M else value)

    now = e.put(f"mul i64 %t, {len(step.outputs)}")
    for k, output in enumerate(step.outputs):
        e.scatter(targets, now, k, of(output))
    carried = zip(names.values(), first, map(of, step.next), strict=True)
    phis = [f"  {name} = phi {e.V} [{a}, %{before}], [{b}, %{e.label}]" for name, a, b in carried]
    e.lines[place:place] = [f"  %t = phi i64 [0, %{before}], [%t1, %{e.label}]", *phis]
    return "\n".join([*e.tables, *_head(e.memory), *e.lines, *_tail(e)]) + "\n"


def _head(memory: list[str]) -> list[str]:
    arguments = ", ".join(f"ptr noalias %{name}" for name in "LSOUPY")
    return [
        f"define void @run(i64 %blocks, i64 %steps, {arguments}) #0 {{",
        "start:",
        *memory,
        "  br label %block",
        "block:",
        "  %b = phi i64 [0, %start], [%b1, %done]",
    ]


def _tail(e: Vectors) -> list[str]:
    v, w, pointers = e.V, e.width, f"<{e.width} x ptr>"
    declared = [f"declare {v} @llvm.{f}.v{w}f64({v})" for f in _INTRINSICS.values()]
    declared += [f"declare double @{f}({', '.join(['double'] * n)})" for f, n in LIBRARY.items()]
    return [
        "  %t1 = add i64 %t, 1",
        "  %more = icmp slt i64 %t1, %steps",
        "  br i1 %more, label %time, label %done",
        "done:",
        "  %b1 = add i64 %b, 1",
        "  %again = icmp slt i64 %b1, %blocks",
        "  br i1 %again, label %block, label %end",
        "end:",
        "  ret void",
        "}",
        *declared,
        f"declare {v} @llvm.masked.gather.v{w}f64.v{w}p0({pointers}, i32, {e.M}, {v})",
        f"declare void @llvm.masked.scatter.v{w}f64.v{w}p0({v}, {pointers}, i32, {e.M})",
        f'attributes #0 = {{ nounwind "prefer-vector-width"="512" "min-legal-vector-width"="{64 * w}" }}',
    ]
