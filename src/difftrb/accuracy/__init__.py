"""What accuracy costs in time, on this machine and for this scene."""
