"""One roller on one raceway: an elastic half-space, a crown, and spalls in reach. Enter by `solver.solve_contact`.

What is asked and what comes back is `contact_solution`; which way it is solved, `ways` chooses, which a program may
have done by numpy (`host_call`); how fine a solve is, `grids`; how far it reaches, `contact_extent`. The physics is
`gap`, `crown`, `height_map` and `halfspace`. There are three discretisations. Cells and a uniform lattice, which takes
height maps, are laid by `contact_cells` and solved by `cell_solve`, which asks `projected_gradient`. Strips
(`strip_model`) stand on land and over `hollows`, and reach as far as `strip_reach` says, which asks `slices` where
contact ends. They are rows (`strip_rows`, `strip_plan`) that see one another (`strip_kernel`, `strip_coupling`, over
frequencies of `strip_waves`); `strip_bands` chooses the loaded ones by an active set (`strip_active_set`), and
`strip_settling` finds pressure and boundaries. `stress_intensity` is what spalls' ends feel. The atlas of `law` is
made of such solves.
"""
