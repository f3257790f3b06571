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

import jax.numpy as jnp  # noqa: E402
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from cycler import cycler  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

import difftrb as trb  # noqa: E402
from difftrb import plot, report, status, table  # noqa: E402
from difftrb.environment import set_up_jax  # noqa: E402
from difftrb.geometry import Raceway, Real  # noqa: E402
from difftrb.law import Law  # noqa: E402
from experiments.paper import clipped  # noqa: E402

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
class Result:
    """What a script found.

    Attributes:
      title: of its section of the page.
      page: the section, Markdown; pictures by name alone (`picture`).
      numbers: everything measured, for the JSON file.
      claims: sentences of the paper that it judges.
    """

    title: str
    page: str
    numbers: dict[str, Any]
    claims: tuple[Claim, ...] = ()


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
        "title": result.title, "numbers": _rounded(report.plain(result.numbers)),
        "claims": [dataclasses.asdict(claim) for claim in result.claims], "page": result.page,
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
def _half_space(
    contact: trb.LineContact, loads: jax.Array, lengths: jax.Array, accuracy: float
) -> tuple[jax.Array, jax.Array]:
    def one(case: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        length, load = case
        s = trb.solve_contact(contact, load, trb.Spall(length, 100.0), 0.0, accuracy, "cells")
        return s.approach, s.status_code

    cases = jnp.meshgrid(lengths, loads, indexing="ij")
    found, codes = jax.lax.map(one, (cases[0].ravel(), cases[1].ravel()))
    sound = jax.lax.map(lambda q: trb.solve_contact(contact, q, None, 0.0, accuracy, "cells").approach, loads)
    found = jnp.where(lengths[:, None] > 0.0, found.reshape(lengths.size, loads.size), sound[None])
    return found, jnp.max(jnp.where(cases[0].ravel() > 0.0, codes, 0))


def half_space(
    contact: trb.LineContact, loads: Real | np.ndarray, lengths: Sequence[float] = LENGTHS, accuracy: float = 1e-3
) -> np.ndarray:
    """Approach [mm] on the whole half-space over the middle of wide spalls (0: healthy): shape (lengths, loads)."""
    found, code = _half_space(contact, jnp.asarray(loads, float), jnp.asarray(lengths, float), accuracy)
    if int(code):
        raise trb.SolveError(f"a contact of the half-space was not solved: {status.describe(int(code))}")
    return np.asarray(found)


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
def table_law(depth: float = DEPTH) -> table.TableLaw:
    """The smooth law, which knows no power, for rollers of 6.5…6500 N: from the cache, or built in about 40 s."""
    return table.table_law(contact(), 4900.0, (trb.Spall(4.0, 7.0, depth),), 1e-3)


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


BATCH = 8
"""Scenes of one program: batches of any size are made of these, for compiling takes longer than solving."""


@jax.jit
def _losses_over(one: trb.Scene, sizes: jax.Array) -> jax.Array:
    def at(size: jax.Array) -> jax.Array:
        spall = dataclasses.replace(one.spalls[0], length=size[0], width=size[1])
        return losses(dataclasses.replace(one, spalls=(spall,)))

    return jax.lax.map(at, sizes)


def losses_over(law: Law, lengths: Any, widths: Any, **options: Any) -> np.ndarray:
    """`losses` of spalls of these lengths and widths (broadcast, shape (n,)): shape (n, 2). `options`: of `scene`."""
    lengths, widths = np.broadcast_arrays(np.asarray(lengths, float), np.asarray(widths, float))
    sizes = np.stack([lengths, widths], axis=1)
    filled = np.concatenate([sizes, np.repeat(sizes[-1:], -len(sizes) % BATCH, axis=0)]).reshape(-1, BATCH, 2)
    one = jax.tree.map(jnp.asarray, scene(law, 1.0, 1.0, **options))  # numbers as arrays: one program for all of them
    return np.concatenate([_losses_over(one, jnp.asarray(batch)) for batch in filled])[: len(sizes)]


def numbers(law: Law) -> dict[str, list[float]]:
    """K and n of a power law, nothing of another."""
    if not isinstance(law, trb.PowerLaw):
        return {}
    return {"K": np.exp(np.asarray(law.log_stiffness)).tolist(), "n": np.asarray(law.exponent).tolist()}


HUES = (plot.HEALTHY, plot.SPALLED)
