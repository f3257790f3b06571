"""What every room needs: the bearing and its surfaces, statuses and errors, fields with units and ranges, sentences on
files, derivatives of fixed points, polynomials, bisection, least squares, files written whole, this machine, and how
JAX is set up."""
