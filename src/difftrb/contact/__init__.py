"""One roller on one raceway: an elastic half-space, a crown, and spalls in reach. Enter by `solver.solve_contact`.

Inputs and results are in `contact_solution`; `gap` and `halfspace` are the physics. There are three discretisations.
Cells and a uniform lattice, which takes height maps (`contact_cells`), are solved by `projected_gradient`. Strips are
rows (`strip_rows`, `strip_plan`) that see one another (`strip_kernel`), of which `strip_bands` chooses the loaded ones
and `strip_settling` finds pressure and boundaries. The atlas of `law` is made of such solves.
"""
