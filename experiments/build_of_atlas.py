"""Solve the contacts of the package's atlas: `python -m experiments.build_of_atlas FOLDER`. Above an hour on two cores.

What was solved is kept in FOLDER, a file for every λ, so that a build that was broken off goes on. Then the atlas is
compared with contacts between its nodes, and written to FOLDER/atlas.npz; to ship it, copy that to src/difftrb/law.
With `narrow` behind FOLDER only what narrow spalls need is built, beside the package's atlas: a quarter of an hour.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from numpy.polynomial.chebyshev import chebfit, chebvander

from difftrb.contact import crown, solver, strip_reach, ways
from difftrb.contact.contact_solution import given
from difftrb.core import storage
from difftrb.core.geometry import LineContact, Real, Spall
from difftrb.core.numeric import chebyshev_nodes, chebyshev_roots, least_squares
from difftrb.law import (
    atlas,
    atlas_place,
    edge_ramp,
    edge_share,
    load_curve,
    narrow_shift,
    narrow_spall,
    ramp_fit,
    samples,
)
from difftrb.law.atlas import Atlas
from difftrb.law.base import load_over
from difftrb.law.samples import Case, Progress
from difftrb.law.table import TableLaw
from difftrb.report import console

LENGTH, MODULUS, DESIGN_LOAD = 10.0, 1.0e5, 5000.0
"""Of the contacts that are solved [mm], [MPa], [N]: any would do."""
NUMBERS = 1e-6, 3e-3
LOADS = 1e-2, 3.0
LIGHT, EDGE_LIGHT = 0.75, 0.5
"""Powers of the load with which a solve counts for its curve and for its ramp. Where far land begins to carry, at light
loads, both have a kink, which no polynomial follows; one through all solves alike sways for it at every load."""
RIDGE = 5e-4
"""Noise of a solve's share by the size of s's coefficients."""
LIGHTER = 1e-3
"""Load by the design load of the contact that tells a curve's exponent below `LOADS`, between `EXPONENTS`: where far
land begins to carry there, none does."""
EXPONENTS = 1.2, 2.5
CHECKED = 0.05, 2.5
"""Loads of healthy rollers at which the atlas is compared, by the design load."""
EDGE_LENGTHS = 0.15, 1.0
"""Variables of spalls' lengths between which ramps are solved; those of shorter ones are as there."""
CHECKS = 80
OVER_END, BOTH_EDGES = 3, 4
LIGHTEST = 0.01
"""Least load of a solve at an edge, by what the roller carries on a healthy raceway."""
BESIDE = 1.03
"""How far beyond its ends the ramp is solved to find the levels it joins, both on one and the same grid."""
WIDE = 1000.0
NARROW_RIDGE, NARROW_ROUNDS = 1e-2, 4
"""Of the least squares that tell where the one edge for both stands: noise of loads by the size of the coefficients,
and rounds."""
CUBIC = (narrow_shift.DEGREE + 1,) * 3
NARROWEST, WIDTHS = (0.01, 0.3), (0.05, 2.5)
"""Widths of every fifth of these and of the others, by the ramp's end."""


class Size(NamedTuple):
    """How many nodes the atlas has; at how many loads, lengths and levels more contacts are solved than it keeps; how
    many random ones with two edges, inside the roller and over its end; and how exact they are without, with one and
    with two rolling edges in reach."""

    numbers: int = 8
    loads: int = 12
    solved_loads: int = 23
    lengths: int = 13
    asides: int = 7
    edge_numbers: int = 5
    edge_lengths: int = 8
    solved_lengths: int = 9
    edge_asides: int = 5
    levels: int = 7
    solved_levels: int = 8
    places: int = 12
    narrow: tuple[int, int] = 8000, 800
    accuracy: float = 1e-5
    edge_accuracy: float = 3e-5
    narrow_accuracy: float = 1e-4


def contact_at(number: float) -> LineContact:
    """A contact with this λ."""
    return LineContact(number * MODULUS * LENGTH**3 / DESIGN_LOAD, LENGTH, MODULUS, DESIGN_LOAD)


def spall_at(number: float, length: float, aside: float, over_end: bool, width: float = WIDE) -> Spall:
    """The spall at a place of the atlas, the inverse of `atlas_place.place_of`; deeper than any roller sinks."""
    if over_end:
        taken = atlas_place.AT_END[0] + (atlas_place.AT_END[1] - atlas_place.AT_END[0]) * length
        own, offset = 2.0 * taken, 0.5  # half of it lies beyond the roller's end
    else:
        least = float(atlas_place.shortest(number))
        root = np.sqrt(least) + length * (np.sqrt(atlas_place.LONGEST + least) - np.sqrt(least))
        own = max(root**2 - least, 0.0)
        offset = (atlas_place.INNER - 0.5 * own) * np.sqrt(aside)
    return Spall(own * LENGTH, width, 1e6, axial_offset=offset * LENGTH)


def law_of(built: Atlas, contact: LineContact) -> TableLaw:
    """The law that reads this atlas, for any spall.

    Programs hold the numbers that they have read: ramps are solved when all levels are there, and read in what `build`
    returns.
    """
    return TableLaw(contact, 0.0, atlas=built)


class Found(NamedTuple):
    """A solved contact: approach [mm], half its width [mm], and how far from a spall's middle an edge would touch the
    roller [mm]."""

    approach: float
    half_width: float
    reach: float


def solved(contact: LineContact, cases: list[Case], accuracy: float, progress: Progress | None = None) -> list[Found]:
    """All of them, on all cores that this process may use; raises `SolveError` where none of the ways converges."""

    def one(case: Case) -> Found:
        assert case.spall is None or isinstance(case.spall, Spall)
        solution = None
        if case.spall is not None and case.distance != 0.0:  # so many that compiling pays
            inputs, mirrored, _ = given(contact, case.load, case.spall, case.distance, 0.0, "strips")
            beneath, fits, within = strip_reach.judged(inputs, mirrored)
            solution = (
                ways.by_strips(inputs, mirrored, max(int(beneath.edges), 1), accuracy) if fits and within else None
            )
        if solution is None or not bool(solution.converged):
            solution = solver.solve_contact(contact, case.load, case.spall, case.distance, accuracy)
        if not bool(solution.converged):
            solution = solver.solve_contact(contact, case.load, case.spall, case.distance, 1e-3, "cells").check()
        reach = samples.last_touch(contact, solution) if case.spall is not None and case.distance == 0.0 else 0.0
        return Found(float(solution.approach), 0.5 * float(solution.contact_width), reach)

    return samples.mapped(one, cases, accuracy, progress)


def _blank(size: Size) -> Atlas:
    """Nodes, and nothing at them."""
    lowest, highest = np.log(NUMBERS)
    extents = ramp_fit.EXTENT_DEGREE + 1
    places = (size.numbers, size.lengths, size.asides + 1)
    edges = (size.edge_numbers, size.edge_lengths, size.edge_asides + 1)
    nan = np.nan
    return Atlas(
        np.asarray(chebyshev_nodes(size.numbers, lowest, highest)),
        np.asarray(chebyshev_nodes(size.loads, *np.log(LOADS))),
        np.asarray(chebyshev_nodes(size.lengths, 0.0, 1.0)),
        np.asarray(chebyshev_nodes(size.asides, 0.0, 1.0)),
        np.full((size.numbers, size.loads), nan), np.full((size.numbers, extents), nan),
        np.full((*places, size.loads), nan), np.full((*places, extents), nan), np.full(places, ramp_fit.POINT),
        np.asarray(chebyshev_nodes(size.edge_numbers + 2, lowest, highest))[1:-1],  # beyond, shares are as there
        np.asarray(chebyshev_nodes(size.edge_lengths, *EDGE_LENGTHS)),
        np.asarray(chebyshev_nodes(size.edge_asides, 0.0, 1.0)),
        np.zeros((*edges, size.levels, edge_ramp.TERMS)), np.zeros((2, *CUBIC)), np.full(4, nan), np.asarray(nan),
    )  # fmt: skip


class Stand(NamedTuple):
    """A place of a spall among the nodes: indices by length and aside, and its variables, see `atlas_place.Place`."""

    i: int
    a: int
    length: float
    aside: float
    over_end: bool

    def spall(self, number: float) -> Spall:
        """What stands there in the contact with this λ."""
        return spall_at(number, self.length, self.aside, self.over_end)


def _stands(lengths: np.ndarray, asides: np.ndarray) -> list[Stand]:
    beside = [(k, float(aside), False) for k, aside in enumerate(asides)] + [(len(asides), 0.0, True)]
    return [Stand(i, a, float(x), aside, over) for i, x in enumerate(lengths) for a, aside, over in beside]


def _with_spalls(built: Atlas) -> list[Stand]:
    """All places of the levels but those of spalls of no length."""
    return [stand for stand in _stands(built.lengths, built.asides) if stand.i > 0 or stand.over_end]


def levels(size: Size, built: Atlas, k: int, progress: Progress | None = None) -> storage.Arrays:
    """Contacts without an edge in reach at the k-th λ."""
    number = float(np.exp(built.log_numbers[k]))
    contact, unit = contact_at(number), float(crown.scale(contact_at(number)))
    log_loads = np.asarray(chebyshev_nodes(size.solved_loads, *np.log(LOADS)))
    loads, across = np.exp(log_loads), np.sqrt(2.0 * float(contact.radius) * unit)
    places = _with_spalls(built)
    shapes = [stand.spall(number) for stand in places]
    cases = [Case(float(q) * DESIGN_LOAD, shape) for shape in (None, *shapes) for q in loads]
    nodes = solved(contact, cases, size.accuracy, progress)
    shape = (1 + len(shapes), loads.size)
    approach = np.array([node.approach for node in nodes]).reshape(shape) / unit
    half = np.array([node.half_width for node in nodes[: loads.size]]) / across
    reach = np.array([node.reach for node in nodes]).reshape(shape) / across
    weight = np.minimum(loads, 1.0) ** LIGHT
    kept = _nearest(log_loads, built.log_loads, np.log(approach), 1, weight)
    healthy, full = kept[0], np.zeros(built.full.shape[1:])
    sunk = np.zeros(built.sunk.shape[1:])
    full[0, :-1] = healthy
    for row, (stand, spall) in enumerate(zip(places, shapes, strict=True), start=1):
        i, a = stand.i, stand.a
        full[i, a] = kept[row]
        risen = float(ramp_fit.rise_over(contact, spall)) / unit + reach[row] ** 2
        sunk[i, a] = ramp_fit.extents(log_loads, ramp_fit.depth(approach[row], risen) / loads)
    x = built.lengths  # without a spall there is no middle to tell it
    sunk[0, :-1] = sunk[1, :-1] - (sunk[2, :-1] - sunk[1, :-1]) * (x[1] - x[0]) / (x[2] - x[1])
    return {"healthy": healthy, "half_width": ramp_fit.extents(log_loads, half), "full": full,
            "sunk": sunk}  # fmt: skip


def light(size: Size, built: Atlas, k: int, progress: Progress | None = None) -> storage.Arrays:
    """`Atlas.light` at the k-th λ: by exponents of these, curves go through contacts at the load `LIGHTER`, too."""
    number, load = float(np.exp(built.log_numbers[k])), LIGHTER * DESIGN_LOAD
    contact, places = contact_at(number), _with_spalls(built)
    spalls = [stand.spall(number) for stand in places]
    nodes = solved(contact, [Case(load, spall) for spall in spalls], size.accuracy, progress)
    law, found = law_of(built, contact), np.full(built.light.shape[1:], ramp_fit.POINT)
    for stand, spall, node in zip(places, spalls, nodes, strict=True):
        curve = law.beside(spall).full
        at = max(node.approach, float(curve.shift) + 1e-9 * node.approach)
        straight, bent = (  # log Q is linear in the bend
            float(np.log(load_curve.carried(dataclasses.replace(curve, bend=np.asarray(b)), at))) for b in (0.0, 1.0)
        )
        bend = (np.log(load) - straight) / (bent - straight)
        found[stand.i, stand.a] = np.clip(float(load_curve.exponent_below(curve)) + bend, *EXPONENTS)
    return {"light": found}


def _nearest(
    x: np.ndarray, nodes: np.ndarray, values: np.ndarray, axis: int, weight: np.ndarray | None = None
) -> np.ndarray:
    """At `nodes` the polynomials with as many coefficients that are nearest to `values` at `x` along an axis."""
    own, at = ((2.0 * np.asarray(each) - x[-1] - x[0]) / (x[-1] - x[0]) for each in (x, nodes))
    coefficients = _fitted_series(own, np.moveaxis(values, axis, 0), len(nodes), weight)
    return np.moveaxis(np.tensordot(chebvander(at, len(nodes) - 1), coefficients, 1), 0, axis)


def _fitted_series(x: np.ndarray, values: np.ndarray, count: int, weight: np.ndarray | None) -> np.ndarray:
    """So many coefficients of Chebyshev polynomials, nearest to `values` at `x` along the first axis."""
    found = chebfit(x, values.reshape(x.size, -1), count - 1, w=weight)
    return found.reshape(count, *values.shape[1:])


def edges(size: Size, built: Atlas, k: int, progress: Progress | None = None) -> storage.Arrays:
    """Contacts with an edge in reach at the k-th λ of edges: load [N], how far the edge stands beyond the roller's
    middle [mm] and approach [mm], shape (stands, solved levels, places + 2)."""
    contact = contact_at(float(np.exp(built.edge_numbers[k])))
    aims = [(spall, *_aims(law_of(built, contact), spall, size.solved_levels, size.places))
            for _, spall in _at_edges(size, built, k)]  # fmt: skip
    spalls, loads, places = [spall for spall, _, _ in aims], *(np.array([aim[n] for aim in aims]) for n in (1, 2))
    cases = []
    for spall, own, at in zip(spalls, loads, places, strict=True):
        width = 4.0 * float(at.max())
        wide = dataclasses.replace(spall, width=width)
        cases += [Case(float(q), wide, 0.5 * width - float(x)) for q, x in zip(own.ravel(), at.ravel(), strict=True)]
    nodes = solved(contact, cases, size.edge_accuracy, progress)
    approach = np.array([node.approach for node in nodes]).reshape(loads.shape)
    return {"load": loads, "place": places, "approach": approach}


def shares(size: Size, built: Atlas, k: int, solves: storage.Arrays) -> np.ndarray:
    """`Atlas.share` at the k-th λ, nearest to what `edges` solved: for every place aside all lengths, levels and places
    at once, for coefficients fitted one by one are known worse than what they say together."""
    law = law_of(built, contact_at(float(np.exp(built.edge_numbers[k]))))
    rows: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in range(size.edge_asides + 1)]
    at = solves["load"], solves["place"], solves["approach"]
    for (stand, spall), *own in zip(_at_edges(size, built, k), *at, strict=True):
        rows[stand.a].append(_rows(law, spall, stand.length, size, *own))
    found = []
    for own in rows:
        matrix, right = (np.concatenate(parts) for parts in zip(*own, strict=True))
        found.append(least_squares(matrix, right, RIDGE))
    coefficients = np.reshape(found, (len(rows), size.edge_lengths, size.levels, edge_ramp.TERMS))
    nodes = chebvander(_of_length(built.edge_lengths), size.edge_lengths - 1)
    return np.tensordot(nodes, coefficients, (1, 1))


def _of_length(length: np.ndarray) -> np.ndarray:
    """A length's variable, brought to −1…1."""
    return (2.0 * np.asarray(length) - EDGE_LENGTHS[0] - EDGE_LENGTHS[1]) / (EDGE_LENGTHS[1] - EDGE_LENGTHS[0])


def _rows(
    law: TableLaw, spall: Spall, length: float, size: Size, loads: np.ndarray, edges: np.ndarray, approaches: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What the shares of one spall's solves, (levels, places + 2), ask of the coefficients by length, level and u."""
    beside = edge_ramp.spread(law.beside(spall), 2)
    # the levels that edges join, as these solves have them and as the curves do
    first = load_curve.approach(beside.healthy, loads[:, :1]) / approaches[:, :1]
    last = load_curve.approach(beside.full, loads[:, -1:]) / approaches[:, -1:]
    way = (loads - loads[:, :1]) / (loads[:, -1:] - loads[:, :1])
    approaches = (approaches * (first * (1.0 - way) + last * way))[:, 1:-1]
    inside = dataclasses.replace(beside, edge=edges[:, 1:-1])
    terms, told = ramp_fit.asked(inside, approaches, loads[:, 1:-1])
    healthy = load_curve.carried(beside.healthy, approaches)
    by_length = chebvander(_of_length(np.full(told.shape, length)), size.edge_lengths - 1)
    by_level = chebvander(np.asarray(edge_ramp.level(beside, healthy)), size.levels - 1)
    weight = np.minimum(healthy / DESIGN_LOAD, 1.0) ** EDGE_LIGHT
    basis = np.einsum("lp,lpa,lpb,lpc->lpabc", weight, by_length, by_level, terms)
    return basis.reshape(told.size, -1), (weight * told).ravel()


def _at_edges(size: Size, built: Atlas, k: int) -> list[tuple[Stand, Spall]]:
    number = float(np.exp(built.edge_numbers[k]))
    return [(stand, stand.spall(number)) for stand in _stands(_solved_lengths(size), built.edge_asides)]


def _solved_lengths(size: Size) -> np.ndarray:
    return np.asarray(chebyshev_nodes(size.solved_lengths, *EDGE_LENGTHS))


@partial(jax.jit, static_argnums=(2, 3))
def _aims(law: TableLaw, spall: Spall, levels: int, places: int) -> tuple[jax.Array, jax.Array]:
    """Loads [N] and edges [mm] at which the ramp is solved, shape (levels, places + 2); the first and the last lie just
    beyond the ramp, where the roller is healthy and over the spall's middle."""
    beside = law.beside(spall)
    t = 1.0 - (0.5 * (1.0 + jnp.asarray(chebyshev_roots(places)))) ** 2
    top = jnp.log(law.load_range[1])

    def at(load: jax.Array) -> tuple[jax.Array, jax.Array]:
        healthy, full, low, high = edge_ramp.between(beside, load_curve.approach(beside.healthy, load))
        least = LIGHTEST * healthy
        last = jnp.maximum(full, least)
        _, end = edge_ramp.extent(beside, load_curve.approach(beside.full, last))
        loads = jnp.maximum(full + (healthy - full) * edge_share.usual(t), least)
        edge = jnp.concatenate([BESIDE * low[None], low + (high - low) * t, BESIDE * end[None]])
        return jnp.concatenate([healthy[None], loads, last[None]]), edge

    return jax.vmap(at)(jnp.exp(chebyshev_nodes(levels, top - np.log(edge_ramp.LOAD_SPAN), top)))


def kept(folder: Path, name: str, make: Callable[[Progress | None], storage.Arrays]) -> storage.Arrays:
    """What `make` returns, or returned before: it is kept in `folder`, which is for one build with one set of the
    numbers in this file."""
    path = folder / f"{name}.npz"
    found = storage.read(path)
    if found is None:
        with console.bar(name) as bar:
            found = make(bar)
        storage.write(path, found)
    return found


def build(folder: Path, size: Size) -> Atlas:
    """The atlas, from what is kept in `folder` and solves."""
    built = _blank(size)

    for k in range(size.numbers):
        for field, value in kept(folder, f"levels-{k}", partial(levels, size, built, k)).items():
            getattr(built, field)[k] = value
    # an atlas keeps what it has put together to be read: of all levels at once, and anew with what is found by them
    lights = [kept(folder, f"light-{k}", partial(light, size, built, k))["light"] for k in range(size.numbers)]
    built = dataclasses.replace(built, light=np.array(lights))
    middle = size.edge_numbers // 2
    for k in sorted(range(size.edge_numbers), key=lambda k: abs(k - middle)):
        solves = kept(folder, f"edges-{k}", partial(edges, size, built, k))
        built.share[k] = shares(size, built, k, solves)
    return with_narrow(built, folder, size)


# ------------------------------------------------------------------------------------ both edges of a spall in reach


def with_narrow(built: Atlas, folder: Path, size: Size) -> Atlas:
    """The atlas with its `shift`, from what is kept in `folder` and solves."""
    built = dataclasses.replace(built)  # another one to programs, which hold what it was before
    solves = [kept(folder, f"narrow-{int(end)}", partial(narrow, size, built, end)) for end in (False, True)]
    return dataclasses.replace(built, shift=np.array([shifts(built, own["narrow"]) for own in solves]))


def narrow(size: Size, built: Atlas, over_end: bool, progress: Progress | None = None) -> storage.Arrays:
    """Random contacts with both edges of a spall in reach, inside the roller or over its end: λ, spall's length, width
    and axial offset, its distance [mm], load [N] and approach [mm], shape (contacts, 7)."""
    rng, found, count = np.random.default_rng(29), [], size.narrow[over_end]
    for done in range(count):
        if progress is not None:
            progress(done, count)
        number = float(np.exp(rng.uniform(*np.log(NUMBERS))))
        contact, load = contact_at(number), DESIGN_LOAD * float(np.exp(rng.uniform(*np.log(CHECKED))))
        aside = float(rng.uniform()) if done % 2 and not over_end else 0.0
        spall = spall_at(number, rng.uniform(), aside, over_end)
        _, _, low, high = map(float, _at(law_of(built, contact), spall, jnp.asarray(load)))
        width = high * float(rng.uniform(*WIDTHS) if done % 5 else np.exp(rng.uniform(*np.log(NARROWEST))))
        distance = rng.uniform() * (0.5 * width - BESIDE * low)
        spall = dataclasses.replace(spall, width=width)
        inputs, mirrored, _ = given(contact, load, spall, distance, 0.0, "strips")
        _, fits, within = strip_reach.judged(inputs, mirrored)
        if fits and within:
            solution = ways.by_strips(jax.tree.map(jnp.asarray, inputs), False, 2, size.narrow_accuracy)
        elif over_end:  # strips want land behind an edge, cells do not
            solution = solver.solve_contact(contact, load, spall, distance, size.narrow_accuracy, "cells")
        else:
            continue
        if bool(solution.converged):
            sizes = float(spall.length), width, float(spall.axial_offset)
            found.append((number, *sizes, distance, load, float(solution.approach)))
    return {"narrow": np.array(found)}


def shifts(built: Atlas, solves: np.ndarray) -> np.ndarray:
    """`Atlas.shift` nearest to what `narrow` solved, every load by a healthy roller's."""
    found, by, at = np.zeros(CUBIC), np.zeros(len(solves)), tuple(narrow_shift.EXPONENTS.T)
    for _ in range(NARROW_ROUNDS):
        off, slope, terms = map(np.asarray, _off_by_shift(built, jnp.asarray(solves), jnp.asarray(by)))
        found[at] = least_squares(slope[:, None] * terms, slope * by - off, NARROW_RIDGE)
        by = terms @ found[at]
    return found


@partial(jax.jit, static_argnums=0)
def _off_by_shift(built: Atlas, solves: jax.Array, by: jax.Array) -> tuple[jax.Array, ...]:
    """By how much of a healthy roller's load the atlas is off where edges are shifted `by`, see `narrow_shift`; how
    that goes with the shift, both of shape (contacts,); and the terms of the cubic, shape (contacts, terms)."""

    def one(solve: jax.Array, by: jax.Array) -> tuple[jax.Array, ...]:
        value, length, width, aside, distance, load, approach = solve
        spall = Spall(length, width, 1e6, axial_offset=aside)
        law = law_of(built, contact_at(value))
        ramp, near = law.of_both_edges(law.beside(spall), spall), 0.5 * width - distance
        healthy, _, low, high = edge_ramp.between(ramp, approach)
        assert ramp.narrow is not None
        level, plane = edge_ramp.level(ramp, healthy), ramp.narrow._replace(shift=None)
        found = narrow_spall.equivalent_edge(near, plane, approach, low, high, level)

        def off(by: jax.Array) -> jax.Array:
            edge = narrow_shift.moved(near, found, width, low, high, by)
            return (edge_ramp.carried(dataclasses.replace(ramp, edge=edge, narrow=None), approach) - load) / healthy

        number, place, _ = law.place_among(spall)
        return *jax.jvp(off, (by,), (jnp.ones(()),)), narrow_shift.terms(number, place, level)

    return jax.vmap(one)(solves, by)


# ------------------------------------------------------------------------------------------------ how far off it is


class Check(NamedTuple):
    """A random contact: its λ, the case, and by how much of a healthy roller's load the atlas is off."""

    number: float
    case: Case
    error: float


def checks(built: Atlas, count: int, seed: int, region: int) -> list[Check]:
    """Random contacts between the nodes, of spalls in one region of `Atlas.errors`, half of them on ramps; or, in
    `BOTH_EDGES`, of narrow spalls in all of these in turn, the roller no farther from the middle than half its contact.
    """
    rng, found, narrow, regions = np.random.default_rng(seed), [], region == BOTH_EDGES, OVER_END + 1
    for done in range(count):
        region = done % regions if narrow else region
        number = float(np.exp(rng.uniform(*np.log(NUMBERS))))
        contact, load = contact_at(number), DESIGN_LOAD * float(np.exp(rng.uniform(*np.log(CHECKED))))
        law = law_of(built, contact)
        aside = ((min(region, 2) + rng.uniform()) / 3.0) ** 2
        spall = spall_at(number, rng.uniform(), 0.0 if region == OVER_END else aside, region == OVER_END)
        healthy, full, low, high = map(float, _at(law, spall, jnp.asarray(load)))
        t = rng.uniform() if narrow or done % 2 else 1.0
        distance = 0.0
        if narrow:
            spall = dataclasses.replace(spall, width=2.0 * high * rng.uniform(0.05, 1.0))
            distance, load = -low * t, healthy
        else:
            spall = dataclasses.replace(spall, width=4.0 * high)
            distance = 2.0 * high - (low + (high - low) * t)
            load = max(full + (healthy - full) * float(edge_share.usual(jnp.asarray(t))), 0.02 * healthy)
        approach = jnp.asarray(solved(contact, [Case(load, spall, distance)], 1e-4)[0].approach)
        own, whole = (float(_load(law, approach, *of)) for of in ((spall, distance), (None, 0.0)))
        found.append(Check(number, Case(load, spall, distance), (own - load) / whole))
    return found


@jax.jit
def _at(law: TableLaw, spall: Spall, load: jax.Array) -> tuple[jax.Array, ...]:
    """`edge_ramp.between` where a healthy roller carries `load` [N]."""
    beside = law.beside(spall)
    return edge_ramp.between(beside, load_curve.approach(beside.healthy, load))


@jax.jit
def _load(law: TableLaw, approach: jax.Array, spall: Spall | None, distance: Real) -> jax.Array:
    return load_over(law, approach, spall, distance)[0]


def main(arguments: list[str]) -> int:
    """Build, compare, write."""
    folder, alone = Path(arguments[0]), "narrow" in arguments[1:]
    built = with_narrow(atlas.shipped(), folder, Size()) if alone else build(folder, Size())
    off_by = []
    for region in range(BOTH_EDGES + 1):
        off = np.abs([check.error for check in checks(built, CHECKS, 0, region)])
        off_by.append(np.quantile(off, 0.9))
        name = ("inner third", "middle third", "outer third", "over the end", "narrow")[region]
        print(f"{name}: median {np.median(off):.1e}, nine in ten {off_by[-1]:.1e}, worst {off.max():.1e}")
    built = dataclasses.replace(built, errors=np.array(off_by[:4]), narrow_error=np.asarray(off_by[4]))
    storage.write(folder / atlas.FILE, {name: np.asarray(value) for name, value in dataclasses.asdict(built).items()})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
