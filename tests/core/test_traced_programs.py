"""Programs are traced once for all processes, and never taken for another."""

import os
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from difftrb.core import jax_config, series
from difftrb.core import user_cache as things
from difftrb.core.traced_programs import kept
from difftrb.fits import batched_misfit


class Both(NamedTuple):
    twice: Any
    square: Any


def of(folder: Path, traced: list[int], depends: Any, *arguments: Any) -> Any:
    """What a program of these arguments returns, kept in a folder; `traced` gets longer when it is traced."""

    def both(x: Any, more: dict[str, Any]) -> Both:
        traced.append(1)
        return Both(2.0 * x, {"all": jnp.sum(x * x) + more["y"]})

    program = kept(folder, both, depends, arguments, {})
    return None if program is None else program(*arguments)


def files(folder: Path) -> list[Path]:
    return [file for file in folder.rglob("*") if file.is_file()]


def test_it_is_traced_once(tmp_path: Path) -> None:
    traced: list[int] = []
    x = np.arange(3.0)
    for _ in range(3):
        found = of(tmp_path, traced, "this", x, {"y": 1.0})
        assert isinstance(found, Both)
        np.testing.assert_array_equal(found.twice, 2.0 * x)
        assert float(found.square["all"]) == 6.0
    assert len(traced) == 1
    assert len(files(tmp_path)) == 1


def test_what_differs_is_another_program(tmp_path: Path) -> None:
    traced: list[int] = []
    x, y = np.arange(3.0), {"y": 1.0}
    half, third = (lambda n: lambda v: v / n)(2.0), (lambda n: lambda v: v / n)(3.0)
    own = jax_config.quick
    every = [("this", x, y), ("that", x, y), ("this", np.arange(4.0), y), ("this", x.astype(np.float32), y),
             ("this", x, {"y": np.float64(1.0)}), ("this", x, y | {"z": 2.0}), (own, x, y), (jax_config.OPTIONS, x, y),
             ((own, 1), x, y)]  # fmt: skip
    for depends, *arguments in every:
        of(tmp_path, traced, depends, *arguments)
    assert len(traced) == len(files(tmp_path)) == len(every)
    for depends in (half, third, Both, of):  # no telling whether they will be the same
        assert of(tmp_path, traced, depends, x, y) is None
    assert len(files(tmp_path)) == len(every)


@pytest.mark.hard
@pytest.mark.parametrize("broken", [b"", b"nothing", None])
def test_what_is_broken_is_written_again(broken: bytes | None, tmp_path: Path) -> None:
    traced: list[int] = []
    for _ in range(2):
        assert of(tmp_path, traced, "this", np.ones(2), {"y": 0.0}) is not None
    (file,) = files(tmp_path)
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2] if broken is None else broken)
    assert of(tmp_path, traced, "this", np.ones(2), {"y": 0.0}) is not None
    assert len(traced) == 2
    assert file.stat().st_size == len(whole)


@pytest.mark.hard
def test_programs_of_older_contents_of_the_package_go(tmp_path: Path) -> None:
    for name, days in (("old", 31), ("recent", 1)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "program").write_bytes(b"")
        then = time.time() - 86400.0 * days
        os.utime(tmp_path / name, (then, then))
    of(tmp_path, [], "this", np.arange(3.0), {"y": 1.0})
    assert not (tmp_path / "old").exists()
    assert (tmp_path / "recent" / "program").exists()
    assert len(files(tmp_path)) == 2


def test_where_nothing_can_be_written_it_runs(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    assert of(tmp_path / "file", [], "this", np.ones(2), {"y": 0.0}) is not None


@pytest.fixture
def keeping(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which the package keeps what it traces."""
    monkeypatch.setattr(things, "_folder", [tmp_path])
    return tmp_path


def test_the_packages_own_are_kept(keeping: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: Any) -> None:
        raise AssertionError("traced again")

    batched_misfit._rest.clear_cache()  # type: ignore[attr-defined]
    first = batched_misfit._rest(np.ones(5))
    assert len(files(keeping)) == 1
    batched_misfit._rest.clear_cache()  # type: ignore[attr-defined]
    monkeypatch.setattr(jax.export, "export", never)
    second = batched_misfit._rest(np.ones(5))
    assert jax.tree.structure(first) == jax.tree.structure(second)
    jax.tree.map(np.testing.assert_array_equal, first, second)
    batched_misfit._rest.clear_cache()  # type: ignore[attr-defined]


def test_within_another_program_it_is_traced_as_ever(keeping: Path) -> None:
    @jax_config.jit_quickly()
    def twice(x: Any) -> Any:
        return 2.0 * x

    assert float(jax.jit(lambda: twice(np.ones(())))()) == 2.0
    assert float(jax.grad(twice)(1.0)) == 2.0
    np.testing.assert_array_equal(jax.vmap(twice)(jnp.ones(2)), 2.0 * np.ones(2))


def test_errors_are_those_of_the_function(keeping: Path) -> None:
    @jax_config.jit_quickly(static_argnames=("name",))
    def fails(x: Any, name: str) -> Any:
        raise KeyError(name)

    with pytest.raises(KeyError, match="what it says"):
        fails(1.0, name="what it says")
    assert not files(keeping)


@pytest.fixture
def polynomial(keeping: Path) -> Any:
    """A function of the package whose programs are kept within others, too."""
    return jax_config.jit_quickly(static_argnames=("order",), within=True)(series.derivative)


def test_within_another_program_it_is_read(polynomial: Any, keeping: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    c, x = np.array([1.0, -2.0, 0.5]), np.array(0.7)
    first = jax.jit(lambda x: 3.0 * polynomial(c, x, order=0))(x)
    assert len(files(keeping)) == 1
    polynomial.clear_cache()
    monkeypatch.setattr(jax.export, "export", None)  # nothing is traced again
    assert float(jax.jit(lambda x: 3.0 * polynomial(c, x, order=0))(x)) == float(first) == pytest.approx(-0.465)
    assert len(files(keeping)) == 1


@pytest.mark.gradient
def test_within_another_program_it_is_differentiated_and_mapped_as_ever(polynomial: Any, keeping: Path) -> None:
    c, x = np.array([1.0, -2.0, 0.5, 2.0]), np.linspace(-1.0, 1.0, 5)
    within = jax.jit(lambda x: polynomial(c, x, order=0))
    for order, found in enumerate((within, jax.grad(within), jax.hessian(within))):
        exact = series.derivative(c, x, order)
        np.testing.assert_allclose(jax.vmap(found)(x), exact, rtol=1e-14)
        np.testing.assert_allclose(jax.jit(jax.vmap(found))(x), exact, rtol=1e-14)
    one = jax.jit(lambda c: polynomial(c, x[0], order=0))
    np.testing.assert_allclose(jax.vmap(jax.grad(one))(np.stack([c, 2.0 * c])), np.tile(x[0] ** np.arange(4.0), (2, 1)))
    assert len(files(keeping)) == 1
