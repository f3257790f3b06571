"""The package's own promises: one way of imports, names that exist, documented."""

import ast
from pathlib import Path

import pytest

import difftrb as trb

ROAD = ["pytrees", "status", "geometry", "hertz", "halfspace", "files", "sentences", "ranges",
        "heightmap", "given", "special", "rows", "gap", "domain", "edges", "lattice", "implicit",
        "press", "waves", "strips", "strip_model", "contact_solution", "contact", "continuum",
        "contact_slopes", "intensity", "line", "curve", "pit", "ramp", "law", "nodes", "direct",
        "store", "atlas", "table", "roller", "slices", "tilting", "pair", "load_zone", "balance",
        "ring", "pitch", "life", "effect", "double_row", "effects", "scene", "checks",
        "preparation", "solution", "choice", "solving", "edge_stress", "axes", "outputs",
        "devices", "swept", "plan", "sweeping", "gathered", "chunks", "forecast", "scenefile",
        "sweepfile", "measured", "unknowns", "observed", "least_squares", "confidence", "fitted",
        "optimal_design", "remarks", "fitting", "clock", "rungs", "rung_times", "accuracy",
        "report", "fit_report", "accuracy_report", "plot", "sweep_plot", "fit_plot",
        "accuracy_plot", "terminal", "environment", "folders", "__main__"]  # fmt: skip
SOURCE = Path(trb.__file__).parent
ALONE = {
    "jaxopt": {"implicit"},
    "optax": {"fitting"},
    "matplotlib": {"plot", "sweep_plot", "fit_plot", "accuracy_plot"},
    "pydantic": {"scenefile", "measured"},
}


def imports(module: str) -> set[str]:
    """Everything a module imports, `difftrb.x` as `difftrb.x`."""
    found: set[str] = set()
    for node in ast.walk(ast.parse((SOURCE / f"{module}.py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module == "difftrb":
            found |= {f"difftrb.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
    return found


def test_every_module_is_on_the_road() -> None:
    assert {p.stem for p in SOURCE.glob("*.py")} == {*ROAD, "__init__"}


@pytest.mark.parametrize("module", ROAD)
def test_imports_run_one_way(module: str) -> None:
    own = {name.split(".")[1] for name in imports(module) if name.startswith("difftrb.")}
    assert all(ROAD.index(name) < ROAD.index(module) for name in own), own


@pytest.mark.parametrize("module", ROAD)
def test_libraries_stay_in_their_rooms(module: str) -> None:
    for name in imports(module):
        library = name.split(".")[0]
        assert module in ALONE.get(library, {module}), name


def test_public_names_exist_and_are_documented() -> None:
    for name in trb.__all__:
        assert getattr(trb, name).__doc__, name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        trb.nothing  # type: ignore[attr-defined]  # noqa: B018


def test_it_is_typed() -> None:
    assert (SOURCE / "py.typed").exists()


def test_names_outlast_the_import_of_modules() -> None:
    for module in {path.stem for path in SOURCE.glob("*.py")} & set(trb.__all__) - {"effects"}:
        pytest.fail(f"module {module} takes the place of difftrb.{module} once it is imported: give it another name")
