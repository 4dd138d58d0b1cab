"""Elementary functions by arithmetic and two operations on bits, so that a vector of numbers calls no library.

    exp x = 2^n (1 + e(r)),  x = n ln 2 + r          expm1 x = 2^n e(r) + (2^n - 1)          tanh x = e / (e + 2)
    sin x = (-1)^n s(r),     x = n pi + r            cos x = (-1)^n s(r),  x = (n - 1/2) pi + r

e(r) and s(r) are their Taylor series. exp and expm1 are exact to 2 units in the last place, tanh to 3; sin and cos to
4e-16 for |x| < 1e6 (pi in three parts of 33 bits, whose products with n are exact). nan stays nan.
"""

import math
from abc import abstractmethod
from collections.abc import Iterable
from typing import Any

from ...numerics.scalar.scalars import Node

_ROUND = 6755399441055744.0  # 1.5 * 2^52: adding it rounds to an integer, which its last bits hold
_LN2 = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # the first part has 33 bits (fdlibm)
_PI = 3.1415926534682512, 1.2154201012607932e-10, 4.044532497422333e-21  # twice the parts of pi / 2 of fdlibm
_EXP = [1 / math.factorial(k) for k in range(13, 1, -1)]  # Taylor series of (exp(r) - 1 - r) / r^2, |r| <= ln 2 / 2
_SIN = [(-1) ** (k // 2) / math.factorial(k) for k in range(21, 2, -2)]  # of (sin(r) - r) / r^3 in r^2, |r| <= pi / 2
_LARGEST = 708.0  # exp of more is taken as inf, of less than its negative as 0


class Functions:
    """Functions over one method that writes an operation; `loose`: its arithmetic may be re-ordered."""

    loose = False

    @abstractmethod
    def op(self, op: str, *values) -> Any:
        """Write one operation; return its value."""

    def write(self, nodes: Iterable[Node], values: dict) -> None:
        """Write the nodes of a program in order; `values` maps nodes to values and is extended."""
        for n in nodes:
            if n not in values:
                arguments = [values[a] if isinstance(a, Node) else a for a in n.args]
                own = getattr(self, n.op, None) if n.op in OWN else None
                # the arithmetic of a law may be re-ordered, that of these functions may not
                self.loose = own is None
                values[n] = own(*arguments) if own else self.op(n.op, *arguments)
        self.loose = False

    def polynomial(self, x, coefficients):
        """Compute a polynomial by Horner's rule, the highest coefficient first."""
        total = coefficients[0]
        for c in coefficients[1:]:
            total = self.op("add", self.op("mul", total, x), c)
        return total

    def between(self, x, low, high):
        """Clip x, but let nan pass."""
        x = self.op("select", self.op("lt", x, low), x, low)
        return self.op("select", self.op("gt", x, high), x, high)

    def _parts(self, x):
        """Return 2^n (exp(r) - 1) and 2^n, where x = n ln 2 + r."""
        op, x = self.op, self.between(x, -_LARGEST, _LARGEST)
        shifted = op("add", op("mul", x, 1 / math.log(2)), _ROUND)
        n = op("sub", shifted, _ROUND)
        r = op("sub", op("sub", x, op("mul", n, _LN2[0])), op("mul", n, _LN2[1]))
        power = op("power", shifted)
        less = op("add", r, op("mul", op("mul", r, r), self.polynomial(r, _EXP)))
        return op("mul", power, less), power

    def exp(self, x):
        """Compute the exponential; inf above 708, 0 below -708."""
        less, power = self._parts(x)
        y = self.op("add", power, less)
        y = self.op("select", self.op("gt", x, _LARGEST), y, math.inf)
        return self.op("select", self.op("lt", x, -_LARGEST), y, 0.0)

    def expm1(self, x):
        """Compute the exponential less 1."""
        less, power = self._parts(x)
        y = self.op("add", less, self.op("sub", power, 1.0))
        return self.op("select", self.op("gt", x, _LARGEST), y, math.inf)

    def tanh(self, x):
        """Compute the hyperbolic tangent."""
        op = self.op
        # tanh(20) rounds to 1 in double precision
        less, power = self._parts(op("mul", self.between(op("abs", x), 0.0, 20.0), 2.0))
        e = op("add", less, op("sub", power, 1.0))
        y = op("div", e, op("add", e, 2.0))
        return op("select", op("lt", x, 0.0), y, op("neg", y))

    def sin(self, x):
        """Compute the sine."""
        shifted = self.op("add", self.op("mul", x, 1 / math.pi), _ROUND)
        return self._half_turn(x, shifted, self.op("sub", shifted, _ROUND))

    def cos(self, x):
        """Compute the cosine."""
        op = self.op
        shifted = op("add", op("add", op("mul", x, 1 / math.pi), 0.5), _ROUND)
        return self._half_turn(x, shifted, op("sub", op("sub", shifted, _ROUND), 0.5))

    def _half_turn(self, x, shifted, turns):
        op, r = self.op, x
        for part in _PI:
            r = op("sub", r, op("mul", turns, part))
        square = op("mul", r, r)
        y = op("add", r, op("mul", op("mul", r, square), self.polynomial(square, _SIN)))
        return op("select", op("odd", shifted), y, op("neg", y))

    def sign(self, x):
        """Compute -1, 0 or 1; nan stays."""
        positive = self.op("select", self.op("gt", x, 0.0), x, 1.0)
        return self.op("select", self.op("lt", x, 0.0), positive, -1.0)

    def max(self, a, b):
        """Compute the larger number; nan if one is nan."""
        return self.op("select", self._wins("gt", a, b), b, a)

    def min(self, a, b):
        """Compute the smaller number; nan if one is nan."""
        return self.op("select", self._wins("lt", a, b), b, a)

    def _wins(self, test, a, b):
        return self.op("or", self.op(test, a, b), self.op("ne", a, a))

    def is_finite(self, x):
        """Return whether x is neither infinite nor nan."""
        return self.op("lt", self.op("abs", x), math.inf)

    def real(self, x):
        """Convert a truth to 1 or 0."""
        return self.op("select", x, 0.0, 1.0)


OWN = ("exp", "expm1", "tanh", "sin", "cos", "sign", "max", "min", "is_finite", "real")
