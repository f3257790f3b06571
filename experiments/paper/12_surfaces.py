"""Beyond the paper: the same spall on the outer ring, on the inner ring and on a roller."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from difftrb.core import geometry
from experiments.paper import common
from experiments.paper.common import HEAVY, HOLDS, ONLY_IF, Claim, Progress, Result

SURFACES = ("outer ring", "inner ring", "roller")
SIZES = ((3.0, 3.0), (4.0, 7.0), (8.0, 7.0))
SHOWN = 4.0, 7.0
"""Length and width [mm] of the spall that is drawn."""
PHASES = 48
"""Of the cage in one pitch: a mean over them is known to about one part in a hundred of the loss over the spall."""
PLACES = np.linspace(-np.pi, np.pi, 25)
TURNS = np.linspace(0.0, 2.0, 721)
"""Of the inner ring."""


def on(surface: str, values: np.ndarray | float) -> np.ndarray:
    """These values for one surface and 0 for the others, shape (n, 3)."""
    return np.asarray(values, float).reshape(-1, 1) * (np.array(SURFACES) == surface)


def losses(
    surface: str, size: tuple[float, float], angles: np.ndarray | float, phases: np.ndarray | float
) -> np.ndarray:
    """`common.losses_in_series` of one spall on one surface at these angles and cage phases [rad]."""
    return common.losses_in_series(on(surface, size[0]), np.full((1, 3), size[1]), on(surface, angles), phases)


def mean(surface: str, size: tuple[float, float], angles: np.ndarray) -> np.ndarray:
    """The mean over cage phases with the spall at these angles [rad], shape (angles, 4) [%]."""
    pitch = float(geometry.roller_pitch(common.bearing()))
    phases = pitch * (np.arange(PHASES) + 0.5) / PHASES
    every = losses(surface, size, np.repeat(angles, PHASES), np.tile(phases, angles.size))
    return every.reshape(angles.size, PHASES, 4).mean(axis=1)


def mean_of_turns(surface: str, size: tuple[float, float]) -> np.ndarray:
    """The mean over everything that turns, for the spall at the load line or under it, shape (4,) [%]: over the cage;
    over cage and inner ring; over the cage and the roller about its own axis."""
    even = 2.0 * np.pi * (np.arange(24) + 0.5) / 24
    if surface == "outer ring":
        return mean(surface, size, np.zeros(1))[0]
    if surface == "inner ring":
        return mean(surface, size, even).mean(axis=0)
    about = 2.0 * np.pi * (np.arange(60) + 0.5) / 60
    cage, own = (v.ravel() for v in np.meshgrid(even, about))
    return losses(surface, size, own, cage).mean(axis=0)


def rolling() -> tuple[float, float]:
    """How far the cage turns while the inner ring does, and a roller about its axis while the cage does."""
    b = common.bearing()
    cage = float(geometry.cage_share(b))
    return cage, float(np.sin(b.outer_angle) / np.sin(b.roller_angle))  # rolling on the outer cone, one apex


def passes() -> dict[str, float]:
    """How often a contact meets the spall in one turn of the inner ring."""
    cage, own = rolling()
    rollers = common.bearing().rollers
    return dict(zip(SURFACES, (rollers * cage, rollers * (1.0 - cage), 2.0 * cage * own), strict=True))


def turning(size: tuple[float, float]) -> dict[str, np.ndarray]:
    """Losses [%] at `TURNS` of the inner ring, each shape (n, 4); at 0 a spall is at the load line under a roller."""
    cage, own = rolling()
    ring = 2.0 * np.pi * TURNS
    angles = {"outer ring": 0.0 * ring, "inner ring": ring, "roller": -own * cage * ring}
    return {surface: losses(surface, size, np.mod(angle, 2.0 * np.pi), np.mod(cage * ring, 2.0 * np.pi))
            for surface, angle in angles.items()}  # fmt: skip


def draw_places(by_place: dict[str, np.ndarray], own: np.ndarray, about: dict[str, np.ndarray], out: Path) -> str:
    """Loss over the place, and over a roller's own angle."""
    figure, (left, right) = common.axes(1, 2, height=3.3)
    for (name, values), style, colour in zip(
        by_place.items(), ("o-", "s--", "^:", "v-."), common.COLOURS, strict=False
    ):
        left.plot(np.degrees(PLACES), values[:, 0], style, color=colour, ms=3.5, lw=1.2, label=name)
    left.axhline(0.0, color="black", lw=0.6)
    left.set_xticks([-180, -90, 0, 90, 180])
    left.set_xlabel("angle of spall, or of its roller, from the load line [°]")
    left.set_ylabel("loss of radial tangent stiffness [%]")
    left.set_title(f"{SHOWN[0]:g} × {SHOWN[1]:g} mm, by place")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=7)
    for (name, values), style in zip(about.items(), ("-", "--", "-."), strict=True):
        right.plot(np.degrees(own), values[:, 0], style, lw=1.3, label=name)
    right.set_xticks([-90, 0, 90, 180, 270])
    right.set_xlabel("angle of the spall about its roller's axis [°]")
    right.set_title("on the roller at the load line")
    top = max(float(v[:, 0].max()) for v in about.values())
    right.set_ylim(0.0, 1.3 * top)
    right.legend(fontsize=7, loc="upper center", ncols=3, columnspacing=1.0)
    for at, name in ((0.0, "on the outer\nraceway"), (180.0, "on the inner\nraceway")):
        right.text(at, 0.5 * top, name, ha="center", fontsize=7)
    return common.save(figure, out, "spalled_surfaces")


def draw_turning(traces: dict[str, np.ndarray], out: Path) -> str:
    """Loss while the inner ring turns."""
    figure, panels = common.axes(3, 1, height=1.35, sharex=True, sharey=True)
    for ax, (surface, values), colour in zip(panels, traces.items(), common.COLOURS, strict=False):
        ax.plot(TURNS, values[:, 0], "-", color=colour, lw=0.9)
        ax.axhline(0.0, color="black", lw=0.6)
        ax.set_title(f"on the {surface}: {passes()[surface]:.2f} contacts per turn", fontsize=8, loc="left")
    panels[2].set_xlabel("turns of the inner ring")
    figure.supylabel("loss of radial tangent stiffness [%]", fontsize=9)
    panels[0].set_xlim(TURNS[0], TURNS[-1])
    return common.save(figure, out, "spalled_turning")


def run(out: Path, progress: Progress) -> Result:
    """Side by side, by place, and turning."""
    by_place = {
        "outer ring, mean of phases": mean("outer ring", SHOWN, PLACES),
        "inner ring, mean of phases": mean("inner ring", SHOWN, PLACES),
        "roller, on the outer raceway": losses("roller", SHOWN, 0.0, PLACES),
        "roller, on the inner raceway": losses("roller", SHOWN, np.pi, PLACES),
    }
    progress(1, 4)
    own = np.linspace(-0.5 * np.pi, 1.5 * np.pi, 181)
    about = {f"{size[0]:g} × {size[1]:g} mm": losses("roller", size, own, 0.0) for size in SIZES}
    traces = turning(SHOWN)
    progress(2, 4)
    centred = {(surface, size): losses(surface, size, 0.0, 0.0)[0] for surface in SURFACES for size in SIZES}
    up = {size: losses("roller", size, np.pi, 0.0)[0] for size in SIZES}
    waiting = {(surface, size): mean(surface, size, np.zeros(1))[0] for surface in SURFACES[:2] for size in SIZES}
    turned = {(surface, size): mean_of_turns(surface, size) for surface in SURFACES for size in SIZES}
    progress(3, 4)
    pictures = draw_places(by_place, own, about, out), draw_turning(traces, out)

    def words(values: np.ndarray) -> str:
        return f"{values[0]:.2f} / {values[1]:.2f}"

    rows = [
        [f"{size[0]:g} × {size[1]:g} mm", surface, words(centred[surface, size]), words(centred[surface, size][2:]),
         words(waiting[surface, size]) if (surface, size) in waiting else "–", words(turned[surface, size])]
        for size in SIZES for surface in SURFACES
    ]  # fmt: skip
    apart = max(
        abs(float(v[k] / centred["outer ring", size][k] - 1.0))
        for size in SIZES for v in (centred["inner ring", size], up[size]) for k in range(4)
    )  # fmt: skip
    b = common.bearing()
    degrees = [float(np.degrees(SHOWN[1] / radius)) for radius in (
        geometry.arc_radius(b), geometry.arc_radius(b, "inner"), geometry.mean_roller_radius(b)
    )]  # fmt: skip
    turned_to = by_place["inner ring, mean of phases"][:, 0]
    cage, spin = rolling()
    text = common.page(
        f"Outer and inner raceway in series, both by tables of half-space contacts with ramps, "
        f"{HEAVY.radial:g}/{HEAVY.axial:g} N. Loss of stiffness, radial / axial [%]: a roller over the spall at the "
        "load line (the roller's own: down on the outer raceway); the mean over cage phases with the spall still at "
        "the load line; the mean over all that turns: the cage, the inner ring, the roller about its axis.",
        common.grid(
            ["spall", "on the", "centred, tangent", "centred, secant", "mean of phases, tangent",
             "mean of turns, tangent"], rows,
        ),
        common.picture(pictures[0], "Radial loss over the spall's place, and over a roller's own angle"),
        f"Left: {SHOWN[0]:g} × {SHOWN[1]:g} mm. An inner spall costs what an outer one does where it stands, and it "
        f"turns: from {turned_to.max():.2f} % at the load line to {turned_to.min():.2f} % beside it. There a roller "
        "adds nothing to the radial stiffness, and what it sheds stiffens the others: a small gain. All rollers are "
        "loaded here, so the far side counts, too. A "
        f"roller's spall is met for {degrees[2]:.0f}° of its turn by either raceway (the same 7 mm are "
        f"{degrees[0]:.1f}° of the outer and {degrees[1]:.1f}° of the inner one), and not at all between.",
        common.picture(pictures[1], "Radial loss over two turns of the inner ring, for a spall on either surface"),
        f"Rolling without slip: the cage makes {cage:.3f} turns in one of the inner ring, a roller {spin:.2f} about "
        "its axis in one of the cage. An outer spall is met always at the same place, an inner one wherever its ring "
        "has turned to (peaks: two rollers stand in it at once), a roller's wherever the cage has, at every half turn "
        "of its own.",
    )  # fmt: skip
    shares = [float(turned["inner ring", size][0] / turned["outer ring", size][0]) for size in SIZES]
    large = SIZES[-1]
    claim = Claim(
        "a defect on the inner raceway acts like one on the outer", HOLDS if min(shares) > 0.9 else ONLY_IF,
        f"it stands at the same place: under a roller at the load line 8 × 7 mm cost "
        f"{centred['outer ring', large][2]:.2f} (outer) and {centred['inner ring', large][2]:.2f} % (inner) of radial "
        f"secant stiffness, both raceways elastic, and no two surfaces differ by more than {100 * apart:.1f} % of the "
        f"loss. But an inner spall turns with its ring: its mean over a turn is {min(shares):.2f} to {max(shares):.2f} "
        "of the outer one's at the load line (radial, tangent)",
    )  # fmt: skip
    numbers = {
        "places": PLACES, "by_place": by_place, "own_angle": own,
        "about_its_axis": {name: v[:, 0] for name, v in about.items()}, "turns": TURNS,
        "turning": {surface: v[:, 0] for surface, v in traces.items()}, "passes_per_turn": passes(),
        "centred": {f"{s}, {a:g} x {w:g} mm": v for (s, (a, w)), v in centred.items()},
        "roller_on_inner": {f"{a:g} x {w:g} mm": v for (a, w), v in up.items()},
        "mean_of_phases": {f"{s}, {a:g} x {w:g} mm": v for (s, (a, w)), v in waiting.items()},
        "mean_of_turns": {f"{s}, {a:g} x {w:g} mm": v for (s, (a, w)), v in turned.items()},
        "surfaces_apart": apart,
    }  # fmt: skip
    progress(4, 4)
    return Result("A spall on the inner ring and on a roller", text, numbers, (claim,), beyond=True)
