"""The force of a roller from its approach and the spalls under it: power laws, tables and contact solves.

`base` says what a law is. Every module here that calls `base.register` adds a law that scenes can name: all are
imported with the room.
"""

import importlib
import pkgutil

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
