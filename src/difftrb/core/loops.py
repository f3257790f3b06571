"""Loops over arrays, expansions and pytrees of them: in Python of numpy's numbers, in the program of JAX's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from difftrb.core import arrays as xp
from difftrb.core.taylor import Taylor


def repeated(count: int, function: Callable[[Any], Any], start: Any) -> Any:
    """`function` of what it returned, so many times: by a loop in the program, if there is one."""
    return counted(count, lambda _, x: function(x), start)


def counted(count: int, function: Callable[[Any, Any], Any], start: Any) -> Any:
    """`function(k, x)` of what it returned, for k from 0 on, as `repeated`."""
    if xp.of_jax(start):
        start, once = _started(function, start)
        return jax.lax.fori_loop(0, count, once, start)
    for k in range(count):
        start = function(k, start)
    return start


def repeated_while(going: Callable[[Any], Any], function: Callable[[Any], Any], start: Any) -> Any:
    """`function` of what it returned, as long as `going`."""
    if xp.of_jax(start):
        return jax.lax.while_loop(going, function, start)
    while going(start):
        start = function(start)
    return start


def done_if(needed: Any, function: Callable[[Any], Any], start: Any) -> Any:
    """`function(start)` where it is `needed`; else `start`, at once: in a batch, too, by a loop that may have no
    rounds. Without reverse derivatives."""
    if xp.of_jax(start):
        start, once = _started(lambda _, x: function(x), start)
        first = jnp.asarray(needed), start
        return jax.lax.while_loop(
            lambda state: state[0], lambda state: (jnp.zeros_like(state[0]), once(0, state[1])), first
        )[1]
    return function(start) if needed else start


def together(tree: Any) -> Any:
    """The same pytree behind an optimisation barrier: XLA does not compute parts of it again where they are used."""
    return jax.lax.optimization_barrier(tree) if xp.of_jax(tree) else tree


def _started(function: Callable[[Any, Any], Any], start: Any) -> tuple[Any, Callable[[Any, Any], Any]]:
    """For a loop: `start` with zeros for the derivatives that `function` adds, and `function` traced once for all."""
    once = jax.jit(function, inline=True)
    for _ in range(3):
        start = xp.tree_map(_filled, start, jax.eval_shape(once, 0, start))
    return start, once


def _filled(x: Any, like: Any) -> Any:
    """An array or expansion with zeros for derivatives that `like` has and `x` has not."""
    if not isinstance(like, Taylor):
        return x
    x = x if isinstance(x, Taylor) else Taylor(x)
    parts = [getattr(x, name) for name in Taylor.__slots__]
    others = [getattr(like, name) for name in Taylor.__slots__]
    return Taylor(
        *(jnp.zeros(b.shape) if a is None and b is not None else a for a, b in zip(parts, others, strict=True))
    )
