"""A way of solving contacts that is being tried: bands, then smooth modes between boundaries that settle."""
