"""What every room needs: the bearing and its surfaces, statuses and their sentences, fields with units and ranges,
derivatives of fixed points, files that are written whole, the cache, the terminal, and how JAX is set up."""
