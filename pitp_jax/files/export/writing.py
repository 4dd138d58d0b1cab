"""Write a scalar program as text in C99 or MATLAB, one line per value.

    v12 = v7 * v9;      a value used once is written where it is used if the line stays short

C code contains only the helpers that it uses; a table or a loop has its own array or function.
"""

import re
from dataclasses import dataclass, field

import numpy as np

from ...method.numerics.scalar.scalars import Loop, Node, Program

_INFIX = {
    "add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==",
    "ne": "!=", "and": "&&", "or": "||", "xor": "!=",
}  # fmt: skip
_C = {op: f"({{0}} {sign} {{1}})" for op, sign in _INFIX.items()} | {
    "neg": "(-{0})", "not": "(!{0})", "select": "({0} ? {2} : {1})", "real": "({0} ? ONE : ZERO)",
    "is_finite": "isfinite({0})", "infinity": "({0}(real)INFINITY)", "place": "{0}[{1}]",
}  # fmt: skip
_PATTERNS = {  # by language and operation; a place is counted from 0 and from 1
    "c": _C,
    "matlab": _C | {
        "ne": "({0} ~= {1})", "xor": "({0} ~= {1})", "not": "(~{0})", "select": "pick({0}, {2}, {1})",
        "real": "double({0})", "infinity": "({0}Inf)", "place": "{0}({2})",
    },
}  # fmt: skip
_HELPERS = {
    "larger": "static real larger(real a, real b)\n{\n    return (a > b) ? a : b;\n}\n",
    "smaller": "static real smaller(real a, real b)\n{\n    return (a < b) ? a : b;\n}\n",
    "sign_of": "static real sign_of(real a)\n{\n    return (a > ZERO) ? ONE : ((a < ZERO) ? -ONE : ZERO);\n}\n",
}
_NAMES = {"max": "larger", "min": "smaller", "sign": "sign_of", "abs": "fabs", "rem": "fmod"}  # of functions in C


@dataclass
class Writer:
    """A writer of programs, which also collects the tables and loop bodies that they need.

    Attributes:
        language: "c" or "matlab".
        single: numbers and functions of C are float.
        beside: tables and loop bodies, in the required order.
    """

    language: str
    single: bool = False
    beside: list[str] = field(default_factory=list)

    def number(self, value) -> str:
        """Return a literal in C or MATLAB that reads back as the same number."""
        if isinstance(value, (bool, np.bool_)):
            return "true" if value else "false"
        value = float(value)
        if not np.isfinite(value):
            return self.call("infinity", ["-" if value < 0 else ""])
        if self.single:
            top = float(np.finfo(np.float32).max)  # beyond float's range a limit stays a number
            text = str(np.float32(min(max(value, -top), top)))
        else:
            text = repr(value)
        text = text if any(c in text for c in ".e") else text + ".0"  # 1 / 2 of two integers is 0 in C
        if self.single:
            text += "f"
        return f"({text})" if value < 0 else text  # after a minus sign it would read as a decrement

    def body(self, program: Program, inputs: list[str], outputs: list[str]) -> list[str]:
        """Write the lines that compute a program from named inputs and assign its named outputs."""
        nodes, uses = program.nodes(), {}
        for user in (*(n.args for n in nodes), program.outputs):
            for a in user:
                uses[a] = uses.get(a, 0) + 1 if isinstance(a, Node) else 0
        names: dict[Node, str] = {}
        lines = []

        def text(value) -> str:
            return names[value] if isinstance(value, Node) else self.number(value)

        for node in nodes:
            if node.op == "input":
                names[node] = inputs[node.args[0]]
            elif node.op in ("matrix", "loop"):
                names[node] = f"v{len(lines)}_{node.place}"
                lines += self._block(node, names[node], [text(a) for a in node.args])
            elif node.op == "item":
                names[node] = self._place(names[node.args[0]], node.args[1])
            else:
                written = self.call(node.op, [text(a) for a in node.args])
                if uses[node] == 1 and len(written) < 70 and not node.truth:
                    names[node] = written
                else:
                    names[node] = f"v{node.place}"
                    lines.append(self._line(names[node], written, node.truth))
        for name, value in zip(outputs, program.outputs, strict=True):
            lines.append(f"{name} = {self._as_number(value, text(value))};")
        return lines

    def function(self, name: str, program: Program, state: int, outputs: int) -> str:
        """Write a program as a function of the state s and the inputs, which gives the next state and the outputs.

        C: static void name(const real s[], in[], real next[], real out[]).  MATLAB: [next, out] = name(s, in).
        """
        states = len(program.outputs) - outputs
        inputs = self._places("s", state) + self._places("in", program.inputs - state)
        lines = self.body(program, inputs, self._places("next", states) + self._places("out", outputs))
        if self.language == "matlab":
            lines = [f"next = zeros({states}, 1);", f"out = zeros({outputs}, 1);", *lines]
            return f"function [next, out] = {name}(s, in)\n" + "".join(f"{line}\n" for line in lines) + "end\n\n"
        used = " ".join(lines)
        for missing in ("s", "in", "out"):
            if not re.search(rf"\b{missing}\[", used):  # compilers warn of unused arguments
                lines.insert(0, f"(void){missing};")
        head = f"static void {name}(const real s[], const real in[], real next[], real out[])"
        return f"{head}\n{{\n" + "".join(f"    {line}\n" for line in lines) + "}\n"

    def helpers(self, text: str) -> str:
        """Return the C helper functions that a text uses."""
        return "\n".join(code for name, code in _HELPERS.items() if f"{name}(" in text)

    def call(self, op: str, args: list[str]) -> str:
        """Write an operation on arguments that are written already."""
        pattern = _PATTERNS[self.language].get(op)
        if pattern:
            return pattern.format(*args)
        if self.language == "c":
            op = _NAMES.get(op, op)
            if self.single and op not in _HELPERS:  # functions of libm have float variants
                op += "f"
        return f"{op}({', '.join(args)})"

    def _line(self, name: str, text: str, truth: bool) -> str:
        text = _bare(text)
        if self.language == "matlab":
            return f"{name} = {text};"
        return f"const {'bool' if truth else 'real'} {name} = {text};"

    def _as_number(self, value, text: str) -> str:
        if isinstance(value, bool) or (isinstance(value, Node) and value.truth):
            return self.call("real", [text])
        return _bare(text)

    def _place(self, name: str, k: int) -> str:
        return _PATTERNS[self.language]["place"].format(name, k, k + 1)

    def _places(self, name: str, count: int) -> list[str]:
        return [self._place(name, k) for k in range(count)]

    def _block(self, node: Node, name: str, args: list[str]) -> list[str]:
        if isinstance(node.block, Loop):
            return self._loop(node.block, name, args)
        weights = np.asarray(node.block)
        rows, columns = weights.shape
        if self.language == "matlab":
            table = ";\n".join(" ".join(self.number(w) for w in row) for row in weights)
            return [f"{name} = [{table}] * [{'; '.join(args)}];"]
        table = f"table_{len(self.beside)}"
        text = ",\n".join("    {" + ", ".join(self.number(w) for w in row) + "}" for row in weights)
        self.beside.append(f"static const real {table}[{rows}][{columns}] = {{\n{text}}};\n")
        return [
            f"const real {name}_in[{columns}] = {{{', '.join(args)}}};",
            f"real {name}[{rows}];",
            f"for (unsigned i = 0u; i < {rows}u; i++) {{",
            "    real sum = ZERO;",
            f"    for (unsigned k = 0u; k < {columns}u; k++) {{ sum += {table}[i][k] * {name}_in[k]; }}",
            f"    {name}[i] = sum;",
            "}",
        ]

    def _loop(self, loop: Loop, name: str, args: list[str]) -> list[str]:
        carry, rows = loop.carry, loop.body.inputs - loop.known - loop.carry
        body = f"loop_{len(self.beside)}"
        self.beside.append("")  # reserves its place before the body asks for its own tables
        place = len(self.beside) - 1
        sizes = (("known", loop.known), ("s", carry), ("row", rows))
        inputs = [place for n, size in sizes for place in self._places(n, size)]
        lines = self.body(loop.body, inputs, self._places("next", carry))
        if self.language == "matlab":
            self.beside[place] = f"function next = {body}(known, s, row)\n" + "\n".join(lines) + "\nend\n"
            split = [args[: loop.known], args[loop.known : loop.known + carry], args[loop.known + carry :]]
            known, start, table = ("[" + "; ".join(part) + "]" for part in split)
            return [
                f"{name} = {start};",
                f"{name}_rows = reshape({table}, {max(rows, 1)}, []);",
                f"for k = 1:{loop.count}, {name} = {body}({known}, {name}, {name}_rows(:, min(k, end))); end",
            ]
        head = f"static void {body}(const real known[], const real s[], const real row[], real next[])"
        used = " ".join(lines)
        lines = [f"(void){n};" for n, _ in sizes if not re.search(rf"\b{n}\[", used)] + lines
        self.beside[place] = f"{head}\n{{\n" + "".join(f"    {line}\n" for line in lines) + "}\n"
        first, second = loop.known, loop.known + carry
        return [
            f"real {name}_all[{len(args) + 1}] = {{{', '.join([*args, self.number(0.0)])}}};",
            f"real {name}[{carry}];",
            f"for (unsigned i = 0u; i < {loop.count}u; i++) {{",
            f"    {body}(&{name}_all[0], &{name}_all[{first}], &{name}_all[{second}u + ({rows}u * i)], {name});",
            f"    for (unsigned k = 0u; k < {carry}u; k++) {{ {name}_all[{first}u + k] = {name}[k]; }}",
            "}",
        ]


def _bare(text: str) -> str:
    """Remove parentheses around a whole expression."""
    depth = 0
    for c in text[:-1]:
        depth += (c == "(") - (c == ")")
        if depth == 0:
            break
    return text[1:-1] if depth else text
