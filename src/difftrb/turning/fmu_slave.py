"""What runs inside an FMU that `fmu.write` makes: Python's own library alone, for it runs where difftrb is not."""

import json
import math
from pathlib import Path
from xml.etree.ElementTree import SubElement

from pythonfmu import Fmi2Causality, Fmi2Slave, Real  # pyright: ignore[reportMissingImports]

AXES = "xyz"
ENTRIES = [f"k{row}{column}" for row in AXES for column in AXES]


class TaperedRollerBearing(Fmi2Slave):
    """Force of the bearing on its shaft, f = -K(φ) (q - u(φ) + ū): see `difftrb.turning.fmu`."""

    author = "difftrb"
    description = "Tapered roller bearing with its stiffness over the cage's angle, linear about its load"

    def __init__(self, **options):
        super().__init__(**options)
        held = json.loads((Path(self.resources) / "turn.json").read_text(encoding="utf-8"))
        self.stiffness, self.moved = held["stiffness"], held["waveform"]
        self.span, self.share = held["span"], held["cage_share"]
        self.cage_angle, self.speed = 0.0, held["speed"]
        self.x = self.y = self.z = 0.0
        self.fx = self.fy = self.fz = 0.0
        for axis in AXES:
            about = f"shaft's place along {axis}, from its mean place under the load [m]"
            self.register_variable(Real(axis, causality=Fmi2Causality.input, start=0.0, description=about))
        about = "inner ring's speed [rad/s]"
        self.register_variable(Real("speed", causality=Fmi2Causality.input, start=held["speed"], description=about))
        for axis in AXES:
            about = f"force on the shaft along {axis}, but for the constant load [N]"
            self.register_variable(Real(f"f{axis}", causality=Fmi2Causality.output, description=about))
        about = "angle of the cage since the start [rad]"
        self.register_variable(Real("cage_angle", causality=Fmi2Causality.output, description=about))
        for entry in ENTRIES:
            setattr(self, entry, 0.0)
            self.register_variable(Real(entry, causality=Fmi2Causality.output, description="stiffness now [N/m]"))
        self._update()

    def to_xml(self, *options):
        """With what is unknown at the start, every output: FMI asks for the list, PythonFMU leaves it out."""
        root = super().to_xml(*options)
        structure = root.find("ModelStructure")
        unknown = SubElement(structure, "InitialUnknowns")
        for output in structure.find("Outputs"):
            SubElement(unknown, "Unknown", output.attrib)
        return root

    def exit_initialization_mode(self):
        self._update()

    def do_step(self, current_time, step_size):
        self.cage_angle += self.share * self.speed * step_size
        self._update()
        return True

    def _update(self):
        """Stiffness and place at rest between the two phases beside the cage's angle, and the force they make."""
        count = len(self.stiffness)
        place = self.cage_angle / self.span * count
        low = math.floor(place)
        share = place - low
        first, second = low % count, (low + 1) % count
        at = [self.x, self.y, self.z]
        beside = [
            q - (1.0 - share) * u - share * v for q, u, v in zip(at, self.moved[first], self.moved[second], strict=True)
        ]
        for i, row in enumerate(AXES):
            force = 0.0
            for j, column in enumerate(AXES):
                k = (1.0 - share) * self.stiffness[first][i][j] + share * self.stiffness[second][i][j]
                setattr(self, f"k{row}{column}", k)
                force -= k * beside[j]
            setattr(self, f"f{row}", force)
