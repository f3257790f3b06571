"""The bearing as its cage turns: stiffness and displacement over the cage's angle, their orders, what spalls of any
size cost in its mean, defect frequencies; and what rotordynamics takes of them."""
