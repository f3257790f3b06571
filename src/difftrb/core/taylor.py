"""Taylor expansions of arrays, to carry derivatives through formulas that are written once.

`Taylor` is a number with its first derivatives by some parameters, and with the second ones by each of them and the
last: what a ring needs of its rollers' loads, by sizes and by approach, which is the last. Its parts are arrays of
numpy or of JAX; None stands for 0, costs nothing and stays None. `core.arrays` has the functions of them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core.status import SceneError

Part = Any
"""An array of numpy's or JAX's, or a number; None: 0."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class Taylor:
    """A value with derivatives.

    Attributes:
      value: of any shape.
      by: derivatives by the parameters, shape (parameters, …).
      mixed: second derivatives by each parameter and the last one, the same shape. None of all that goes into a formula
        if they are not wanted; of what does not depend on the last parameter it may be None, too.
    """

    value: Part
    by: Part = None
    mixed: Part = None

    __array_ufunc__ = None  # numpy leaves arithmetic with it to this class

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the value."""
        return np.shape(self.value)

    @property
    def ndim(self) -> int:
        """Of the value."""
        return _rank(self.value)

    @property
    def size(self) -> int:
        """Of the value."""
        return int(np.prod(self.shape))

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Iterator[Taylor]:
        return (self[k] for k in range(len(self)))  # an array of JAX has no index that ends it

    def __getitem__(self, index: Any) -> Taylor:
        inner = index if isinstance(index, tuple) else (index,)
        traced = any(isinstance(each, jax.Array) for each in inner)

        def known(part: Part) -> Part:  # of numpy where it is of known numbers, which a traced index cannot take from
            return jnp.asarray(part) if traced and isinstance(part, np.ndarray) else part

        return self.mapped(lambda part: known(part)[index], lambda part: known(part)[(slice(None), *inner)])

    def mapped(self, plain: Callable[[Any], Any], by: Callable[[Any], Any]) -> Taylor:
        """With a linear function of every part: `plain` of the value, `by` of the others."""
        return Taylor(plain(self.value), *(None if part is None else by(part) for part in (self.by, self.mixed)))

    def reshape(self, *shape: int) -> Taylor:
        """Of the value's shape."""
        return self.mapped(lambda part: part.reshape(*shape), lambda part: part.reshape(part.shape[0], *shape))

    def __neg__(self) -> Taylor:
        return self.mapped(lambda part: -part, lambda part: -part)

    def __add__(self, other: Any) -> Taylor:
        a, b, rank = _pair(self, other)
        return whole(a.value + b.value, *map(plus, rest(a, rank), rest(b, rank)))

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


@contextmanager
def goes_through(formulas: str) -> Iterator[None]:
    """Raises `SceneError`, in one sentence, where an expansion went into a function of JAX or numpy among what the
    user calls these `formulas`."""
    try:
        yield
    except TypeError as error:
        if Taylor.__name__ not in str(error):
            raise
        raise SceneError(
            f"{formulas}: formulas over jax.numpy or numpy take no derivatives along; write them over "
            "difftrb.core.arrays, as docs/extending.md shows"
        ) from error


def value(x: Any) -> Any:
    """`x`, or the value of an expansion."""
    return x.value if isinstance(x, Taylor) else x


def values(tree: Any) -> Any:
    """A pytree with values in place of expansions."""
    return jax.tree.map(value, tree, is_leaf=_is_taylor)


def plus(p: Any, q: Any) -> Any:
    """The sum of two parts, of as many parameters."""
    if p is None or q is None:
        return q if p is None else p
    if len(p) != len(q):
        raise TypeError(f"expansions by {len(p)} and by {len(q)} parameters do not go together")
    return p + q


def whole(value: Any, by: Any, mixed: Any) -> Taylor:
    """An expansion whose parts are spread over the shape of its value."""
    shape = np.shape(value)

    def spread(part: Any) -> Any:
        if part is None or part.shape[1:] == shape:
            return part
        return _of(part).broadcast_to(part, (len(part), *shape))

    return Taylor(value, spread(by), spread(mixed))


def variable(x: Any) -> Taylor:
    """`x` as the only parameter, to first derivatives."""
    return Taylor(x, _of(x).ones_like(x)[None])


def with_variable(x: Any, others: Any) -> tuple[Taylor, Any]:
    """As `with_one_more`, to second derivatives."""
    at, others = with_one_more(x, others)
    return dataclasses.replace(at, mixed=_of(at.by).zeros_like(at.by)), others


def with_one_more(x: Any, others: Any) -> tuple[Taylor, Any]:
    """An array or expansion `x` as one more parameter, the last; and a pytree whose expansions have it, too, and do not
    change by it. All may be expanded by the same parameters, or by none."""
    count = parameters_of((x, others))

    def widened(leaf: Any) -> Any:
        own = by_of(leaf)
        return leaf if own is None else Taylor(leaf.value, _of(own).concatenate([own, _of(own).zeros_like(own[:1])]))

    at, own = value(x), by_of(x)
    of = _of(at)
    last = of.ones_like(at)[None]
    before = of.zeros((count, *np.shape(at))) if own is None else own
    by = of.concatenate([before, last]) if count else last
    return Taylor(at, by), jax.tree.map(widened, others, is_leaf=_is_taylor)


def parameters_of(tree: Any) -> int:
    """By how many parameters what is expanded in a pytree is; 0 if nothing is."""
    every = map(by_of, jax.tree.leaves(tree, is_leaf=_is_taylor))
    return next((len(by) for by in every if by is not None), 0)


def parameters(leaves: Sequence[Any]) -> list[Taylor]:
    """Every number in these arrays as a parameter of expansions by all."""
    sizes = [math.prod(np.shape(leaf)) for leaf in leaves]
    every, ends = np.eye(sum(sizes)), np.cumsum(sizes)
    return [
        Taylor(leaf, every[:, end - size : end].reshape(len(every), *np.shape(leaf)))
        for leaf, size, end in zip(leaves, sizes, ends, strict=True)
    ]


def by_of(x: Any) -> Any:
    """Derivatives by parameters, None without."""
    return x.by if isinstance(x, Taylor) else None


def _rank(x: Any) -> int:
    """As numpy's `ndim`, in a third of the time."""
    return getattr(x, "ndim", 0)


def _is_taylor(leaf: Any) -> bool:
    return isinstance(leaf, Taylor)


def _of(part: Any) -> Any:
    """See `arrays.module_of`: of one array."""
    return jnp if isinstance(part, jax.Array) else np


def chained(x: Taylor, f: Any, rate: Any, bend: Any) -> Taylor:
    """A function of `x`, entry by entry, from its value and its first two derivatives at `x.value`."""
    by = summed((x.by, rate))
    if x.mixed is None or bend is None:
        return Taylor(f, by)
    return Taylor(f, by, summed((x.mixed, rate), (x.by, bend * x.by[-1])))


def summed(*pairs: tuple[Any, Any], product: Callable[[Any, Any], Any] | None = None) -> Any:
    """The sum of products of parts, None: of derivatives and values; pairs of which one is None are 0, and so is
    None."""
    found = None
    for p, q in pairs:
        if p is not None and q is not None:
            found = plus(found, (product or by_product)(p, q))
    return found


def _multiplied(a: Any, b: Any) -> Taylor:
    """a·b, of which one may be no expansion."""
    a, b, rank = _pair(a, b)
    (a_by, a_mixed), (b_by, b_mixed) = rest(a, rank), rest(b, rank)
    mixed = summed(
        (a_mixed, b.value), (b_mixed, a.value),
        (b_by, None if a_mixed is None else a_by[-1]), (a_by, None if b_mixed is None else b_by[-1]),
    )  # fmt: skip
    return whole(a.value * b.value, summed((a_by, b.value), (b_by, a.value)), mixed)


def _divided(a: Any, b: Any) -> Taylor:
    """a/b, of which one may be no expansion."""
    a, b, rank = _pair(a, b)
    (a_by, a_mixed), (b_by, b_mixed) = rest(a, rank), rest(b, rank)
    value, share = a.value / b.value, 1.0 / b.value
    minus = -value
    by = summed((plus(a_by, summed((b_by, minus))), share))
    if a_mixed is None and b_mixed is None:
        return whole(value, by, None)
    # (a/b)'' = (a'' − (a/b) b'' − (a/b)' b' − b' (a/b)')/b
    turned = summed((b_mixed, minus), (b_by, -by[-1]), (by, None if b_mixed is None else -b_by[-1]))
    return whole(value, by, summed((plus(a_mixed, turned), share)))


def by_product(by: Any, value: Any) -> Any:
    """Derivatives by parameters times a value."""
    rank = _rank(value)
    if not rank:
        return by * value
    missing = by.ndim - 1 - rank
    if isinstance(value, jax.Array) and not missing:
        return by * jax.lax.broadcast(value, (len(by),))
    return by * value[(None,) * (missing + 1)]


def _pair(a: Any, b: Any) -> tuple[Taylor, Taylor, int]:
    """Both as expansions, and the larger of their ranks."""
    a, b = (x if isinstance(x, Taylor) else Taylor(x) for x in (a, b))
    return a, b, max(a.ndim, b.ndim)


def rest(x: Taylor, rank: int) -> tuple[Any, Any]:
    """The derivatives, in shapes that go with values of that rank."""
    missing = rank - x.ndim

    if not missing:
        return x.by, x.mixed

    def spread(part: Any) -> Any:
        return None if part is None else part.reshape(part.shape[:1] + (1,) * missing + part.shape[1:])

    return spread(x.by), spread(x.mixed)
