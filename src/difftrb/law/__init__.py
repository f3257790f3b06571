"""The force of a roller from its approach and the spalls under it: power laws, tables and contact solves.

`base` says what a law is. Every module here that calls `base.register` adds a law that scenes can name: all are
imported with the room.

Laws are `power`, `table` (of the `atlas`, in the variables of `atlas_place`) and "direct": `direct_curves` over all
loads, `direct_states` around those of one scene. A law gives `roller_curves`: a `load_curve` for every roller, and for
the one at a rolling edge a ramp (`edge_ramp`, `edge_share`; of a `narrow_spall` both edges as one), fitted by
`ramp_fit`. Contacts are solved in `samples`. `roller_states` are solved by `state_solves` and, where rings tilt, by
`tilted_state_solves`, of healthy rollers from a `healthy_tilt_table`. A roller between both raceways rests by
`tilt_equilibrium`; to the ring a tilted one is the slices of its `tilt_energy`.
"""

import importlib
import pkgutil

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
