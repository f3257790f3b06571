"""What numbers are worth: of which raceways stiffness is, what the roller law is, and what "auto" became."""

from __future__ import annotations

import math

import numpy as np

from difftrb.contact import gap
from difftrb.core.geometry import Real
from difftrb.law.base import LAWS
from difftrb.report.tables import number
from difftrb.ring import effect_base
from difftrb.ring.effects import Raceways
from difftrb.scene.scene import Picked, Scene, laws_error, raceway_contact, raceway_laws
from difftrb.scene.solution import Solution

PLACES = {"outer": "the outer raceway", "inner": "the inner raceway", "roller": "roller 0"}
"""Where a spall lies, by its surface."""


def raceways_text(scene: Scene, solution: Solution) -> str | None:
    """What the stiffness is of: of both raceways in series or, where the inner one does not give way, of the outer one,
    and about what is left of it and of its loss where both do. None without a solution."""
    if not bool(solution.converged):
        return None
    if effect_base.among(scene.effects, Raceways):
        calls = next((spall.surface for spall in scene.spalls if spall.surface != "outer"), None)
        why = "" if calls is None else f": a spall on {PLACES[calls]} calls for them"
        return f"stiffness is that of both raceways in series{why}"
    share = outer_share(scene, float(np.max(solution.loads)))
    return (
        "stiffness is that of the contacts with the outer raceway alone, as in the paper; both raceways in series make "
        f"about {share:.2f} of it{', and of its loss in per cent' if scene.spalls else ''}: effects.raceways"
    )


def outer_share(scene: Scene, load: float) -> float:
    """About which share of a roller's approach is the outer raceway's, under a load [N]: by the compliances of two long
    cylinders (Johnson 1985, section 5.6)."""
    compliance = []
    for raceway in ("outer", "inner"):
        contact = raceway_contact(scene, raceway)
        half_width = float(gap.half_width(contact, load))
        compliance.append(math.log(2.0 * float(contact.length) / half_width))
    return compliance[0] / sum(compliance)


def law_text(scene: Scene) -> str:
    """One sentence on the roller law of a prepared scene: what it is, its range and error, on every raceway that gives
    way."""
    law = raceway_laws(scene)[0]
    kind = LAWS.get(law.name)  # None: a law of the user's own
    text = f"law: {law.name}" if kind is None else f"law: {law.name}, {kind.summary}"
    low, high = (float(v) for v in law.load_range)
    if math.isfinite(high):
        text += f"; made for {low:.0f} … {high:.0f} N on the most loaded roller"
    error = float(laws_error(scene))
    if not math.isfinite(error):
        return f"{text}; error not known"
    off = f"{100.0 * error:.2g} %"
    return text + (
        f"; nine in ten loads are off by less than {off}" if law.name == "table" else f"; loads off by up to {off}"
    )


def picked_text(picked: Picked) -> str:
    """One sentence on what the law "auto" became."""
    way, kept = _way(picked.law, picked.accuracy), picked.error <= picked.asked
    asked = f"stiffness and peak load within {picked.asked:g}"
    off = f"{'nine in ten are' if picked.law == 'table' else 'they are'} off by up to {number(picked.error, '.1e')}"
    text = f"picked: {way}, for {asked}; {off}"
    if not kept:
        more = f"{'no law is known to keep' if picked.law != 'table' else 'the table does not keep'} {asked} here"
        text = f"picked: {way}; {off}, more than asked: {more}"
        if picked.law == "table":
            text += "; contacts solved for one scene do (difftrb run), sweeps and fits take no others"
    if picked.finer is None:
        return text
    finer = picked.finer
    return text + f"; finer: {_way(finer.law, finer.accuracy)}, in {finer.seconds:.2g} s or more"


def _way(law: str, accuracy: Real) -> str:
    """A law and, where it solves contacts, how exactly."""
    return f"{law} {accuracy:g}" if LAWS[law].solves else law
