"""Contact solves from which roller laws are built: approach and its derivatives by everything, many at a time."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from threadpoolctl import threadpool_limits

from difftrb.contact import crown, gap
from difftrb.contact import solver as contacts
from difftrb.contact.contact_extent import ends_along
from difftrb.contact.contact_solution import Defect
from difftrb.contact.height_map import HeightMap
from difftrb.contact.solver import ContactSolution
from difftrb.core import arrays as xp
from difftrb.core import machine, status, user_cache
from difftrb.core.geometry import LineContact, Real, Spall

ALONG = 41
"""Places along a spall at which it is asked how far the roller stands off."""

THREADED = 1e-3
"""Accuracies below take more than one thread: two cores are 1.4 times as fast as one at 1e-4, 1.7 times at 1e-5, 0.9 at
1e-3, 0.8 at 1e-2."""

Asked = TypeVar("Asked")
Solved = TypeVar("Solved")


class LawInputs(NamedTuple):
    """What the slopes of a contact's approach are by: of the contact, of the spall, and the contact's distance from its
    middle. Arrays hold these in this order along their last axis; `AT` says where."""

    radius: Any
    length: Any
    modulus: Any
    design_load: Any
    spall_length: Any
    spall_width: Any
    spall_depth: Any
    spall_axial_offset: Any
    distance: Any


INPUTS = len(LawInputs._fields)
AT = LawInputs(*range(INPUTS))
"""Where each input stands in an array's last axis."""
OF_CONTACT = tuple(LawInputs._fields[: AT.spall_length])
OF_SPALL = tuple(name.removeprefix("spall_") for name in LawInputs._fields[AT.spall_length : AT.distance])

Progress = Callable[[int, int], None]
"""Told how many of how many solves are done."""


class Case(NamedTuple):
    """One contact: load [N], spall (None is healthy, a tuple is several), distance of the contact from the spall's
    middle [mm], of several one each, and the roller's tilt [rad]."""

    load: float
    spall: Spall | tuple[Spall, ...] | None = None
    distance: float | Sequence[float] = 0.0
    tilt: float = 0.0

    @property
    def offset(self) -> float | list[float]:
        """Of the spall from the contact, as a contact takes it [mm]: a map is another one in a mirror."""
        own = self.distance
        return [-each for each in own] if isinstance(own, Sequence) else -own


def case_under(load: float, spalls: Sequence[Spall], away: Sequence[float]) -> Case:
    """The contact of a roller over some spalls, at distances `away` [mm] from their middles. A single spall stands
    alone, which more ways of solving take; on which surface they lie does not matter to a contact."""
    met = tuple(dataclasses.replace(spall, surface="outer") for spall in spalls)
    if len(met) < 2:
        return Case(load, met[0], away[0]) if met else Case(load)
    return Case(load, met, tuple(away))


class TiltResponse(NamedTuple):
    """How a contact answers to tilt: approach by tilt [mm/rad], moment by tilt [N mm/rad] and by `inputs`."""

    by_tilt: float
    moment_by_tilt: float
    moment_slopes: np.ndarray


@dataclasses.dataclass(frozen=True)
class Node:
    """A solved `Case`: approach [mm], by the load [mm/N] and, the tilt held, by `inputs`, shape (INPUTS,), longer with
    several spalls; the rest as in `ContactSolution`; `tilt_response` if it was asked for."""

    approach: float
    compliance: float
    slopes: np.ndarray
    status_code: int
    half_width: float
    reach: float
    moment: float = 0.0
    tilt_response: TiltResponse | None = None


def inputs(contact: LineContact, spall: Defect, distance: Real | Sequence[Real]) -> Any:
    """`LawInputs` as a vector, shape (INPUTS,); no spall counts as zeros. Of several spalls all sizes, then all
    distances: shape (count(spalls),)."""
    spalls = spall if isinstance(spall, tuple) else (spall,)
    of_spalls = [value for each in spalls for value in _sizes(each)]
    away = distance if isinstance(distance, Sequence) or np.ndim(distance) else [distance] * len(spalls)
    of_spalls += [away[i] for i in range(len(spalls))]
    return xp.stack([xp.asarray(x) for x in (*(getattr(contact, name) for name in OF_CONTACT), *of_spalls)])


def _sizes(spall: Spall | HeightMap | None) -> Sequence[Any]:
    """As `OF_SPALL` has them; a map has its pitches and the scale of its heights."""
    if isinstance(spall, HeightMap):
        return spall.pitch_y, spall.pitch_x, spall.scale, spall.axial_offset
    return [0.0 if spall is None else getattr(spall, name) for name in OF_SPALL]


def contact_of(values: Any) -> LineContact:
    """The contact in a vector of `inputs`."""
    return LineContact(*(values[i] for i in AT[: AT.spall_length]))


def count(spalls: int) -> int:
    """How many inputs contacts under so many spalls have."""
    return len(OF_CONTACT) + (len(OF_SPALL) + 1) * spalls


def places(under: Sequence[int], spalls: int) -> list[int]:
    """Where the inputs of a contact under the spalls numbered `under` stand among those under all `spalls`."""
    first, size = len(OF_CONTACT), len(OF_SPALL)
    sizes = [first + size * i + j for i in under for j in range(size)]
    return [*range(first), *sizes, *(first + size * spalls + i for i in under)]


def pressed(contact: LineContact, case: Case, accuracy: float) -> ContactSolution:
    """The contact of one case, without slopes."""
    return contacts.solve_contact(contact, case.load, case.spall, case.offset, accuracy, tilt=case.tilt)


def solved(contact: LineContact, case: Case, accuracy: float) -> Node:
    """Solve one case, choosing the method automatically. Of a roller over the middle of a wide spall, `reach` is how
    far from there a rolling edge would touch it [mm]; else 0."""
    solution, by = contacts.approach_and_gradient(contact, case.load, case.spall, case.offset, accuracy, tilt=case.tilt)
    return _node(contact, case, solution, by)


def solved_with_tilt(contact: LineContact, case: Case, accuracy: float) -> Node:
    """`solved`, with its `tilt_response`."""
    solution, by, by_moment = contacts.approach_and_gradient(
        contact, case.load, case.spall, case.offset, accuracy, tilt=case.tilt, moment=True
    )
    tilt_response = TiltResponse(_or_zero(by.tilt), _or_zero(by_moment.tilt), _by_inputs(case, by_moment))
    return dataclasses.replace(_node(contact, case, solution, by), tilt_response=tilt_response)


def _node(contact: LineContact, case: Case, solution: ContactSolution, by: contacts.Inputs) -> Node:
    centred = isinstance(case.spall, Spall) and case.distance == 0.0
    return Node(
        float(solution.approach), float(by.load), _by_inputs(case, by), int(solution.status_code),
        0.5 * float(solution.contact_width), last_touch(contact, solution) if centred else 0.0, float(solution.moment),
    )  # fmt: skip


def _or_zero(slope: Real | None) -> float:
    """By the tilt of a contact that was solved on half the roller, which has none."""
    return 0.0 if slope is None else float(slope)


def _by_inputs(case: Case, by: contacts.Inputs) -> np.ndarray:
    """A gradient as `inputs` are ordered."""
    by_distance = -np.asarray(by.offset) if case.spall is not None else 0.0
    return np.array(inputs(by.contact, cast(Any, by.spall), by_distance))


def last_touch(contact: LineContact, solution: ContactSolution) -> float:
    """How far from the spall's middle a rolling edge would last touch the deformed roller [mm].

    e² = 2R max(δ − c(y) − w(e, y)) along the spall, with the crown c and the displacement w that the loaded land makes
    there; cells act as point loads, which they are far from.
    """
    spall, cells = solution.spall, solution.cells
    assert isinstance(spall, Spall)
    force, x, y = np.asarray(solution.force), np.asarray(cells.x), np.asarray(cells.y)
    if cells.mirrored:
        force, y = 0.5 * np.concatenate([force, force]), np.concatenate([y, -y])
    low, high = map(float, ends_along(contact, spall))
    along = low + (high - low) * (np.arange(ALONG) + 0.5) / ALONG
    rise = np.asarray(crown.height(along, contact))
    rows, columns = np.nonzero(force > 0.0)
    pressed, x, y = force[rows, columns], x[columns], y[rows]
    radius, approach = float(contact.radius), float(solution.approach)
    if approach <= 0.0:  # no solution, as its status says
        return 0.0
    apart = (y - along[:, None]) ** 2
    edge = gap.certain_reach(radius, approach)
    for _ in range(10):
        sunk = (pressed / np.sqrt((x - edge) ** 2 + apart)).sum(axis=1) / (np.pi * float(contact.modulus))
        edge = 0.5 * (edge + gap.certain_reach(radius, max(approach - _least(rise + sunk), 1e-3 * approach)))
    return float(edge)


def _least(values: np.ndarray) -> float:
    """The least of values at even places, by the parabola through it and its neighbours."""
    k = int(np.clip(np.argmin(values), 1, values.size - 2))
    before, here, behind = values[k - 1 : k + 2]
    bend = before - 2.0 * here + behind
    if not np.isfinite(bend) or bend <= 0.0:
        return float(np.min(values))
    shift = np.clip(0.5 * (before - behind) / bend, -1.0, 1.0)
    return float(here - 0.25 * (before - behind) * shift) if abs(shift) < 1.0 else float(np.min(values))


def all_solved(
    contact: LineContact, cases: Sequence[Case], accuracy: float, progress: Progress | None = None,
    tilt_response: bool = False,
) -> list[Node]:  # fmt: skip
    """Solve every case, with slopes, and with its `tilt_response` if asked for; once for all processes where things are
    kept."""
    solve = solved_with_tilt if tilt_response else solved

    def anew() -> list[Node]:
        return mapped(lambda case: solve(contact, case, accuracy), cases, accuracy, progress)

    nodes = user_cache.result(anew, solve.__name__, (solve, contact, tuple(cases), accuracy))
    if progress is not None:
        progress(len(nodes), len(cases))
    return nodes


def mapped(
    solve: Callable[[Asked], Solved], cases: Sequence[Asked], accuracy: float, progress: Progress | None = None
) -> list[Solved]:
    """`solve` of every case, of contacts of this accuracy: of fine ones on all cores that this process may use."""
    nodes: list[Solved] = []
    # of coarse ones the arrays are small: threads would wait for Python's lock, a quarter longer than one alone
    workers = machine.cores() if accuracy < THREADED else 1
    # LAPACK's own threads, besides these, only wait for each other: exact edges would take twice as long
    with threadpool_limits(1, "blas"), ThreadPoolExecutor(workers) as pool:
        for node in pool.map(solve, cases):
            nodes.append(node)
            if progress is not None:
                progress(len(nodes), len(cases))
    return nodes


def worst_status(nodes: Sequence[Node]) -> float:
    """The status that matters most of all solves."""
    return float(max((node.status_code for node in nodes), default=status.CONVERGED))
