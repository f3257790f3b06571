"""One roller on one raceway: an elastic half-space, a crown, and spalls in reach. `solver.solve_contact` takes it."""
