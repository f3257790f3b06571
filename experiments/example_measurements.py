"""The packaged example of measurements: made by contact solves at 1e-4 for exactly the states of the rollers (law
"direct"), with noise of 1 %. It is a measured table in form only; no bearing was measured.

python experiments/example_measurements.py [FILE]   (default src/difftrb/scenes/measured.csv)
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from fit_coverage import NOISE, SPALL, noisy, truth

SEED = 2018
HEAD = f"""# Loss of stiffness of a TRB 32008J with a spall on its outer raceway, against the same bearing without one.
# Not measured: made by experiments/example_measurements.py from contact solves (law "direct", accuracy 1e-4) for a
# spall of {SPALL.length:g} x {SPALL.width:g} mm at the load line, with noise of {100.0 * NOISE:g} % of each value.
# radial, axial [N]; value and sigma [%]; phase: roller 0 stands at the load line, or mean over one roller pitch
radial,axial,quantity,value,sigma,phase
"""


def table(losses: dict[tuple[float, float, float | str], np.ndarray]) -> str:
    """The text of the file."""
    lines = [
        f"{row.radial:g},{row.axial:g},{row.quantity},{row.value:.4f},{row.sigma:.4f},{row.phase}"
        for row in noisy(losses, SEED)
    ]
    return HEAD + "\n".join(lines) + "\n"


def main() -> None:
    """Solve, add noise, write."""
    folder = Path(__file__).parent.parent / "src" / "difftrb" / "scenes"
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else folder / "measured.csv"
    path.write_text(table(truth(1e-4)), encoding="utf-8")
    print(f"written to {path}")


if __name__ == "__main__":
    main()
