"""Taylor expansions of arrays, to carry derivatives through formulas that are written once.

`Taylor` is a number with its first derivatives by some parameters, and with its first and second one by one variable,
which is told apart: what a ring needs of its rollers' loads, by sizes and by approach. Its parts are arrays of numpy or
of JAX; None stands for 0, costs nothing and stays None. `core.arrays` has the functions of them.
"""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

Part = Any
"""An array of numpy's or JAX's, or a number; None: 0."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class Taylor:
    """A value with derivatives.

    Attributes:
      value: of any shape.
      slope, bend: first and second derivative by the variable, of that shape. A bend of None beside a slope is not
        wanted, and stays so.
      by: derivatives by the parameters, shape (parameters, …).
      slope_by: of the slope by the parameters, the same shape.
    """

    value: Part
    slope: Part = None
    bend: Part = None
    by: Part = None
    slope_by: Part = None

    __array_ufunc__ = None  # numpy leaves arithmetic with it to this class

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the value."""
        return np.shape(self.value)

    @property
    def ndim(self) -> int:
        """Of the value."""
        return np.ndim(self.value)

    @property
    def size(self) -> int:
        """Of the value."""
        return int(np.prod(self.shape))

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, index: Any) -> Taylor:
        inner = index if isinstance(index, tuple) else (index,)
        return self.mapped(lambda part: part[index], lambda part: part[(slice(None), *inner)])

    def mapped(self, plain: Callable[[Any], Any], by: Callable[[Any], Any]) -> Taylor:
        """With a linear function of every part: `plain` of value, slope and bend, `by` of the others."""
        parts = [None if part is None else plain(part) for part in (self.value, self.slope, self.bend)]
        return Taylor(*parts, *(None if part is None else by(part) for part in (self.by, self.slope_by)))

    def reshape(self, *shape: int) -> Taylor:
        """Of the value's shape."""
        return self.mapped(lambda part: part.reshape(*shape), lambda part: part.reshape(part.shape[0], *shape))

    def __neg__(self) -> Taylor:
        return self.mapped(lambda part: -part, lambda part: -part)

    def __add__(self, other: Any) -> Taylor:
        a, b, rank = _pair(self, other)
        slope, bend, by, slope_by = map(plus, _rest(a, rank), _rest(b, rank))
        return whole(a.value + b.value, slope, bend if bends(a, b) else None, by, slope_by)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Taylor:
        return self + -other

    def __rsub__(self, other: Any) -> Taylor:
        return -self + other

    def __mul__(self, other: Any) -> Taylor:
        return _multiplied(self, other)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Taylor:
        return _divided(self, other) if isinstance(other, Taylor) else self * (1.0 / other)

    def __rtruediv__(self, other: Any) -> Taylor:
        return _divided(other, self)

    def __pow__(self, exponent: float) -> Taylor:
        if exponent == 2:
            return self * self
        power = self.value ** (exponent - 2.0)
        at = power * self.value
        return chained(self, at * self.value, exponent * at, exponent * (exponent - 1.0) * power)

    def __eq__(self, other: Any) -> Any:
        return self.value == value(other)

    def __ne__(self, other: Any) -> Any:
        return self.value != value(other)

    __hash__ = None  # type: ignore[assignment]

    def __gt__(self, other: Any) -> Any:
        return self.value > value(other)

    def __ge__(self, other: Any) -> Any:
        return self.value >= value(other)

    def __lt__(self, other: Any) -> Any:
        return self.value < value(other)

    def __le__(self, other: Any) -> Any:
        return self.value <= value(other)


def value(x: Any) -> Any:
    """`x`, or the value of an expansion."""
    return x.value if isinstance(x, Taylor) else x


def values(tree: Any) -> Any:
    """A pytree with values in place of expansions."""
    return jax.tree.map(value, tree, is_leaf=lambda leaf: isinstance(leaf, Taylor))


def bends(*every: Taylor) -> bool:
    """Whether second derivatives by the variable are wanted of all that have a first one."""
    return all(x.slope is None or x.bend is not None for x in every)


def plus(p: Any, q: Any) -> Any:
    """The sum of two parts."""
    return q if p is None else p if q is None else p + q


def whole(value: Any, slope: Any, bend: Any, by: Any, slope_by: Any) -> Taylor:
    """An expansion whose parts are spread over the shape of its value."""
    shape = np.shape(value)

    def spread(part: Any, own: tuple[int, ...]) -> Any:
        if part is None or np.shape(part) == own:
            return part
        return (jnp if isinstance(part, jax.Array) else np).broadcast_to(part, own)

    return Taylor(
        value, spread(slope, shape), spread(bend, shape),
        *(part if part is None else spread(part, (len(part), *shape)) for part in (by, slope_by)),
    )  # fmt: skip


def chained(x: Taylor, f: Any, rate: Any, bend: Any) -> Taylor:
    """A function of `x`, entry by entry, from its value and its first two derivatives at `x.value`."""
    bent = None if bend is None or x.slope is None or (x.bend is None and x.by is None) else bend * x.slope
    return Taylor(
        f,
        summed((rate, x.slope)),
        summed((rate, x.bend), (bent, x.slope)) if bends(x) else None,
        summed((x.by, rate), product=by_product),
        summed((x.slope_by, rate), (x.by, bent), product=by_product),
    )


def summed(*pairs: tuple[Any, Any], product: Callable[[Any, Any], Any] = operator.mul) -> Any:
    """The sum of products of parts; those of which one is None are 0, and so is None."""
    found = None
    for p, q in pairs:
        if p is not None and q is not None:
            found = product(p, q) if found is None else found + product(p, q)
    return found


def _multiplied(a: Any, b: Any) -> Taylor:
    """a·b, of which one may be no expansion."""
    a, b, rank = _pair(a, b)
    (a1, a2, a_by, a1_by), (b1, b2, b_by, b1_by) = _rest(a, rank), _rest(b, rank)
    return whole(
        a.value * b.value,
        summed((a1, b.value), (a.value, b1)),
        summed((a2, b.value), (a.value, b2), (None if a1 is None else 2.0 * a1, b1)) if bends(a, b) else None,
        summed((a_by, b.value), (b_by, a.value), product=by_product),
        summed((a1_by, b.value), (b1_by, a.value), (a_by, b1), (b_by, a1), product=by_product),
    )


def _divided(a: Any, b: Any) -> Taylor:
    """a/b, of which one may be no expansion."""
    a, b, rank = _pair(a, b)
    (a1, a2, a_by, a1_by), (b1, b2, b_by, b1_by) = _rest(a, rank), _rest(b, rank)
    value, share = a.value / b.value, 1.0 / b.value
    minus = -value
    slope = summed((plus(a1, summed((b1, minus))), share))
    bend, falls = None, None if slope is None else -slope
    if bends(a, b):
        twice = None if falls is None else 2.0 * falls
        bend = summed((plus(a2, summed((b2, minus), (b1, twice))), share))
    by = summed((plus(a_by, summed((b_by, minus), product=by_product)), share), product=by_product)
    back = None if b1 is None else -b1
    rest = summed((b1_by, minus), (b_by, falls), (by, back), product=by_product)
    return whole(value, slope, bend, by, summed((plus(a1_by, rest), share), product=by_product))


def by_product(by: Any, value: Any) -> Any:
    """Derivatives by parameters times a value."""
    missing = np.ndim(by) - 1 - np.ndim(value)
    if not np.ndim(value):
        return by * value
    if isinstance(value, jax.Array) and not missing:
        return by * jax.lax.broadcast(value, (len(by),))
    return by * value[(None,) * (missing + 1)]


def _pair(a: Any, b: Any) -> tuple[Taylor, Taylor, int]:
    """Both as expansions, and the larger of their ranks."""
    a, b = (x if isinstance(x, Taylor) else Taylor(x) for x in (a, b))
    return a, b, max(a.ndim, b.ndim)


def _rest(x: Taylor, rank: int) -> tuple[Any, Any, Any, Any]:
    """The derivatives, those by parameters in shapes that go with values of that rank."""
    missing = rank - x.ndim

    def spread(part: Any) -> Any:
        return part if part is None or not missing else part.reshape(part.shape[:1] + (1,) * missing + part.shape[1:])

    return x.slope, x.bend, spread(x.by), spread(x.slope_by)
