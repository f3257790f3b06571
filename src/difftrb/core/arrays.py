"""The functions that formulas of law and ring are written in: of numpy's arrays by numpy, of JAX's by JAX.

So one scene of numbers is solved at once, by numpy, and what is traced goes into a program, from the same lines. Both
may be the parts of a `Taylor` expansion, which then goes through with its derivatives.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.core
import jax.numpy as jnp
import numpy as np

from difftrb.core.taylor import (
    Taylor,
    chained,
    rest,
    summed,
    value,
    values,
    variable,
    whole,
    with_one_more,
    with_variable,
)
from difftrb.core.taylor import by_of as by

__all__ = ["Taylor", "by", "value", "values", "variable", "with_one_more", "with_variable"]
PRECISE = jax.lax.Precision.HIGHEST
OF_NUMPY = frozenset({np.ndarray, np.float64, np.bool_, float, int, bool, type(None)})
LARGE = 2000  # entries from which numpy's sums of products are worth its thinking about how


def module_of(*arguments: Any) -> Any:
    """`jax.numpy` if there is an array of JAX among these (or in a list of them), else `numpy`."""
    for one in arguments:
        if type(one) in OF_NUMPY:  # asking whether it is one of JAX's takes ten times as long
            continue
        if isinstance(one, jax.Array):
            return jnp
        if isinstance(one, Taylor):
            if module_of(one.value, one.by) is jnp:
                return jnp
        elif isinstance(one, list | tuple) and module_of(*one) is jnp:
            return jnp
    return np


def _function(name: str, rates: Callable[[Any, Any, Any], tuple[Any, Any]]) -> Callable[[Any], Any]:
    """A function of one array; `rates(xp, x, f)` are its first two derivatives."""

    def function(x: Any) -> Any:
        xp = module_of(x)
        if not isinstance(x, Taylor):
            return getattr(xp, name)(x)
        f = getattr(xp, name)(x.value)
        return chained(x, f, *rates(xp, x.value, f))

    function.__name__, function.__doc__ = name, f"As numpy's, of arrays and expansions: `{name}`."
    return function


sin = _function("sin", lambda xp, x, f: (xp.cos(x), -f))
cos = _function("cos", lambda xp, x, f: (-xp.sin(x), -f))
tan = _function("tan", lambda xp, x, f: (1.0 + f * f, 2.0 * f * (1.0 + f * f)))
exp = _function("exp", lambda xp, x, f: (f, f))
log = _function("log", lambda xp, x, f: (1.0 / x, -1.0 / (x * x)))
expm1 = _function("expm1", lambda xp, x, f: (1.0 + f, 1.0 + f))
log1p = _function("log1p", lambda xp, x, f: (1.0 / (1.0 + x), -1.0 / ((1.0 + x) * (1.0 + x))))
sqrt = _function("sqrt", lambda xp, x, f: (0.5 / f, -0.25 / (f * x)))
arcsinh = _function("arcsinh", lambda xp, x, f: (1.0 / xp.sqrt(1.0 + x * x), -x / (1.0 + x * x) ** 1.5))
arctan = _function("arctan", lambda xp, x, f: (1.0 / (1.0 + x * x), -2.0 * x / (1.0 + x * x) ** 2))
arccos = _function("arccos", lambda xp, x, f: (-1.0 / xp.sqrt(1.0 - x * x), -x / (1.0 - x * x) ** 1.5))


def with_rates(function: Callable[[Any], tuple[Any, Any, Any]], x: Any) -> Any:
    """A function of numbers that tells its first two derivatives, too, entry by entry."""
    return chained(x, *function(x.value)) if isinstance(x, Taylor) else function(x)[0]


def __getattr__(name: str) -> Callable[..., Any]:
    """Any other function of numpy's that JAX has, too: by whichever its arguments are of. Not for expansions."""
    if name.startswith("_") or not hasattr(np, name):
        raise AttributeError(name)

    def function(*arguments: Any, **options: Any) -> Any:
        return getattr(module_of(*arguments), name)(*arguments, **options)

    return function


def asarray(x: Any) -> Any:
    """In floats."""
    return dataclasses.replace(x, value=asarray(x.value)) if isinstance(x, Taylor) else module_of(x).asarray(x, float)


def where(condition: Any, a: Any, b: Any) -> Any:
    """As numpy's; what is not chosen leaves nothing in the derivatives."""
    xp = module_of(condition, a, b)
    if not isinstance(a, Taylor) and not isinstance(b, Taylor):
        return xp.where(condition, a, b)
    a, b = (x if isinstance(x, Taylor) else Taylor(x) for x in (a, b))
    rank = max(np.ndim(condition), a.ndim, b.ndim)
    shape = np.shape(condition)
    up = condition if not shape else condition.reshape((1,) * (rank + 1 - len(shape)) + shape)

    def chosen(p: Any, q: Any) -> Any:
        if p is None and q is None:
            return None
        return xp.where(up, 0.0 if p is None else p, 0.0 if q is None else q)

    return whole(xp.where(condition, a.value, b.value), *map(chosen, rest(a, rank), rest(b, rank)))


def maximum(a: Any, b: Any) -> Any:
    """As numpy's; of equals it has half the derivatives of either, so that mirror images leave none."""
    if not isinstance(a, Taylor) and not isinstance(b, Taylor):
        return module_of(a, b).maximum(a, b)
    return where(a > b, a, where(value(a) == value(b), 0.5 * (a + b), b))


def minimum(a: Any, b: Any) -> Any:
    """As numpy's; of equals as `maximum`."""
    if not isinstance(a, Taylor) and not isinstance(b, Taylor):
        return module_of(a, b).minimum(a, b)
    return -maximum(-a, -b)


def clip(x: Any, low: Any, high: Any) -> Any:
    """As numpy's; at its ends as `maximum`."""
    if any(isinstance(one, Taylor) for one in (x, low, high)):
        return minimum(maximum(x, low), high)
    return module_of(x, low, high).clip(x, low, high)


def diff(x: Any, **options: Any) -> Any:
    """As numpy's; of an expansion with one axis."""
    return x[1:] - x[:-1] if isinstance(x, Taylor) else module_of(x).diff(x, **options)


def within(x: Any, low: Any, high: Any) -> Any:
    """As clip, whose derivative in JAX, a half at either end, costs divisions; here it is whole at the ends."""
    return where(x >= low, where(x <= high, x, high), low)


def magnitude(x: Any) -> Any:
    """|x|, of which the derivative at 0 is 0."""
    if not isinstance(x, Taylor):
        return module_of(x).abs(x)
    return x * module_of(x).sign(x.value)


def mod(x: Any, period: float) -> Any:
    """The rest in 0 … period."""
    if not isinstance(x, Taylor):
        return module_of(x).mod(x, period)
    return x + (module_of(x).mod(x.value, period) - x.value)


def stack(parts: Sequence[Any], axis: int = 0) -> Any:
    """As numpy's, of equal shapes; numbers may be among the arrays. `axis` is not negative, or −1."""
    return _joined("stack", list(parts), axis)


def concatenate(parts: Sequence[Any], axis: int = 0) -> Any:
    """As numpy's. `axis` is 0 or −1."""
    return _joined("concatenate", list(parts), axis)


def _joined(name: str, parts: list[Any], axis: int) -> Any:
    xp = module_of(parts)
    join = getattr(xp, name)
    if not any(isinstance(part, Taylor) for part in parts):
        return join([xp.asarray(part, float) if isinstance(part, float | int) else part for part in parts], axis=axis)
    every = [part if isinstance(part, Taylor) else Taylor(xp.asarray(part, float)) for part in parts]

    def joined(field: str) -> Any:
        own = [getattr(part, field) for part in every]
        if all(part is None for part in own):
            return None
        by = field != "value"
        first = next(part for part in own if part is not None).shape[:1] if by else ()
        filled = [xp.zeros(first + part.shape) if one is None else one for one, part in zip(own, every, strict=True)]
        return join(filled, axis=axis + 1 if by and axis >= 0 else axis)

    return Taylor(*(joined(field) for field in ("value", "by", "mixed")))


def total(x: Any) -> Any:
    """Sum over the last axis."""

    def summed(part: Any) -> Any:
        return module_of(x).sum(part, axis=-1)

    return x.mapped(summed, summed) if isinstance(x, Taylor) else summed(x)


def leading_total(x: Any) -> Any:
    """Sum over the first axis."""
    if not isinstance(x, Taylor):
        return x.sum(axis=0)
    return x.mapped(lambda part: part.sum(axis=0), lambda part: part.sum(axis=1))


def largest(x: Any) -> Any:
    """Of every entry along the first axis; several that are largest have equal parts of the derivatives, as JAX's."""
    top = module_of(x).max(value(x), axis=0)
    if not isinstance(x, Taylor):
        return top
    equal = x.value == top[None]
    return dataclasses.replace(leading_total(where(equal, x, 0.0)) * (1.0 / equal.sum(axis=0)), value=top)


def taken(x: Any, index: Any) -> Any:
    """Of the first axis the entry at `index`, whose shape is that behind it."""
    xp = module_of(x, index)
    if not isinstance(x, Taylor):
        return xp.take_along_axis(x, index[None], 0)[0]
    return x.mapped(
        lambda part: xp.take_along_axis(part, index[None], 0)[0],
        lambda part: xp.take_along_axis(part, xp.broadcast_to(index[None, None], (len(part), 1, *index.shape)), 1)[
            :, 0
        ],
    )


def broadcast_to(x: Any, shape: tuple[int, ...]) -> Any:
    """As numpy's, of an `x` of the same rank."""
    xp = module_of(x)
    if not isinstance(x, Taylor):
        return xp.broadcast_to(x, shape)
    return x.mapped(
        lambda part: xp.broadcast_to(part, shape), lambda part: xp.broadcast_to(part, part.shape[:1] + shape)
    )


def einsum(form: str, a: Any, b: Any) -> Any:
    """As numpy's, of two arrays, precisely; without the letter z."""
    if module_of(a, b) is jnp:
        summed_up: Callable[..., Any] = _einsum_of_jax
    else:
        summed_up = partial(np.einsum, optimize=np.size(value(a)) > LARGE)
    if not isinstance(a, Taylor) and not isinstance(b, Taylor):
        return summed_up(form, a, b)
    inputs, out = form.split("->")
    one, other = inputs.split(",")
    a, b = (x if isinstance(x, Taylor) else Taylor(x) for x in (a, b))

    def product(p: Any, q: Any) -> Any:
        p_up, q_up = p.ndim > a.ndim, q.ndim > b.ndim
        return summed_up(f"{'z' * p_up}{one},{'z' * q_up}{other}->{'z' * (p_up or q_up)}{out}", p, q)

    a_last, b_last = (None if x.mixed is None else x.by[-1] for x in (a, b))
    return Taylor(
        product(a.value, b.value),
        summed((a.by, b.value), (a.value, b.by), product=product),
        summed((a.mixed, b.value), (a.value, b.mixed), (a_last, b.by), (a.by, b_last), product=product),
    )


def _einsum_of_jax(form: str, a: Any, b: Any) -> Any:
    """Without axes of length 1 in front of what is summed, such as a single phase is: of those XLA makes products with
    copies of both, and a ring with derivatives takes a tenth longer."""
    *inputs, (place, _, _) = (part.partition("...") for part in form.replace("->", ",").split(","))
    every = [(x, len(before), x.ndim - len(after)) for x, (before, _, after) in zip((a, b), inputs, strict=True)]
    alone = max((x.shape[start:end] for x, start, end in every), key=len)
    if not alone or any(size != 1 for x, start, end in every for size in x.shape[start:end]):
        return jnp.einsum(form, a, b, precision=PRECISE)
    left = (x.reshape(x.shape[:start] + x.shape[end:]) for x, start, end in every)
    found = jnp.einsum(form.replace("...", ""), *left, precision=PRECISE)
    return found.reshape(found.shape[: len(place)] + alone + found.shape[len(place) :])


def block_diagonal(blocks: Sequence[Any]) -> Any:
    """The matrix with these blocks on its diagonal."""
    widths, rows, before = [block.shape[1] for block in blocks], [], 0
    for block, width in zip(blocks, widths, strict=True):
        sides = (np.zeros((block.shape[0], n)) for n in (before, sum(widths) - before - width))
        rows.append(concatenate([next(sides), block, next(sides)], axis=-1))
        before += width
    return concatenate(rows)


def moveaxis(x: Any, start: int, end: int) -> Any:
    """As numpy's; of the axes 0 and −1."""
    xp = module_of(x)
    if not isinstance(x, Taylor):
        return xp.moveaxis(x, start, end)
    up = {0: 1, -1: -1}  # behind the parameters
    return x.mapped(lambda part: xp.moveaxis(part, start, end), lambda part: xp.moveaxis(part, up[start], up[end]))


def in_few(function: Callable[..., Any], *scalars: Any) -> Any:
    """`function(*scalars)`, an array or a pytree of such. Where these are expanded by more parameters than there are
    scalars, it is expanded by the scalars first, and then by what they depend on."""
    moving = [k for k, x in enumerate(scalars) if by(x) is not None]
    if not moving or len(moving) >= len(by(scalars[moving[0]])):
        return function(*scalars)
    seeds = list(scalars)
    for row, k in zip(np.eye(len(moving)), moving, strict=True):
        seeds[k] = Taylor(scalars[k].value, by=row)

    def chained_on(x: Any) -> Any:
        return x if by(x) is None else along(x.value, list(x.by), [scalars[k] for k in moving])

    return tree_map(chained_on, function(*seeds))


def along(value: Any, rates: Sequence[Any], scalars: Sequence[Any]) -> Any:
    """The array that has this value, and these derivatives by scalars; those of what is not expanded may be None."""
    moving = [(rate, by(x)) for rate, x in zip(rates, scalars, strict=True) if by(x) is not None]
    if not moving:
        return value
    own, every = (module_of(value).stack(parts) for parts in zip(*moving, strict=True))  # (scalars, …)
    return Taylor(value, by=module_of(value, every).tensordot(every.T, own, 1))


def solved(matrix: Any, right: Any) -> Any:
    """x with `matrix` x = `right`, shapes (…, n, n), (…, n, m); NaN where a matrix is singular, as JAX has it."""
    try:
        return module_of(matrix, right).linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        if matrix.ndim == 2:
            return np.full(right.shape, np.nan)
    every = np.broadcast_to(matrix, (*right.shape[:-2], *matrix.shape[-2:]))
    return np.stack([solved(*each) for each in zip(every, right, strict=True)])


def ones_like(x: Any) -> Any:
    """Of the shape of `x`'s value."""
    return module_of(x).ones_like(value(x))


def zeros_like(x: Any) -> Any:
    """Of the shape of `x`'s value."""
    return module_of(x).zeros_like(value(x))


def are_numbers(tree: Any) -> bool:
    """Whether nothing in a pytree is traced."""
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def of_jax(tree: Any) -> bool:
    """Whether there is an array of JAX in a pytree."""
    return any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(tree))


def expands(tree: Any) -> bool:
    """Whether there is an expansion in a pytree."""
    leaves = jax.tree.leaves(tree, is_leaf=lambda leaf: isinstance(leaf, Taylor))
    return any(isinstance(leaf, Taylor) for leaf in leaves)


def numbers(tree: Any) -> Any:
    """A pytree that is not traced, in numpy's numbers and arrays: 0/0 of Python's raises."""

    def number(leaf: Any) -> Any:
        return (
            np.float64(leaf) if isinstance(leaf, float) else np.asarray(leaf) if isinstance(leaf, jax.Array) else leaf
        )

    return jax.tree.map(number, tree)


def fixed(x: Any) -> Any:
    """A pytree of values, without expansions, that JAX does not differentiate."""
    return jax.tree.map(lambda leaf: jax.lax.stop_gradient(leaf) if isinstance(leaf, jax.Array) else leaf, values(x))


def tree_map(function: Callable[..., Any], *trees: Any) -> Any:
    """As `jax.tree.map`, to which expansions are leaves."""
    return jax.tree.map(function, *trees, is_leaf=lambda leaf: isinstance(leaf, Taylor))
