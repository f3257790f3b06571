"""The law "auto" for many scenes at once: the cheapest law that they can share. For one scene see `solving.prepare`."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import cast

from difftrb.core.geometry import Real
from difftrb.core.status import SceneError, SweepError
from difftrb.law import base as laws
from difftrb.scene import checks
from difftrb.scene.scene import Finer, Picked, Scene
from difftrb.scene.solving import PREPARED, apart, main_values, prepare, refined, solve_prepared

Made = tuple[str, float]
"""A law's name and its contacts' accuracy."""
SOFT: tuple[Made, ...] = (("table", 1e-3), ("table", 1e-4))
"""Laws that many scenes can share, the cheapest first: with ramps, so that edges may move."""
SHARED: tuple[Made, ...] = (("liu2018", 1e-3), ("power", 1e-2), *SOFT)
"""The same with those of a hard window, in which a roller is over a spall or not."""


def shared(scenes: Sequence[Scene], make: Callable[[str, float], Scene], among: Sequence[Made] = SHARED) -> Scene:
    """What `make(law, accuracy)` returns for the cheapest law that keeps `accuracy` in all of some `scenes` of "auto".

    Each of them is solved by "direct" first, see `solving.refined`, to a tenth of `accuracy` if it can; those without a
    solution do not count. A law's error is the largest difference from these, plus what they themselves are known to.
    If none keeps what is asked, the most exact one is taken, and `picked` says its error. Left out are laws for other
    bearings, and those for which `make` raises `SceneError` or `SweepError`; if that leaves none, the last one is
    raised.
    """
    among = [made for made in among if laws.LAWS[made[0]].is_for(scenes[0].bearing)]
    scenes = [checks.checked(scene) for scene in scenes]
    asked = scenes[0].accuracy
    exact = [(scene, *refined(dataclasses.replace(scene, accuracy=0.1 * asked))) for scene in scenes]
    best: Scene | None = None
    for number, (law, accuracy) in enumerate(among):
        try:
            made = make(law, accuracy)
        except (SceneError, SweepError):
            if best is None and number + 1 == len(among):
                raise
            continue
        errors = [_error(made, scene, truth) for scene, truth, _ in exact if bool(solve_prepared(truth).converged)]
        finer = None
        if number + 1 < len(among):
            following, its = among[number + 1]
            effort = laws.LAWS[following].effort(its)
            finer = Finer(following, its, effort * min(seconds for *_, seconds in exact))
        picked = Picked(law, accuracy, asked, max(errors, key=_size, default=math.nan), finer)
        made = dataclasses.replace(made, accuracy=PREPARED, picked=picked)
        if best is None or _size(picked.error) < _size(cast(Picked, best.picked).error):
            best = made
        if picked.error <= picked.asked:
            return made
    return cast(Scene, best)


def _error(made: Scene, scene: Scene, truth: Scene) -> float:
    """Of a scene by the law of another one that was prepared."""
    by_law = prepare(dataclasses.replace(scene, law=made.law, effects=made.effects))
    off = apart(main_values(solve_prepared(by_law)), main_values(solve_prepared(truth)))
    return off + float(cast(Picked, truth.picked).error)


def _size(error: Real) -> float:
    """For comparing: what is not known is larger than all that is."""
    return math.inf if math.isnan(error) else float(error)
