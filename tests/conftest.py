"""Tests lie in rooms as the package does; their kinds are markers: exact, order, gradient, literature, hard."""

import gc
import os
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

# from jax 0.11 on there are none, and XLA ends a process that names a flag which it does not know
OLD = tuple(map(int, version("jaxlib").split(".")[:2])) < (0, 11)
OLDER_EMITTERS = " --xla_cpu_use_fusion_emitters=false" if OLD else ""

# JAX reads these when it is imported: programs are shared by all processes of a run and kept for the next one, the
# smallest, too, which take 30 ms to compile and 5 to read; the processes that tests start do likewise
KEPT = {
    "JAX_COMPILATION_CACHE_DIR": str(Path(__file__).parents[1] / ".pytest_cache" / "programs"),
    "XDG_CACHE_HOME": str(Path(__file__).parents[1] / ".pytest_cache" / "user"),  # what commands trace, as well
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "0",
    # what is compiled here runs a few times; processes that tests start compile the package's own programs as for users
    "XLA_FLAGS": "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
    " --xla_cpu_parallel_codegen_split_count=1 --xla_cpu_prefer_vector_width=128" + OLDER_EMITTERS,  # a fifth less
    "JAX_TRACEBACK_IN_LOCATIONS_LIMIT": "0",  # where a line of a program comes from, which nobody reads: a tenth
    "OPENBLAS_NUM_THREADS": "1",  # threads of several processes wait for each other: ten times as long for small ones
    "TF_CPP_MIN_LOG_LEVEL": "3",  # else XLA reports its own tuning hints whenever it loads a kept program
}
for name, value in KEPT.items():
    os.environ.setdefault(name, value)

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
gc.set_threshold(50_000, 20, 100)  # tracing makes many objects: looking through them takes a tenth of the time

import difftrb as trb
from difftrb.core import jax_config, user_cache
from difftrb.law import samples
from experiments.programs import let_go
from tests.closed_form import closed_form

jax_config.OPTIONS.update(xla_backend_optimization_level=0, xla_llvm_disable_expensive_passes=True)


@pytest.fixture(scope="module", autouse=True)
def _few_programs() -> Iterator[None]:
    """A worker that keeps all of them crashes."""
    yield
    let_go(25_000)


@pytest.fixture(scope="module")
def compiled_as_for_users() -> Iterator[None]:
    """For programs that run hundreds of times, or more."""
    patch = pytest.MonkeyPatch()
    patch.setitem(jax_config.OPTIONS, "xla_backend_optimization_level", 1)
    patch.setitem(jax_config.OPTIONS, "xla_llvm_disable_expensive_passes", False)
    jax_config.quick.cache_clear()
    yield
    patch.undo()
    jax_config.quick.cache_clear()


@pytest.fixture(autouse=True)
def _nothing_kept_as_traced() -> Iterator[None]:
    """A command keeps programs from there on; a test that replaces a function would get, or leave, one that does not
    know."""
    yield
    user_cache._folder.clear()


@pytest.fixture(scope="session")
def bearing() -> trb.TaperedBearing:
    return trb.bearing("32008J")


@pytest.fixture(scope="session")
def contact(bearing: trb.TaperedBearing) -> trb.LineContact:
    return trb.LineContact.of(bearing, "outer", design_load=6500.0)


@pytest.fixture(scope="session")
def power(contact: trb.LineContact) -> trb.PowerLaw:
    """A law fitted once for all tests, for the roller loads of 9000/4500 N."""
    return trb.power_law(contact, (270.0, 1970.0), accuracy=1e-2)


@pytest.fixture(scope="session")
def scene(bearing: trb.TaperedBearing, power: trb.PowerLaw) -> trb.Scene:
    """The main job's bearing, load and spall, with a prepared law."""
    return trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), law=power)


@pytest.fixture(scope="module")
def closed() -> Iterator[list]:
    """The solver replaced by the closed form; what was solved so far."""
    patch = pytest.MonkeyPatch()
    solves = []
    patch.setattr(samples, "solved", lambda *a: (solves.append(a), closed_form(*a))[1])
    yield solves
    patch.undo()
