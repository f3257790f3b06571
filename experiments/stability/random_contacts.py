"""Random contacts, and contacts over load and length, by cells: contact conditions checked from the forces alone."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import difftrb as trb
from difftrb.contact import halfspace, strip_reach
from difftrb.contact.contact_solution import Inputs
from difftrb.core import status
from difftrb.law import base
from experiments.paper import common
from experiments.stability.hazards import CONTACT, LENGTH, NUMBERS, ContactHazard

KKT = 1e-9
"""Violation of the contact conditions, relative to the approach, below which a contact is solved."""
LOADS, LENGTHS = np.geomspace(1e-3, 1e7, 31), np.concatenate([np.linspace(0.0, 0.98, 21), [0.995, 1.0]]) * LENGTH
"""Of the map [N, mm]."""


def solved(numbers: jax.Array) -> tuple[jax.Array, dict[str, jax.Array]]:
    """The approach [mm], and how well it was found; `numbers` as `NUMBERS`."""
    a = dict(zip(NUMBERS, numbers, strict=True))
    contact = trb.LineContact(a["radius"], a["roller_length"], a["modulus"], a["design_load"])
    spall = trb.Spall(a["length"], a["width"], a["depth"], 0.0, a["axial_offset"])
    s = trb.solve_contact(contact, a["load"], spall, a["offset"], 1e-2, "cells")
    matrix = halfspace.influence(s.cells, jnp.asarray(contact.modulus))
    apart = matrix.displacement(s.force) + s.gap - s.approach
    violated = jnp.max(jnp.where(s.force > 0.0, jnp.abs(apart), jnp.maximum(-apart, 0.0))) / s.approach
    balance = jnp.abs(jnp.sum(s.force) / a["load"] - 1.0)
    pull = jnp.maximum(-jnp.min(s.force), 0.0) / a["load"]
    return s.approach, {
        "status": s.status_code,
        "iterations": s.iterations,
        "kkt": jnp.maximum(violated, balance + pull),
    }


_batch: Callable[[jax.Array], Any] = jax.jit(partial(jax.lax.map, jax.value_and_grad(solved, has_aux=True)))
CHUNK = 50


def batch(
    numbers: np.ndarray, progress: Callable[[int, int], None] | None = None
) -> tuple[np.ndarray, dict, np.ndarray]:
    """Approaches, what `solved` says, and derivatives, of contacts of shape (count, numbers), by one program."""
    parts = []
    for first in range(0, len(numbers), CHUNK):
        rows = numbers[first : first + CHUNK]
        count = len(rows)
        padded = np.concatenate([rows, np.repeat(rows[-1:], CHUNK - count, axis=0)])
        whole = jax.tree.map(np.asarray, _batch(jnp.asarray(padded)))
        parts.append(jax.tree.map(lambda v, count=count: v[:count], whole))
        if progress is not None:
            progress(first + len(rows), len(numbers))
    (approach, said), slopes = jax.tree.map(lambda *v: np.concatenate(v), *parts)
    return approach, said, slopes


def random_numbers(count: int, seed: int) -> np.ndarray:
    """Everything over as many decades as a file allows, or nearly."""
    rng = np.random.default_rng(seed)
    width = 10 ** rng.uniform(-2, 3, count)
    return np.stack([
        10 ** rng.uniform(-3, 5, count), LENGTH * rng.choice([0.0, 1.0, 2.0, rng.random()], count)
        * np.where(rng.random(count) < 0.8, rng.random(count), 1.0), width, 10 ** rng.uniform(-6, 1, count),
        rng.uniform(-1, 1, count) * (0.5 * width + 0.2),
        np.where(rng.random(count) < 0.5, 0.0, rng.uniform(-10, 10, count)),
        10 ** rng.uniform(-0.5, 2.5, count), np.full(count, LENGTH), 10 ** rng.uniform(3.5, 6, count),
        np.where(rng.random(count) < 0.2, 0.0, 10 ** rng.uniform(0, 6, count)),
    ], axis=1)  # fmt: skip


def run(count: int, seed: int = 0, progress: Callable[[int, int], None] | None = None) -> dict[str, Any]:
    """Counts over random contacts."""
    approach, said, slopes = batch(random_numbers(count, seed), progress)
    good = said["status"] == status.CONVERGED
    codes, counts = np.unique(said["status"][~good], return_counts=True)
    return {
        "contacts": count, "converged": int(good.sum()),
        "statuses": {status.describe(int(code)): int(n) for code, n in zip(codes, counts, strict=True)},
        "nan_values": int(np.isnan(approach[good]).sum()),
        "nan_gradients": int((~np.isfinite(slopes[good]).all(axis=1)).sum()),
        "unflagged": int((good & ~(said["kkt"] <= KKT)).sum()),
        "kkt": float(said["kkt"][good].max()), "iterations": int(said["iterations"][good].max()),
    }  # fmt: skip


def over_load_and_length(
    out: Path, progress: Callable[[int, int], None] | None = None, every: int = 1
) -> dict[str, Any]:
    """The map and its figure: iterations and violation over load × length, 7 mm wide and 0.2 mm deep, centred."""
    loads, lengths = LOADS[::every], np.unique(np.append(LENGTHS[::every], LENGTH))
    numbers = np.stack([ContactHazard("", load=q, length=l).numbers for l in lengths for q in loads])
    approach, said, _ = batch(numbers, progress)
    shape = lengths.size, loads.size
    approach, kkt, codes = (v.reshape(shape) for v in (approach, said["kkt"], said["status"]))
    iterations = said["iterations"].reshape(shape)
    suited = np.asarray(jax.jit(jax.vmap(_suited))(jnp.asarray(numbers[:, :2]))).reshape(shape)
    common.set_up()
    figure, panels = common.axes(1, 2, height=3.6, width=8.2, sharey=True)
    shown = (
        (iterations, "applications of the influence matrix"),
        (np.log10(np.maximum(kkt, 1e-17)), "log₁₀ of the violation, by the approach"),
    )
    for ax, (values, label) in zip(panels, shown, strict=True):
        mesh = ax.pcolormesh(loads, lengths, np.where(codes == status.CONVERGED, values, np.nan), cmap="viridis",
                             shading="nearest", rasterized=True)  # fmt: skip
        figure.colorbar(mesh, ax=ax, label=label)
        ax.grid(False)
        ax.set_xscale("log")
        ax.set_xlabel("roller load [N]")
        limits = (
            (approach - 0.2, "-", "#FFFFFF", "reaches the bottom"),
            (suited - 0.5, "--", "#EE6677", "strips describe it, within"),
        )  # fmt: skip
        for field, style, colour, name in limits:
            ax.contour(loads, lengths, field, levels=[0.0], colors=[colour], linestyles=style, linewidths=1.3)
            ax.plot([], [], style, color="#999999" if colour == "#FFFFFF" else colour, label=name)
        ax.axhline(base.LENGTH_SHARE * LENGTH, color="black", ls=":", lw=1.2, label="longest of laws")
        ax.axvline(6500.0, color="black", ls="-.", lw=0.9, label="crown's design load")
    panels[0].set_ylabel("spall's length [mm]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    common.save(figure, out, "map")
    return {
        "contacts": int(codes.size), "converged": int((codes == status.CONVERGED).sum()),
        "iterations": [int(iterations.min()), int(np.median(iterations)), int(iterations.max())],
        "kkt": float(kkt.max()),
    }  # fmt: skip


def _suited(numbers: jax.Array) -> jax.Array:
    load, length = numbers
    *_, fits, within = strip_reach.judged(Inputs(CONTACT, load, trb.Spall(length, 7.0), jnp.zeros(())), True)
    return (fits & within).astype(float)
