"""One roller on one raceway by bands: which parts carry load, then smooth pressure between the free boundaries.

First the pressure of every row is a sum of a few non-negative bands, differences of the contacts of a cylinder on
nested intervals that end at the spall's rolling edges. That is a small quadratic problem with bounds, the projected
gradient's fixed point (`choice`), and tells what is loaded and about where each row's pressure ends. Then it is a
sum of smooth modes (`settling`) that leave at every free boundary what its place is wrong by, and it is moved.

The approach is the load's multiplier and stationary in the boundaries: derivatives by all inputs are those of one
bilinear form at what was found. Lengths are in Hertz half-widths, line loads in units of their mean.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import gap as gaps
from difftrb.contact import strip_basis
from difftrb.contact.contact_solution import Inputs
from difftrb.contact.strip_basis import Rows
from difftrb.contact.strip_fourier import LAND, LEFT, RIGHT
from difftrb.core.geometry import Spall
from experiments.bands import choice, rows, settling, waves
from experiments.bands.choice import Quadratic
from experiments.bands.multiplier import multiplier
from experiments.bands.reach import Reach, carried_along, reach_of, spall_edges
from experiments.bands.rows import Fineness, Plan
from experiments.bands.settling import FARTHEST, Scene, Settled

ROUNDS = 15  # steps of the active set
FIRST = {2: (0.85, 1.2), 3: (0.7, 0.95, 1.25), 4: (0.6, 0.88, 1.06, 1.35)}
"""Where bands end, by the guessed distance of the free boundary from the edge or the middle; at first, and later."""
LATER = {2: (0.9, 1.15), 3: (0.75, 1.0, 1.25), 4: (0.6, 0.85, 1.0, 1.2)}


class Bands(NamedTuple):
    """A contact solved by bands.

    Attributes:
      approach: δ [mm]. moment: Σ f·y about the roller's middle [N mm]. compliance: dδ/dload [mm/N].
      error: estimate of the relative error that the free boundaries' places leave in δ.
      settled: mode loads and boundaries, without units. reach: the units.
      still: whether the active set of the bands stood still.
    """

    approach: jax.Array
    moment: jax.Array
    compliance: jax.Array
    error: jax.Array
    settled: Settled
    reach: Reach
    still: jax.Array


def solve(inputs: Inputs, mirrored: bool, edges: int, fine: Fineness) -> tuple[Bands, tuple[Rows, ...], Plan]:
    """The contact of one roller with at most one rectangular spall deeper than the approach, tilted or not; and the
    rows and plan that it was solved with.

    `edges`: how many of the spall's rolling edges may be in reach, 0…2; if one, the nearer, which is then looked at as
    if it were the left one. Differentiable once by all inputs in `approach`, by none in what else is returned.
    """
    reach = jax.lax.stop_gradient(reach_of(inputs, edges))
    groups, hollow = _groups(inputs, reach, mirrored, edges, fine)
    plan = rows.plan_of(groups, hollow, edges, mirrored)
    search = partial(_search, mirrored, edges, fine, plan, reach)
    approach, found = multiplier(partial(_shifted, mirrored, edges, fine, plan), search, inputs)
    return found._replace(approach=approach), groups, plan


def _groups(
    inputs: Inputs, reach: Reach, mirrored: bool, edges: int, fine: Fineness
) -> tuple[tuple[Rows, ...], int | None]:
    low, high = spall_edges(inputs)
    unit = reach.unit
    tips = reach.bottom / unit, reach.top / unit
    return rows.groups_of(low / unit, high / unit, tips, mirrored, inputs.spall is not None, edges, fine)


def _scene(inputs: Inputs, mirrored: bool, edges: int, fine: Fineness, reach: Reach) -> Scene:
    """The contact without units."""
    contact, load, _, _, tilt = inputs
    groups, _ = _groups(inputs, reach, mirrored, edges, fine)
    push = np.pi * contact.modulus / reach.line_load  # from [mm] to the unit of displacement
    kernel = rows.kernel_of(groups, mirrored, fine.edge_frequencies if edges else fine.frequencies, fine.nodes)

    def rest(y: jax.Array) -> jax.Array:
        return push * gaps.rest_at(y * reach.unit, contact, tilt)

    gap = jnp.concatenate([strip_basis.integrals(group, rest) for group in groups]) / kernel.weight
    left, right = _rolling_edges(inputs, edges, reach.unit)
    images = 2.0 if mirrored else 1.0
    return Scene(
        kernel=kernel,
        gap=gap,
        bend=push * reach.unit**2 / (4.0 * contact.radius),  # x²/(2R) in units of 2x²
        left=left,
        right=right,
        load=load / (images * reach.line_load * reach.unit),
        push=push,
    )


def _rolling_edges(inputs: Inputs, edges: int, unit: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Where the spall's rolling edges are, by `unit`; at most FARTHEST, where those are that do not count."""
    spall, far = inputs.spall, jnp.asarray(FARTHEST)
    if not isinstance(spall, Spall) or not edges:
        return -far, far
    offset = jnp.abs(inputs.offset) if edges == 1 else inputs.offset
    left, right = ((offset + side * 0.5 * spall.width) / unit for side in (-1.0, 1.0))
    return jnp.clip(left, -far, far), far if edges == 1 else jnp.clip(right, -far, far)


def _shifted(mirrored: bool, edges: int, fine: Fineness, plan: Plan, found: Bands, inputs: Inputs) -> jax.Array:
    """The approach [mm] to first order in a change of the inputs, at what was found for them.

    Rows and boundaries grow with the units: what they are misplaced by does then not enter.
    """
    reach = carried_along(jax.lax.stop_gradient(found.reach), inputs, edges)
    scene = _scene(inputs, mirrored, edges, fine, reach)
    shift = settling.shift(plan, _frequencies(edges, fine), scene, found.settled)
    approach = jax.lax.stop_gradient(found.settled.approach)
    return (approach + shift) / scene.push


def _frequencies(edges: int, fine: Fineness):
    return fine.edge_frequencies if edges else fine.frequencies


def _search(
    mirrored: bool, edges: int, fine: Fineness, plan: Plan, reach: Reach, inputs: Inputs
) -> tuple[jax.Array, Bands]:
    scene = _scene(inputs, mirrored, edges, fine, reach)
    frequencies = _frequencies(edges, fine)
    size, on, still = _bands(plan, frequencies, scene, scene.push * reach.approach, fine)
    settled = settling.settle(
        plan,
        frequencies,
        scene,
        jnp.asarray(plan.begun_by) @ size,
        jnp.asarray(plan.begun_by) @ on,
        fine.settled,
        fine.tolerance,
    )
    approach = settled.approach / scene.push
    force = settled.loads[:, 0] * scene.kernel.arm[plan.rows]
    moment = 0.0 if mirrored else reach.line_load * reach.unit**2 * jnp.sum(force)
    compliance = settled.compliance * scene.load / (inputs.load * scene.push)
    return approach, Bands(
        approach, jnp.asarray(moment), compliance, settled.error, settled, reach, still
    )  # fmt: skip


# ------------------------------------------------------------------------------------------ bands


def _bands(
    plan: Plan, frequencies, scene: Scene, estimate: jax.Array, fine: Fineness
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The distance of every family's free boundary from the middle, (families,), 1 where it is loaded, and whether the
    last active set stood still."""
    rows, sides = (np.array(column) for column in zip(*plan.families, strict=True))
    edge = jnp.where(sides == RIGHT, scene.right, jnp.where(sides == LEFT, -scene.left, 0.0))
    nearest = jnp.maximum(jnp.where(sides == LAND, 0.0, edge), 0.0)
    count, kernel = fine.bands, scene.kernel
    table, mass = settling.spread(plan.even, kernel.products, rows), kernel.mass[rows][:, rows]
    same = (sides[:, None] == sides[None]) & (sides != LAND)[None]
    weight = kernel.weight[rows]
    places = jnp.asarray([FIRST[count]] + [LATER[count]] * (fine.centred - 1))
    kappa = frequencies.rule()[0]

    def boundary(load: jax.Array) -> jax.Array:
        """Where a contact cut off by the edge ends if it carries `load`."""
        whole = (sides == LAND) | ((edge < 0.0) & (load < edge * edge))
        cut = (edge + 2.0 * jnp.sqrt(edge * edge + 3.0 * load)) / 3.0
        return jnp.where(whole, jnp.sqrt(load), cut)

    def solve(k: int, state: tuple) -> tuple:
        load, active, _ = state
        t = nearest[:, None] + (boundary(load) - nearest)[:, None] * places[k][None]
        low = jnp.where((sides == LAND)[:, None], -t, jnp.maximum(-t, jnp.minimum(edge[:, None], t - 1e-9)))
        left = (sides == LEFT)[:, None]
        low, high = jnp.where(left, -t, low), jnp.where(left, -low, t)
        shape = waves.contact_on(low, high, left)
        by_order = shape[..., ::2] if plan.even else shape
        wave = waves.transforms(plan.orders, plan.even, low, high, kappa)
        at_low, at_high = shape[..., 0] - shape[..., 1] + shape[..., 2], jnp.sum(shape, axis=-1)
        strength = jnp.where(left, at_high, at_low) * settling.tail_of(0.5 * (high - low), frequencies.highest)
        gap = jnp.sum(by_order * scene.bend * waves.gap_integrals(plan.orders, low, high), axis=-1)
        gap = gap + shape[..., 0] * scene.gap[rows][:, None]
        step = jnp.diff(shape[..., 0], axis=1, prepend=0.0)

        def banded(whole: jax.Array) -> jax.Array:
            rise = jnp.diff(whole, axis=1, prepend=0.0)
            return rise / step.reshape(*step.shape, *(1,) * (rise.ndim - 2))

        wave, strength = banded(jnp.einsum("fbm,fbmz->fbz", by_order, wave)), banded(strength)
        matrix = settling.coupled(table, wave)
        tail = mass * same
        matrix = matrix + tail[:, None, :, None] * strength[:, :, None, None] * strength[None, None]
        n = step.size
        problem = Quadratic(
            matrix.reshape(n, n), (banded(gap) * weight[:, None]).ravel(), jnp.repeat(weight, count), scene.load
        )
        found, active, still = choice.solve(problem, active, ROUNDS)
        density = found.loads.reshape(step.shape) / step
        return _recentred(load, shape[..., 0], step, density), active, still

    first = (1.03**2 * jnp.clip(1.0 - scene.gap[rows] / estimate, 0.03, 1.0)).astype(float)
    begun = jnp.tile(jnp.arange(count) < 2, rows.size)
    load, active, still = jax.lax.fori_loop(0, fine.centred, solve, (first, begun, jnp.asarray(False)))
    return boundary(load), jnp.any(active.reshape(-1, count), axis=1).astype(float), still


def _recentred(load: jax.Array, ends: jax.Array, step: jax.Array, density: jax.Array) -> jax.Array:
    """The load that a contact of the free boundary in the last loaded band would carry alone, (families,)."""
    count = step.shape[1]
    k = jnp.arange(count)
    last = jnp.max(jnp.where(density > 0.0, k[None], -1), axis=1)

    def pick(table: jax.Array, at: jax.Array) -> jax.Array:
        return jnp.sum(jnp.where(k[None] == at[:, None], table, 0.0), axis=1)

    before = jnp.where(last > 0, pick(density, last - 1), 1.0)
    share = jnp.minimum(pick(density, last) / jnp.maximum(before, 1e-9), jnp.where(last > 0, 1.4, 1.0))
    new = jnp.where(last < 0, 0.5 * load, pick(ends, last - 1) + share * pick(step, last))
    return jnp.clip(new, 0.3 * load, 2.2 * load)
