"""The bearing as a ring on its rollers: equilibrium, stiffness, the mean over cage phases, and effects beyond the
plain ring. It is not called `bearing`, for that is the public function `difftrb.bearing`."""
