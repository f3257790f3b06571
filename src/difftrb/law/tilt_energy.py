"""A roller whose rings tilt, near the state it is in: force and moment of a contact as those of a few slices.

A contact answers to approach δ and tilt ψ with the force Q and the moment M about the roller's middle. Both are slopes
of one energy U, dU = Q dδ + M dψ, a polynomial in δ and ψ near a state. A polynomial of degree n in two variables is
a sum of polynomials in δ + xψ at n + 1 points x. So slices at these points are the contact, whatever it is: some may
push and others pull, only their sums Q = Σ qₛ and M = Σ xₛ qₛ mean anything.
"""

from __future__ import annotations

from math import comb
from typing import Any

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core.numeric import least_squares
from difftrb.law.roller_curves import NearState

DEGREE = 4
"""Of the energy: forces are cubic, as of `direct_states.DEGREE`."""
SLICES = DEGREE + 1
FARTHEST = 0.4
"""Of the roller's length: the outermost slices. Equal slices there have its stiffness against tilt, about: 1/12."""
BEYOND = 1.2
"""Reach of a slice's polynomial, by that of its solves: beyond, it goes on straight."""
NOTHING = 1e-9
"""Of a coefficient, where solves do not tell it: so that it is 0."""
POWERS = [(i, m - i) for m in range(1, DEGREE + 1) for i in range(m, -1, -1)]
"""Of δ and ψ in each term of the energy, by rising degree."""
_WAYS = np.linspace(-1.0, 1.0, SLICES)


def points(length: Any) -> Any:
    """Where the slices are, from the middle of a roller of this length [mm], shape (SLICES,)."""
    return FARTHEST * length * _WAYS


def of_slices(of_rollers: Any, count: int) -> Any:
    """What is known of rollers, shape (…, rollers), for `count` slices of each, shape (…, rollers · count)."""
    repeated = xp.broadcast_to(of_rollers[..., None], (*of_rollers.shape, count))
    return repeated.reshape(*of_rollers.shape[:-1], -1)


def fitted_slices(loads: Any, tilts: Any, approaches: Any, moments: Any, length: Any) -> NearState:
    """The slices that stand for contacts solved under `loads` [N] at `tilts` [rad], which press the roller's end at
    positive places in: approaches [mm] and moments [N mm], all of shape (…, states, solves). What comes back has the
    slices of every state, shape (…, states, SLICES)."""
    arm, seen = FARTHEST * length, xp.fixed(approaches)
    turned = tilts - xp.mean(tilts, axis=-1)[..., None]
    middle = 0.5 * (xp.max(seen, axis=-1) + xp.min(seen, axis=-1))
    reach = BEYOND * (xp.max(seen - middle[..., None], axis=-1) + arm * xp.max(xp.abs(turned), axis=-1))
    size = xp.exp(xp.mean(xp.log(loads), axis=-1))
    d, t = (approaches - middle[..., None]) / reach[..., None], arm * turned / reach[..., None]
    deeper, leaning = _powers(d), _powers(t + 0.0 * seen)
    by_approach = xp.stack([i * deeper[max(i - 1, 0)] * leaning[j] for i, j in POWERS], axis=-1)
    by_tilt = xp.stack([j * deeper[i] * leaning[max(j - 1, 0)] for i, j in POWERS], axis=-1)
    asked = xp.concatenate([by_approach, by_tilt], axis=-2)
    rows = xp.concatenate([loads / size[..., None] + 0.0 * seen, moments / (arm * size)[..., None]], axis=-1)
    energy = least_squares(asked, rows, NOTHING)
    coefficients = xp.stack([
        size[..., None] * xp.einsum("...a,sa->...s", energy[..., own], spread)
        for own, spread in zip(_OF_DEGREE, _LOADS_OF_TERMS, strict=True)
    ])  # fmt: skip
    at = middle[..., None] + xp.mean(tilts, axis=-1)[..., None] * points(length).reshape((1,) * middle.ndim + (-1,))
    return NearState(coefficients, at, xp.broadcast_to(reach[..., None], at.shape))


def _powers(x: Any) -> list[Any]:
    rows = [0.0 * x + 1.0]
    for _ in range(DEGREE):
        rows.append(rows[-1] * x)
    return rows


def _load_of_terms(degree: int) -> np.ndarray:
    """What every slice's load has of the terms of one degree of the energy, shape (SLICES, degree + 1)."""
    terms = np.array([comb(degree, j) * _WAYS**j for j in range(degree + 1)])  # of (δ + xψ)ᵐ
    return degree * np.linalg.pinv(terms)


_LOADS_OF_TERMS = [_load_of_terms(degree) for degree in range(1, DEGREE + 1)]
_OF_DEGREE = [slice(m * (m + 1) // 2 - 1, (m + 1) * (m + 2) // 2 - 1) for m in range(1, DEGREE + 1)]
