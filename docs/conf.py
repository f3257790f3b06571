"""The documentation site: `sphinx-build -W -b html docs site`. It needs no network."""

from importlib import metadata
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

project = "difftrb"
version = release = metadata.version("difftrb")
copyright = "MIT licence"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["site", "_build"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = f"difftrb {version}"
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True, "top_of_page_buttons": []}
html_static_path = ["site.css"]
html_css_files = ["site.css"]
autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_use_ivar = True
SOON = ("bearings", "stiffness", "sweeps")
"""Pages that the index names and that may be missing."""


def without_missing(app: Any, page: str, source: list[str]) -> None:
    """The index without the pages that are not there yet."""
    if page == "index":
        missing = {name for name in SOON if not (Path(__file__).parent / f"{name}.md").exists()}
        source[0] = "\n".join(line for line in source[0].split("\n") if line not in missing)


def setup(app: Any) -> None:
    app.connect("source-read", without_missing)
