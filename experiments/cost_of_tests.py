"""What tests cost: the dearest with the seconds of processors that they take, and the programs that they need.

    python -m pytest -m "" -p experiments.cost_of_tests

Seconds of processors are those of a test's process and of what it started, compiling included; what else runs on the
machine hardly changes them. Fixtures that several tests share count for the first. As seconds pass: `--durations=15`.
"""

import os
from collections.abc import Iterator
from typing import Any

import pytest

SHOWN = 15
COMPILED = "/jax/core/compile/backend_compile_duration"
"""JAX's event for a program that is needed: compiled, or read from those that are kept."""

began: list[float] = []
programs: list[str] = []
costs: dict[str, tuple[float, int]] = {}


def spent() -> float:
    """Seconds of processors of this process and of its children that have ended [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def pytest_collection_finish() -> None:
    import jax  # not before conftest.py has said where programs are kept

    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: programs.append(event) if event == COMPILED else None
    )


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_logstart() -> None:
    programs.clear()
    began[:] = [spent()]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Iterator[None]:
    try:
        yield
    finally:  # also of one that fails
        item.user_properties.append(("cost", (spent() - began[0], len(programs))))  # type: ignore[arg-type]


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.when == "teardown":
        costs[report.nodeid] = dict(report.user_properties)["cost"]  # type: ignore[assignment]


def pytest_terminal_summary(terminalreporter: Any) -> None:
    every = sorted(costs.items(), key=lambda cost: -cost[1][0])
    total, needed = (sum(cost[k] for _, cost in every) for k in (0, 1))
    terminalreporter.section(f"{len(every)} tests took {total:.0f} s of processors and {needed} programs")
    for name, (seconds, count) in every[:SHOWN]:
        terminalreporter.write_line(f"{seconds:6.1f} s  {count:4d} programs  {name}")
