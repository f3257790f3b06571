"""The package's own promises: rooms in which imports run one way, names that exist, documented."""

import ast
import importlib
from pathlib import Path

import pytest

import difftrb as trb

ROOMS = ("core", "contact", "law", "ring", "scene", "turning", "report", "sweeps", "fits", "accuracy")
"""In the order of the road: a room imports from those before it."""
APART = {"sweeps", "fits", "accuracy"}
"""These do not import each other."""
SOURCE = Path(trb.__file__).parent
MODULES = sorted(str(path.relative_to(SOURCE)) for path in SOURCE.rglob("*.py"))
ALONE = {
    "jaxopt": {"core/implicit.py"},
    "optax": {"fits/batched_misfit.py"},
    "matplotlib": {
        "report/figure_style.py", "report/pressure_figure.py", "report/bearing_drawing.py",
        "report/run_figures.py", "sweeps/sweep_plot.py", "fits/fit_figure.py",
        "accuracy/accuracy_report.py",
    },
    "bokeh": {"report/explorer.py", "report/explorer_figures.py"},
    "pydantic": {"scene/scene_file.py", "scene/file_schema.py", "fits/measured_table.py"},
}  # fmt: skip
"""Where a library is used, and nowhere else."""


def imports(module: str) -> set[str]:
    """Everything a module imports, `from difftrb.a import b` as `difftrb.a.b`."""
    found: set[str] = set()
    for node in ast.walk(ast.parse((SOURCE / module).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def own(module: str) -> list[tuple[str, ...]]:
    """The modules of this package among them: room and name."""
    parts = [tuple(name.split(".")[1:3]) for name in imports(module) if name.startswith("difftrb.")]
    return [part for part in parts if len(part) == 2]


def test_every_module_is_in_a_room() -> None:
    assert {name for name in MODULES if "/" not in name} == {"__init__.py", "__main__.py"}
    assert {name.split("/")[0] for name in MODULES if "/" in name} == set(ROOMS)


@pytest.mark.parametrize("module", [name for name in MODULES if "/" in name])
def test_imports_run_one_way(module: str) -> None:
    room = module.split("/")[0]
    for other, name in own(module):
        assert ROOMS.index(other) <= ROOMS.index(room), name
        assert other == room or not {other, room} <= APART, name


@pytest.mark.parametrize("room", ROOMS)
def test_no_module_imports_itself_by_others(room: str) -> None:
    """Within a room, too, there is an order."""
    inside = {
        Path(name).stem: {n for o, n in own(name) if o == room} for name in MODULES if name.startswith(f"{room}/")
    }
    while inside:
        first = {name for name, needs in inside.items() if not needs & set(inside)}
        assert first, f"these import each other: {sorted(inside)}"
        inside = {name: needs for name, needs in inside.items() if name not in first}


@pytest.mark.parametrize("module", MODULES)
def test_libraries_stay_in_their_rooms(module: str) -> None:
    for name in imports(module):
        library = name.split(".")[0]
        assert module in ALONE.get(library, {module}), name


@pytest.mark.parametrize("room", ROOMS)
def test_rooms_say_what_they_are_for(room: str) -> None:
    assert ast.get_docstring(ast.parse((SOURCE / room / "__init__.py").read_text(encoding="utf-8")))


def test_public_names_exist_and_are_documented() -> None:
    for name in trb.__all__:
        assert getattr(trb, name).__doc__, name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        trb.nothing  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize("module", MODULES)
def test_errors_have_one_base(module: str) -> None:
    """Every class of errors is a `DifftrbError`; none raises a bare ValueError, RuntimeError or Exception."""
    tree = ast.walk(ast.parse((SOURCE / module).read_text(encoding="utf-8")))
    for node in tree:
        if isinstance(node, ast.ClassDef) and node.name.endswith("Error"):
            home = importlib.import_module(f"difftrb.{module.removesuffix('.py').replace('/', '.')}")
            assert issubclass(getattr(home, node.name), trb.DifftrbError), node.name
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            assert ast.unparse(node.exc.func) not in {"ValueError", "RuntimeError", "Exception"}, node.lineno


def test_it_is_typed() -> None:
    assert (SOURCE / "py.typed").exists()


def test_names_outlast_the_import_of_rooms() -> None:
    """A room takes its name in the package once it is imported: no public function may have it."""
    assert not set(ROOMS) & set(trb.__all__)
