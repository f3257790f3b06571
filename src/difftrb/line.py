"""A roller as a line load: one unknown per panel along it, Hertz's half ellipse across. The cheapest rung.

Across a panel of line load q the pressure is (2q/(πb))√(1−x²/b²). On the centre line it displaces the surface by
q/(πE') [F((y₂−y)/b) − F((y₁−y)/b)], F(σ) = ∫ (2/π)√(1−t²) asinh(σ/|t|) dt over −1…1. Half-widths b follow Hertz,
b² = 4qR/(πE'), but not the line load's singular rise beside a spall's end: there b is that of the load `AWAY` inside.

What the half ellipses miss beside that end acts far away as if the land were longer by `EDGE` half-widths: one number
for all contacts, since a half-infinite line contact that a sharp edge cuts off has no other length.
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np

from difftrb import gap as gaps
from difftrb import implicit, rows, status
from difftrb.domain import clear_of_spall, edges_along, reach_of_strips
from difftrb.geometry import LineContact, Real, Spall, as_floats
from difftrb.given import is_sound, is_symmetric

EDGE = 0.062  # python experiments/edge_constant.py: mean of its last row, whose lands differ by 0.004
AWAY = 3.0  # half-widths from a spall's end to the middle of where its load is taken
FADE = 1.0  # half-widths over which half-widths beside a spall's end go over to the local load's
TOLERANCE = 1e-6  # of the last step; Newton leaves its square
PASSES = 40
DEGREE = 4
LEAST_LAND = 20.0  # loaded length in half-widths: below, it is no line contact
LARGEST_LOAD = 1.5  # load of a roller as loaded as its land, by the design load: beyond, roller ends act as edges


@lru_cache
def _coefficients() -> tuple[np.ndarray, np.ndarray]:
    """A and B in F(σ) = asinh σ + √m (A(m) − B(m) ln m), m = σ²/(1+σ²): polynomials, by least squares."""
    u, w = np.polynomial.legendre.leggauss(200)
    u, w = 0.5 * (u + 1.0), 0.5 * w
    t = np.sin(0.5 * np.pi * u**4)  # t = sin φ takes the root away, φ ~ u⁴ the logarithm
    weight = w * 2.0 * u**3 * np.pi * np.cos(0.5 * np.pi * u**4) ** 2 * 4.0 / np.pi
    m = np.sin(0.5 * np.pi * (np.arange(400) + 0.5) / 400.0) ** 4
    sigma = np.sqrt(m / (1.0 - m))
    exact = np.arcsinh(sigma[:, None] / t) @ weight
    powers = m[:, None] ** np.arange(DEGREE)
    basis = np.sqrt(m)[:, None] * np.concatenate([powers, -np.log(m)[:, None] * powers], axis=1)
    found = np.linalg.lstsq(basis, exact - np.arcsinh(sigma), rcond=None)[0]
    return found[:DEGREE], found[DEGREE:]


def ellipse_integral(sigma: jax.Array) -> jax.Array:
    """F(σ), odd; within 1e-7."""
    a, b = _coefficients()
    size = jnp.maximum(jnp.abs(sigma), 1e-12)
    square = size * size
    m = square / (1.0 + square)
    first, second = jnp.full_like(m, a[-1]), jnp.full_like(m, b[-1])
    for p, q in zip(a[-2::-1], b[-2::-1], strict=True):
        first, second = first * m + float(p), second * m + float(q)
    root = jnp.sqrt(1.0 + square)
    return jnp.sign(sigma) * (jnp.log(size + root) + size / root * (first - second * jnp.log(m)))


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["approach", "line_load", "start", "end", "residual", "iterations", "status_code"],
    meta_fields=[],
)
@dataclasses.dataclass(frozen=True)
class LineSolution(status.Judged):
    """A contact solved as a line load.

    Attributes:
      approach: δ of the two bodies, contact alone [mm].
      line_load: q of every panel [N/mm], shape (panels,). start, end: where panels begin and end [mm]; if the contact
        is symmetric those of the half y ≥ 0.
      residual: last change of a line load relative to their mean. iterations: of Newton's method.
      status_code: see `difftrb.status`; `status` is its sentence.
    """

    approach: jax.Array
    line_load: jax.Array
    start: jax.Array
    end: jax.Array
    residual: jax.Array
    iterations: jax.Array
    status_code: jax.Array


def line_contact(
    contact: LineContact, load: Real, spall: Spall | None = None, offset: Real = 0.0, panels: int = 16
) -> LineSolution:
    """Press a roller on a raceway without spall, or over one wider than the contact, as a line load.

    The approach is within 1e-3 of the continuum where the status is converged; `solve_contact` does the rest.

    Args:
      contact: radius, length, modulus and crown. load: of the roller [N], > 0.
      spall: None is a healthy raceway. Its rolling edges must be out of the contact's reach.
      offset: of the spall's centre from the contact's, in the rolling direction [mm]; decides on that reach alone.
      panels: on each land [-], ≥ 8. 16 suffice for 1e-3; what the model itself lacks does not fall with more.

    The status is `UNSUITED` where a rolling edge or the spall's bottom is in reach, a land is shorter than 20
    half-widths, or the load per loaded length is more than 1.5 times that of the crown's design load. Differentiable
    by every number, forward and reverse; made for `jax.lax.map`.
    """
    status.require_float64()
    if panels < 8:
        raise ValueError(f"panels = {panels!r} is out of range: at least 8")
    arguments = as_floats(contact), jnp.asarray(load, float), as_floats(spall), jnp.asarray(offset, float)
    return _solve(*arguments, jnp.asarray(EDGE), is_symmetric(spall), panels)


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["lows", "tip", "unit", "scale", "length", "load", "edge", "weights", "squares"],
    meta_fields=["panels", "mirrored", "spalled"],
)
@dataclasses.dataclass(frozen=True)
class _Setting:
    """Lengths in mean half-widths `unit`, line loads in their mean, displacements in mean line load/(πE').

    Lands begin at `lows` and end at `tip`, seen from the middle; `scale` and `length` are the crown's.
    `weights` and `squares`: see `_beside_edges`.
    """

    lows: jax.Array
    tip: jax.Array
    unit: jax.Array
    scale: jax.Array
    length: jax.Array
    load: jax.Array
    edge: jax.Array
    weights: jax.Array
    squares: jax.Array
    panels: int
    mirrored: bool
    spalled: bool


def _beside_edges(lows: jax.Array, tip: jax.Array, panels: int, spalled: bool) -> tuple[jax.Array, jax.Array]:
    """Weights that take line loads to the local one of each land, (lands, panels · lands), and to squares of
    half-widths, (panels · lands, panels · lands)."""
    weights, squares = [], []
    for low in lows:
        lines = rows.graded(low, tip, panels, 3.0, 2.0)
        inside = 0.5 * (lines[1:] + lines[:-1]) - low
        weight = jnp.diff(lines) * jnp.exp(-((inside - AWAY) ** 2))
        weight = weight / jnp.sum(weight)
        beside = jnp.exp(-((inside / FADE) ** 2)) if spalled else jnp.zeros(panels)
        weights.append(weight[None])
        squares.append(jnp.diag(1.0 - beside) + beside[:, None] * weight[None])
    return jax.scipy.linalg.block_diag(*weights), jax.scipy.linalg.block_diag(*squares)


def _panels(setting: _Setting, loads: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Starts and ends of the panels; a land's begin `edge` of its local half-widths beyond the spall's edge."""
    if not setting.spalled:
        lines = rows.graded(setting.lows[0], setting.tip, setting.panels, 1.0, 2.0)
        return lines[:-1], lines[1:]
    lows = setting.lows - setting.edge * jnp.sqrt(jnp.maximum(setting.weights @ loads, 1e-3))
    lands = [rows.graded(low, setting.tip, setting.panels, 3.0, 2.0) for low in lows]
    if setting.mirrored:
        return lands[0][:-1], lands[0][1:]
    lower, upper = lands
    return jnp.concatenate([-lower[1:], upper[:-1]]), jnp.concatenate([-lower[:-1], upper[1:]])


def _crown(setting: _Setting, y: jax.Array) -> jax.Array:
    return setting.scale * gaps.log_crown(2.0 * y / setting.length, 1e-9)


Ends = tuple[jax.Array, jax.Array]
"""Starts and ends of all panels."""


def _ends(x: jax.Array, given: tuple[_Setting, jax.Array]) -> Ends:
    return _panels(given[0], jnp.maximum(x[:-1], 0.0))


def _misfit(setting: _Setting, x: jax.Array, ends: Ends) -> tuple[jax.Array, jax.Array]:
    """How far each panel's middle is from lying on the other body, and its derivative by line loads.

    The derivative leaves out that panels move with the load beside an edge.
    """
    (start, end), loads, approach = ends, jnp.maximum(x[:-1], 0.0), x[-1]
    square = setting.squares @ loads
    positive = square > 1e-9  # beside a spall's end unloaded panels keep a trace of the local load
    b = jnp.sqrt(jnp.where(positive, square, 1.0))
    y = 0.5 * (start + end)

    def with_slope(sigma: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.jvp(ellipse_integral, (sigma,), (sigma,))

    (high, high_slope), (low, low_slope) = (with_slope((line[None] - y[:, None]) / b[None]) for line in (end, start))
    influence = high - low
    by_square = jnp.where(positive, -0.5 * loads / jnp.where(positive, square, 1.0), 0.0)[None] * (
        high_slope - low_slope
    )
    if setting.mirrored:  # half-widths do not matter at the distance of the image, but for the next term in b/s
        near, far = (line[None] + y[:, None] for line in (start, end))
        influence += jnp.log(far / near) + 0.0625 * b[None] ** 2 * (1.0 / far**2 - 1.0 / near**2)
    return influence @ loads + _crown(setting, y) - approach, influence + by_square @ setting.squares


def _residual(x: jax.Array, ends: Ends, given: tuple[_Setting, jax.Array]) -> jax.Array:
    setting, _ = given
    misfit, _ = _misfit(setting, x, ends)
    loaded = x[:-1] > 0.0
    rest = jnp.vdot(ends[1] - ends[0], jnp.where(loaded, x[:-1], 0.0)) - setting.load
    return jnp.concatenate([jnp.where(loaded, misfit, x[:-1]), rest[None]])


def _respond(x: jax.Array, ends: Ends, given: tuple[_Setting, jax.Array], right: jax.Array) -> jax.Array:
    del ends  # which move with x
    return jnp.linalg.solve(jax.jacfwd(lambda v: _residual(v, _ends(v, given), given))(x), right)


def _start(setting: _Setting, approach: jax.Array) -> jax.Array:
    """Slices under an estimated approach, scaled to carry the load."""
    start, end = _panels(setting, jnp.ones(setting.panels * setting.lows.shape[0]))
    loads = jnp.maximum(1.0 - _crown(setting, 0.5 * (start + end)) / approach, 1e-2)
    loads = loads * setting.load / jnp.vdot(end - start, loads)
    return jax.lax.stop_gradient(jnp.append(loads, approach))


def _newton(given: tuple[_Setting, jax.Array]) -> tuple[jax.Array, Ends, tuple[jax.Array, jax.Array]]:
    """Newton's method on the loaded panels; those in tension leave, those that overlap return."""
    setting, first = given

    def step(state: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        x, _, count = state
        start, end = _ends(x, given)
        misfit, slope = _misfit(setting, x, (start, end))
        loads = x[:-1]
        loaded = loads > 0.0
        both = loaded[:, None] & loaded[None]
        matrix = jnp.where(both, slope, jnp.eye(loads.shape[0]))
        right = jnp.stack([jnp.where(loaded, -misfit, 0.0), jnp.where(loaded, 1.0, 0.0)], axis=1)
        moved, lifted = jnp.linalg.solve(matrix, right).T
        lengths = jnp.where(loaded, end - start, 0.0)
        rise = (setting.load - jnp.vdot(lengths, loads + moved)) / jnp.vdot(lengths, lifted)
        new = jnp.maximum(loads + moved + rise * lifted, 0.0)
        new = jnp.where(
            loaded, jnp.maximum(new, jnp.where(loads > 1e-3, jnp.where(loads > 0.05, 0.2, 0.02) * loads, 0.0)), 0.0
        )
        new = jnp.where(~loaded & (misfit < -1e-9 * x[-1]), 2e-3, new)
        change = jnp.max(jnp.abs(new - loads))
        return jnp.append(new, x[-1] + rise), change, count + 1

    def unfinished(state: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        return (state[1] > TOLERANCE) & (state[2] < PASSES)

    x, change, count = jax.lax.while_loop(unfinished, step, (first, jnp.asarray(1.0), jnp.asarray(0)))
    return x, _ends(x, given), (change, count)


@partial(jax.jit, static_argnums=(5, 6))
def _solve(
    contact: LineContact,
    load: jax.Array,
    spall: Spall | None,
    offset: jax.Array,
    edge: jax.Array,
    mirrored: bool,
    panels: int,
) -> LineSolution:
    ends = jnp.zeros(2) if spall is None else jnp.stack(edges_along(contact, spall))
    tip, mean, unit, estimate = reach_of_strips(contact, load, ends[0], ends[1])
    lows = jnp.maximum(ends[1:], 0.0) if mirrored else ends * np.array([-1.0, 1.0])
    push = np.pi * contact.modulus / mean
    images = 2.0 if mirrored else 1.0
    lows = jnp.minimum(lows, 0.99 * tip)
    setting = _Setting(
        lows / unit, tip / unit, unit, push * gaps.crown_scale(contact),
        contact.length / unit, load / (images * mean * unit), edge,
        *_beside_edges(lows / unit, tip / unit, panels, spall is not None), panels, mirrored, spall is not None,
    )  # fmt: skip
    first = _start(setting, push * estimate)
    x, (start, end), (change, count) = implicit.root(_residual, _ends, _newton, _respond, (setting, first))
    approach = x[-1] / push

    lands = tip - lows
    suited = jnp.all(lands > LEAST_LAND * unit) & (mean * contact.length < LARGEST_LOAD * contact.design_load)
    if spall is not None:
        suited &= clear_of_spall(contact, spall, offset, approach)
    sound = is_sound((contact, load, spall, offset, None))
    code = jnp.where(change <= TOLERANCE, status.CONVERGED, status.NOT_CONVERGED)
    code = jnp.where(sound, jnp.where(suited, code, status.UNSUITED), status.BAD_INPUT)
    return LineSolution(
        approach, mean * x[:-1], unit * start, unit * end, jax.lax.stop_gradient(change), count, code
    )  # fmt: skip
