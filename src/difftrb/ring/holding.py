"""Whether rollers hold a ring: the load, before it is solved; every direction, once it is."""

from __future__ import annotations

from typing import Any

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.geometry import TaperedBearing
from difftrb.ring import newton
from difftrb.ring.load import Load, is_enough, needed_axial
from difftrb.ring.terms import Terms, without_land

LEAST_SHARE = 1e-9
"""Of all loads, from which a roller's share is more than what is left over where an equilibrium counts as found."""
LEAST_HOLD = 1e-11
"""By how much a ring must be held in every direction, by the most: 400 rollers of which three neighbours carry hold it
by 1e-9."""
BARE = 1e-9
"""Share of all loads above which slices without land count as what holds the ring."""


def is_held(bearing: TaperedBearing, load: Load, phase: Any, terms: Terms) -> Any:
    """Whether rollers, which only push, can hold the load."""
    spare = load.axial
    if terms.seat is not None and terms.seat.centrifugal is not None:  # thrown rollers push the rings apart
        spare = spare - bearing.rollers * terms.seat.least_outer_load * xp.sin(bearing.outer_angle)
    if terms.axial is not None:
        return np.asarray(True)
    if terms.pair is not None:  # whatever way a load points, one of both rows is pressed by it, or both by the preload
        moments = 0.0 if terms.tilting is None else abs(terms.tilting.moments).sum()
        return (load.radial + load.axial + moments > 0.0) | (terms.pair.preload > 0.0)
    return is_enough(spare, needed_axial(bearing, load.radial, phase, terms.tilting))


def not_held(rest: Any, normals: Any, loads: Any, terms: Terms) -> Any:
    """Status: whether the ring rests on what may hold it: anything, in all directions, on land, or on both of two rows.
    `rest` is an `Equilibrium`; `normals` and `loads` [N] are of rollers, or of their slices, which are left a trace of
    stiffness without land."""
    thrown = 0.0 if terms.seat is None else terms.seat.least_outer_load
    free = is_free(*xp.fixed((normals, loads - thrown)), held_axially=terms.axial is not None)
    code: Any = xp.where(free & rest.is_found, status.FREE, status.CONVERGED)
    if terms.axial is not None or terms.pair is not None:
        code = xp.where(xp.total(rest.loads) > 0.0, code, status.UNPRESSED)
    if terms.slices is not None:
        bare = xp.total(xp.where(without_land(terms.slices), loads, 0.0))
        code = xp.where(bare > BARE * xp.total(loads), status.NO_EQUILIBRIUM, code)
    if terms.pair is not None and terms.tilting is not None and terms.slices is None:
        rows = xp.total(rest.loads.reshape(*rest.loads.shape[:-1], 2, -1))
        least = xp.module_of(rows).min(rows, axis=-1)
        code = xp.where(rest.is_found & (least <= LEAST_SHARE * xp.total(rows)), status.LOOSE, code)
    return code


def is_free(normals: Any, pressed: Any, held_axially: bool) -> Any:
    """Whether rollers that carry `pressed` [N], shape (…, rollers), leave a direction free: where their normals, shape
    (…, rollers, n), do not reach. Their stiffness does not tell: as a roller is touched it rises too steeply."""
    of = xp.module_of(normals, pressed)
    total = of.sum(pressed, axis=-1, keepdims=True)
    gram = newton.tangent(normals, (pressed > LEAST_SHARE * total) * 1.0)
    if held_axially:
        axial = np.arange(gram.shape[-1]) == 2
        gram = gram + newton.aligned(normals.shape[-2] * np.diag(axial), gram)
    if gram.shape[-1] != 3:
        values = of.linalg.eigvalsh(gram)
        return values[..., 0] <= LEAST_HOLD * values[..., -1]
    minors, determinant = newton.cofactors(gram)
    minors, most = (of.trace(one, axis1=-2, axis2=-1) for one in (minors, gram))
    return determinant <= LEAST_HOLD * most * minors  # their ratio is about the smallest eigenvalue
