"""Times of what users wait for, as a pytest-benchmark suite; off by default.

taskset -c 0 python -m pytest -n0 experiments/benchmarks.py   (pip install -e '.[test,speed]')

`became_slower.py` runs it and compares with a baseline, in times by the yardstick.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import pytest

import difftrb as trb
from difftrb.core import machine
from difftrb.scene.scene import LawName

BATCH = 256
SCENE = trb.Scene(trb.bearing("32008J"), trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),))
LAWS = ("liu2018", "power", "direct")
by_law = pytest.mark.parametrize("law", LAWS)
METHODS = {"strips": 1e-3, "cells": 1e-3, "lattice": 1e-2}


def named(law: str) -> trb.Scene:
    return dataclasses.replace(SCENE, law=LawName(law))


def sized(ready: trb.Scene, sizes: jax.Array, radial: jax.Array) -> jax.Array:
    """Radial stiffness [N/mm] for a length and width of the spall [mm] under a radial load [N]."""
    spall = dataclasses.replace(ready.spalls[0], length=sizes[0], width=sizes[1])
    load = dataclasses.replace(ready.load, radial=radial)
    return trb.solve(dataclasses.replace(ready, spalls=(spall,), load=load)).radial_stiffness


SIZES, RADIALS = jnp.array([4.0, 7.0]), jnp.linspace(8100.0, 9000.0, BATCH)
_batch = jax.jit(jax.vmap(sized, in_axes=(None, None, 0)))
_slopes = jax.jit(jax.vmap(jax.value_and_grad(sized, argnums=1), in_axes=(None, None, 0)))


def timed(benchmark: Any, function: Callable[[], Any]) -> None:
    """Once to compile, then as pytest-benchmark does it."""
    jax.block_until_ready(function())
    benchmark(lambda: jax.block_until_ready(function()))


def test_yardstick(benchmark: Any) -> None:
    timed(benchmark, machine.yardstick_work())


@by_law
def test_prepare(benchmark: Any, law: str) -> None:
    timed(benchmark, lambda: trb.prepare(named(law)))


@by_law
def test_solve(benchmark: Any, law: str) -> None:
    ready = trb.prepare(named(law))
    timed(benchmark, lambda: trb.solve(ready))


@by_law
def test_batch(benchmark: Any, law: str) -> None:
    ready = trb.prepare(named(law))
    timed(benchmark, lambda: _batch(ready, SIZES, RADIALS))


@by_law
def test_batch_with_gradient(benchmark: Any, law: str) -> None:
    ready = trb.prepare(named(law))
    timed(benchmark, lambda: _slopes(ready, SIZES, RADIALS))


@pytest.mark.parametrize("method", METHODS)
def test_contact(benchmark: Any, method: Any) -> None:
    contact = trb.LineContact.of(SCENE.bearing, "outer", design_load=6500.0)
    timed(benchmark, lambda: trb.solve_contact(contact, 3000.0, SCENE.spalls[0], 0.0, METHODS[method], method))
