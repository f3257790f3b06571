"""What a scene gives: its solution, and what its spalls take of the stiffness."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp

from difftrb.scene import preparation
from difftrb.scene.auto_law import prepare
from difftrb.scene.scene import Scene, healthy
from difftrb.scene.solution import Solution, solved


def solve(scene: Scene) -> Solution:
    """Load distribution and stiffness of a scene.

    Differentiable by every leaf of the scene: `jax.grad(lambda s: solve(s).stiffness[0, 0])(scene)` is a scene of
    gradients. `jit` and `vmap` as you like. Raises `SolveError` without float64, `SceneError` (a ValueError) for what a
    scene file would refuse, see `Scene`, and ValueError for a law that needs `prepare` first; everything else ends as a
    status in the result.
    """
    # a law that is there is carried to the scene's bearing in the compiled program, not one operation at a time
    return solved(preparation.checked(scene) if preparation.has_its_laws(scene) else prepare(scene))


class Assessment(NamedTuple):
    """A spalled bearing beside its healthy self.

    Attributes:
      spalled, healthy: the two solutions.
      loss: of radial and axial stiffness by the spalls [%], shape (2,).
      by_length, by_width: derivatives of radial and axial stiffness by every spall's length and width, the roller law
        held as prepared [N/mm per mm], shape (2, number of spalls); NaN where the stiffness is.
    """

    spalled: Solution
    healthy: Solution
    loss: jax.Array
    by_length: jax.Array
    by_width: jax.Array


def assess(scene: Scene) -> Assessment:
    """Solve a scene with and without its spalls, and how stiffness changes with their sizes.

    As differentiable as `solve`, and the same errors.
    """
    return _assess(prepare(scene))


@jax.jit
def _assess(scene: Scene) -> Assessment:
    sizes = jnp.array([[spall.length, spall.width] for spall in scene.spalls]).reshape(-1, 2)

    def sized(sizes: jax.Array) -> Scene:
        spalls = (dataclasses.replace(s, length=v[0], width=v[1]) for s, v in zip(scene.spalls, sizes, strict=True))
        return dataclasses.replace(scene, spalls=tuple(spalls))

    def both(sizes: jax.Array) -> tuple[jax.Array, Solution]:
        solution = solved(sized(sizes))
        return _stiffness(solution), solution

    slopes, spalled = jax.jacfwd(both, has_aux=True)(sizes)
    slopes = jnp.where(jnp.isnan(_stiffness(spalled))[:, None, None], jnp.nan, slopes)
    sound = solved(healthy(scene))
    loss = 1.0 - _stiffness(spalled) / _stiffness(sound)
    return Assessment(spalled, sound, 100.0 * loss, slopes[..., 0], slopes[..., 1])


def _stiffness(solution: Solution) -> jax.Array:
    return jnp.stack([solution.radial_stiffness, solution.axial_stiffness])
