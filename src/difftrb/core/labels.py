"""Names and units of the ring's axes: three ways along them and two tilts about them."""

AXES = ("radial", "lateral", "axial", "about_radial", "about_lateral")
"""Of displacements and stiffness, in their order; the last two where rings tilt."""
LENGTHS = "mm; about_…: rad"
STIFFNESSES = "N/mm; about_… by about_…: N mm/rad; mixed: N/rad, N mm/mm"
"""Of a whole array, whose entries differ where rings tilt."""


def length_of(name: str) -> str:
    """Unit of the displacement along or about an axis."""
    return "rad" if name.startswith("about") else "mm"


def force_of(name: str) -> str:
    """Unit of the force along an axis, or of the moment about it."""
    return "N mm" if name.startswith("about") else "N"


def stiffness_of(name: str, by: str | None = None) -> str:
    """Unit of the force along an axis (or the moment about it) by the motion along (about) another; default: itself."""
    return f"{force_of(name)}/{length_of(name if by is None else by)}"
