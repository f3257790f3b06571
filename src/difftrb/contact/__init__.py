"""One roller on one raceway: an elastic half-space, a crown, and spalls in reach. Enter by `solver.solve_contact`.

Inputs and results are in `contact_solution`; `gap` and `halfspace` are the physics; `contact_cells` and the `strip_*`
modules are the two discretisations.
"""
