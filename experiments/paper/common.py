"""What the scripts share: inputs, laws, figures, and how a result becomes numbers and a part of the page."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from cycler import cycler
from matplotlib.figure import Figure

import difftrb as trb
from difftrb.core import status
from difftrb.core.geometry import Raceway, Real
from difftrb.core.jax_config import set_up_jax
from difftrb.law import table
from difftrb.law.base import Law
from difftrb.report import figure_style, tables
from difftrb.ring import effects
from difftrb.scene.cage_phases import phases as phases_of
from difftrb.scene.scene import PitchMean
from experiments.paper import clipped

LENGTHS = (0.0, 2.0, 4.0, 6.0, 8.0)
"""Spall lengths of Table 2 [mm]."""
DEPTH = 0.2
HEAVY, LIGHT = trb.Load(9000.0, 4500.0), trb.Load(120.0, 60.0)
"""Loads of Fig. 15 b and a [N]."""
COLOURS = (
    "#4477AA",
    "#EE6677",
    "#228833",
    "#CCBB44",
    "#66CCEE",
    "#AA3377",
    "#BBBBBB",
)  # Tol, bright: colour-blind safe
PAPER: dict[str, Any] = {"marker": "x", "linestyle": "none", "color": "black", "ms": 6, "mew": 1.4, "zorder": 5}
"""How the paper's printed points are drawn."""
HOLDS, ONLY_IF, FAILS = "holds", "holds only if", "does not hold"

Progress = Callable[[int, int], None]
"""Told how many of how many steps are done."""


@dataclasses.dataclass(frozen=True)
class Claim:
    """A sentence of the paper, what became of it (`HOLDS`, …), and our number or condition."""

    sentence: str
    verdict: str
    ours: str


@dataclasses.dataclass(frozen=True)
class Printed:
    """Numbers that the paper prints, ours by its own way (`remade`) and on the whole half-space; words with units."""

    what: str
    paper: str
    remade: str
    half_space: str


@dataclasses.dataclass(frozen=True)
class Result:
    """What a script found.

    Attributes:
      title: of its section of the page.
      page: the section, Markdown; pictures by name alone (`picture`).
      numbers: everything measured, for the JSON file.
      claims: sentences of the paper that it judges.
      printed: numbers of the paper beside ours.
      beyond: whether the paper has nothing of it.
    """

    title: str
    page: str
    numbers: dict[str, Any]
    claims: tuple[Claim, ...] = ()
    printed: tuple[Printed, ...] = ()
    beyond: bool = False


def set_up() -> None:
    """Keep compiled programs in the user's cache folder, and figures' letters legible at the width of a column."""
    set_up_jax(cache=True)
    plt.rcParams.update({
        "font.size": 9, "axes.titlesize": 9, "legend.fontsize": 8, "axes.prop_cycle": cycler(color=COLOURS),
        "legend.frameon": False, "svg.hashsalt": "difftrb", "axes.grid": True, "grid.alpha": 0.3, "grid.linewidth": 0.5,
    })  # fmt: skip


# ---------------------------------------------------------------------------------------------------- writing


def axes(
    rows: int = 1, columns: int = 1, height: float = 2.9, width: float = 7.2, **options: Any
) -> tuple[Figure, Any]:
    """A figure as wide as a page with axes in it."""
    return plt.subplots(rows, columns, figsize=(width, height * rows), layout="constrained", **options)


def save(figure: Figure, out: Path, name: str) -> str:
    """Write a figure as PNG and SVG; its name."""
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / f"{name}.png", dpi=140)
    figure.savefig(out / f"{name}.svg", metadata={"Date": None})
    plt.close(figure)
    return name


def picture(name: str, text: str) -> str:
    """A picture of the output folder in Markdown."""
    return f"![{text}]({{folder}}/{name}.png)"


def grid(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def page(*parts: str) -> str:
    """Paragraphs, tables and pictures, one after the other."""
    return "\n\n".join(parts)


def write(result: Result, out: Path, name: str) -> None:
    """The numbers of a result, and its part of the page, as `name`.json."""
    out.mkdir(parents=True, exist_ok=True)
    content = {
        "title": result.title, "numbers": _rounded(tables.plain(result.numbers)),
        "claims": [dataclasses.asdict(claim) for claim in result.claims],
        "printed": [dataclasses.asdict(row) for row in result.printed], "beyond": result.beyond, "page": result.page,
    }  # fmt: skip
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False, default=_number)
    (out / f"{name}.json").write_text(text + "\n", encoding="utf-8")


def _rounded(value: Any) -> Any:
    """Nine digits, so that a second run writes the same file."""
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_rounded(entry) for entry in value]
    return float(f"{value:.9g}") if isinstance(value, float) else value


def _number(value: Any) -> Any:
    return value.item()


def listed(values: Any, digits: int) -> str:
    """Numbers one after the other."""
    return ", ".join(f"{float(value):.{digits}f}" for value in values)


def percent(value: Any, digits: int = 2) -> str:
    """A share as per cent, with its sign."""
    return f"{100.0 * float(value):+.{digits}f} %"


# ---------------------------------------------------------------------------------------------------- inputs


@functools.cache
def bearing() -> trb.TaperedBearing:
    """Table 1."""
    return trb.bearing("32008J")


def contact(raceway: Raceway = "outer") -> trb.LineContact:
    """The roller on its raceway, with the crown that Table 2 asks for."""
    return trb.LineContact.of(bearing(), raceway, design_load=6500.0)


@functools.partial(jax.jit, static_argnames=("accuracy",))
def _over_spalls(
    contact: trb.LineContact, lengths: jax.Array, loads: jax.Array, accuracy: float
) -> tuple[jax.Array, jax.Array]:
    def one(case: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        s = trb.solve_contact(contact, case[1], trb.Spall(case[0], 100.0), 0.0, accuracy, "cells")
        return s.approach, s.status_code

    return jax.lax.map(one, (lengths, loads))


@functools.partial(jax.jit, static_argnames=("accuracy",))
def _healthy(contact: trb.LineContact, loads: jax.Array, accuracy: float) -> tuple[jax.Array, jax.Array]:
    def one(load: jax.Array) -> tuple[jax.Array, jax.Array]:
        s = trb.solve_contact(contact, load, None, 0.0, accuracy, "cells")
        return s.approach, s.status_code

    return jax.lax.map(one, loads)


def half_space(
    contact: trb.LineContact, loads: Sequence[float] | np.ndarray, lengths: Sequence[float] = LENGTHS,
    accuracy: float = 1e-3,
) -> np.ndarray:  # fmt: skip
    """Approach [mm] on the whole half-space over the middle of wide spalls (0: healthy): shape (lengths, loads)."""
    contact = jax.tree.map(jnp.asarray, contact)
    cases = np.stack([v.ravel() for v in np.meshgrid(lengths, loads, indexing="ij")], axis=1)
    approach, code = np.zeros(len(cases)), np.zeros(len(cases), int)
    for kind, solve in (
        (cases[:, 0] == 0.0, lambda part: _healthy(contact, part[:, 1], accuracy)),
        (cases[:, 0] > 0.0, lambda part: _over_spalls(contact, part[:, 0], part[:, 1], accuracy)),
    ):
        if kind.any():
            approach[kind], code[kind] = in_batches(solve, cases[kind], 15)
    if code.any():
        raise trb.SolveError(f"a contact of the half-space was not solved: {status.describe(int(code.max()))}")
    return approach.reshape(len(lengths), len(loads))


def in_batches(function: Callable[[jax.Array], Any], states: np.ndarray, size: int) -> Any:
    """`function` of `states`, so many at a time: batches of any number are made of one program, for compiling takes
    longer than solving."""
    filled = np.concatenate([states, np.repeat(states[-1:], -len(states) % size, axis=0)])
    parts = [function(jnp.asarray(filled[k : k + size])) for k in range(0, len(filled), size)]
    return jax.tree.map(lambda *values: np.concatenate([np.asarray(v) for v in values])[: len(states)], *parts)


# ---------------------------------------------------------------------------------------------------- laws


def as_law(fit: clipped.Fit, loads: np.ndarray, lengths: Sequence[float] = LENGTHS) -> trb.PowerLaw:
    """A power law with these pairs (K, n)."""
    return trb.PowerLaw(
        jnp.asarray(lengths), jnp.log(jnp.asarray(fit.stiffness)), jnp.asarray(fit.exponent),
        (float(loads.min()), float(loads.max())), float(fit.error.max()), 0.0, "power",
    )  # fmt: skip


@functools.cache
def clipped_law() -> trb.PowerLaw:
    """Power laws of the clipped contact: what Table 2 is, made here."""
    found = clipped.approaches(
        contact(), jnp.asarray(clipped.LOADS), jnp.asarray(LENGTHS), clipped.NARROWED, clipped.PAPER_GRID
    )
    return as_law(clipped.power_fit(clipped.LOADS, np.asarray(found)), clipped.LOADS)


@functools.cache
def whole_law() -> trb.PowerLaw:
    """Power laws of the whole half-space, fitted to the same loads as Table 2."""
    return as_law(clipped.power_fit(clipped.LOADS, half_space(contact(), clipped.LOADS)), clipped.LOADS)


@functools.cache
def table_law(raceway: Raceway = "outer") -> table.TableLaw:
    """The smooth law, which knows no power."""
    return table.table_law(contact(raceway))


@functools.cache
def in_series() -> trb.Scene:
    """Both raceways elastic, by tables of half-space contacts, with a spall on either and one on roller 0."""
    surfaces = "outer", "inner", "roller"
    spalls = tuple(trb.Spall(0.0, 1.0, DEPTH, surface=surface) for surface in surfaces)
    outer, inner = (table_law(raceway) for raceway in ("outer", "inner"))
    acting = (effects.SeriesRaceways(None, inner),)
    one = trb.Scene(bearing(), HEAVY, spalls, outer, phase=0.0, effects=acting)
    return jax.tree.map(jnp.asarray, one)


@jax.jit
def _in_series(one: trb.Scene, states: jax.Array) -> jax.Array:
    def at(state: jax.Array) -> jax.Array:
        spalls = tuple(
            dataclasses.replace(spall, length=length, width=width, angle=angle)
            for spall, length, width, angle in zip(one.spalls, *state[:9].reshape(3, 3), strict=True)
        )
        return both_stiffnesses(dataclasses.replace(one, spalls=spalls, phase=state[9]))

    return jax.lax.map(at, states)


def losses_in_series(lengths: Any, widths: Any, angles: Any, phases: Any = 0.0) -> np.ndarray:
    """Radial and axial loss of tangent, then of secant stiffness [%], both raceways elastic, shape (n, 4).

    Args:
      lengths, widths, angles: of the spalls on outer ring, inner ring and roller 0 [mm, rad], each of a shape that
        broadcasts to (n, 3); length 0 is none.
      phases: of the cage [rad], shape () or (n,).
    """
    sizes = [np.asarray(v, float) for v in (lengths, widths, angles)]
    n, _ = np.broadcast_shapes((1, 3), (np.size(phases), 1), *(v.shape for v in sizes))
    states = np.empty((n, 10))
    for k, size in enumerate(sizes):
        states[:, 3 * k : 3 * k + 3] = size
    states[:, 9] = phases
    return lost(functools.partial(_in_series, in_series()), states, slice(0, 3), 64)


def four_laws() -> dict[str, Law]:
    """Names for figures, and the laws: as printed, clipped like the paper's, and two of the whole half-space."""
    return {
        "Table 2 as printed": trb.liu2018(), "ours, clipped domain": clipped_law(),
        "ours, half-space, power law": whole_law(), "ours, half-space, table": table_law(),
    }  # fmt: skip


def scene(
    law: Law, length: Real, width: Real, load: trb.Load = HEAVY, definition: str = "secant", phase: Any = 0.0
) -> trb.Scene:
    """A roller centred in a spall at the load line, unless `phase` says else."""
    spall = trb.Spall(length, width, DEPTH)
    return trb.Scene(bearing(), load, (spall,), law, definition=definition, phase=phase)  # pyright: ignore[reportArgumentType]


@jax.jit
def losses(one: trb.Scene) -> jax.Array:
    """Radial and axial loss of stiffness by the spalls [%], shape (2,)."""
    spalled, sound = trb.solve(one).stiffness, trb.solve(trb.healthy(one)).stiffness
    share = 1.0 - jnp.diagonal(spalled) / jnp.diagonal(sound)
    return 100.0 * share[jnp.array([0, 2])]


def both_stiffnesses(one: trb.Scene) -> jax.Array:
    """Radial and axial tangent stiffness, then secant [N/mm], shape (4,), of a scene that names "tangent"."""
    load, ends = jnp.stack([jnp.asarray(one.load.radial), jnp.asarray(one.load.axial)]), jnp.array([0, 2])

    def at(phase: Any) -> jax.Array:
        r = trb.solve(dataclasses.replace(one, phase=phase))
        return jnp.concatenate([jnp.diagonal(r.stiffness)[ends], load / r.displacement[ends]])

    if not isinstance(one.phase, PitchMean):
        return at(one.phase)
    phases, weights = phases_of(trb.prepare(one))
    return weights @ jax.vmap(at)(phases)


@jax.jit
def _one_spall(one: trb.Scene, states: jax.Array) -> jax.Array:
    def at(state: jax.Array) -> jax.Array:
        spall = dataclasses.replace(one.spalls[0], length=state[0], width=state[1], angle=state[2])
        here = dataclasses.replace(one, spalls=(spall,))
        return both_stiffnesses(here if isinstance(one.phase, PitchMean) else dataclasses.replace(here, phase=state[3]))

    return jax.lax.map(at, states)


def lost(stiffnesses: Callable[[jax.Array], jax.Array], states: np.ndarray, lengths: slice, size: int) -> np.ndarray:
    """Losses [%] of `stiffnesses` of `states` against those of the same states with `lengths` 0, which is healthy: one
    program for both, so many states at a time."""
    sound = states.copy()
    sound[:, lengths] = 0.0
    spalled, whole = np.split(in_batches(stiffnesses, np.concatenate([states, sound]), size), 2)
    return 100.0 * (1.0 - spalled / whole)


def losses_over(
    law: Law, lengths: Any, widths: Any, load: trb.Load = HEAVY, definition: str = "secant", phase: Any = 0.0,
    angle: Any = 0.0,
) -> np.ndarray:  # fmt: skip
    """Radial and axial loss [%] by spalls of these lengths, widths [mm] and angles [rad] at these phases [rad]
    (broadcast, shape (n,)), or with phase "mean": shape (n, 2)."""
    if isinstance(law, trb.PowerLaw):
        law = dataclasses.replace(law, name="power")  # one program for all power laws
    mean = isinstance(phase, str)
    of = lengths, widths, angle, 0.0 if mean else phase
    states = np.stack(np.broadcast_arrays(*(np.asarray(v, float) for v in of)), axis=-1)
    one = scene(law, 1.0, 1.0, load, "tangent", "mean" if mean else 0.0)
    one = jax.tree.map(jnp.asarray, one)  # numbers as arrays: one program for all of them
    tangent, secant = np.split(lost(functools.partial(_one_spall, one), states, slice(0, 1), 8), 2, axis=1)
    return tangent if definition == "tangent" else secant


def numbers(law: Law) -> dict[str, list[float]]:
    """K and n of a power law, nothing of another."""
    if not isinstance(law, trb.PowerLaw):
        return {}
    return {"K": np.exp(np.asarray(law.log_stiffness)).tolist(), "n": np.asarray(law.exponent).tolist()}


HUES = (figure_style.HEALTHY, figure_style.SPALLED)
