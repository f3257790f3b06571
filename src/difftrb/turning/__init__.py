"""The bearing as its cage turns: stiffness and displacement over the cage's angle, their orders, defect frequencies;
and what rotordynamics takes of them."""
