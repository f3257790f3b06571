"""One roller on one raceway: an elastic half-space, a crown, and spalls in reach. Enter by `solver.solve_contact`.

Inputs and results are in `contact_solution`; `gap` and `halfspace` are the physics. There are two discretisations:
`contact_cells`, solved by `projected_gradient`, and strips: rows (`strip_rows`, `strip_plan`) that see one another
(`strip_kernel`), of which `strip_bands` chooses the loaded ones and `strip_settling` finds pressure and boundaries.
"""
