"""The force of a roller from its approach and the spalls under it: power laws, tables and contact solves."""
