"""The packaged example of measurements: made by contact solves at 1e-4 for exactly the states of the rollers (law
"direct"), with noise of 1 %. It is a measured table in form only; no bearing was measured.

python experiments/example_measurements.py [FILE]   (default src/difftrb/scenes/measured.csv)
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import difftrb as trb

SEED = 2018
SPALL = trb.Spall(4.0, 7.0)
LOADS = ((9000.0, 4500.0), (3000.0, 4500.0))
PHASES = (0.0, "mean")
NOISE = 0.01
HEAD = f"""# Loss of stiffness of a TRB 32008J with a spall on its outer raceway, against the same bearing without one.
# Not measured: made by experiments/example_measurements.py from contact solves (law "direct", accuracy 1e-4) for a
# spall of {SPALL.length:g} x {SPALL.width:g} mm at the load line, with noise of {100.0 * NOISE:g} % of each value.
# radial, axial [N]; value and sigma [%]; phase: roller 0 stands at the load line, or mean over one roller pitch
radial,axial,quantity,value,sigma,phase
"""


def table() -> str:
    """The text of the file."""
    rng = np.random.default_rng(SEED)
    lines = []
    for radial, axial in LOADS:
        for phase in PHASES:
            scene = trb.Scene(trb.bearing("32008J"), trb.Load(radial, axial), (SPALL,), "direct", phase=phase,
                              accuracy=1e-4)  # fmt: skip
            for axis, loss in zip(("radial", "axial"), np.asarray(trb.assess(trb.prepare(scene)).loss), strict=True):
                value = loss * (1.0 + NOISE * rng.standard_normal())
                lines.append(f"{radial:g},{axial:g},{axis}_loss,{value:.4f},{NOISE * loss:.4f},{phase}\n")
    return HEAD + "".join(lines)


def main() -> None:
    """Solve, add noise, write."""
    folder = Path(__file__).parent.parent / "src" / "difftrb" / "scenes"
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else folder / "measured.csv"
    path.write_text(table(), encoding="utf-8")
    print(f"written to {path}")


if __name__ == "__main__":
    main()
