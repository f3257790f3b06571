"""The examples of docs/bearings.md and docs/stiffness.md run."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

from difftrb.scene import scene_file

DOCS = Path(__file__).parents[2] / "docs"


def snippets(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.portable
@pytest.mark.parametrize("page", ["bearings.md", "stiffness.md"])
def test_pages_run(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    names: dict = {}
    for text in snippets(page, "python"):
        if "import ross" in text:
            continue
        exec(compile(text, page, "exec"), names)
    assert capsys.readouterr().out


def test_scene_files_are_in_order() -> None:
    for text in snippets("bearings.md", "toml"):
        file = scene_file.parse(text + "[load]\nradial = 5000.0\naxial = 2500.0\n")
        assert file.catalogue is not None


@pytest.mark.skipif(importlib.util.find_spec("ross") is None, reason="ROSS is not installed")
def test_the_rotor_runs() -> None:
    text = "\n".join(snippets("stiffness.md", "python"))
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr[-2000:]


def test_optional_libraries_are_not_imported() -> None:
    text = "import sys, difftrb; difftrb.stiffness, difftrb.ross; print({'ross', 'xarray'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.strip() == "set()"
