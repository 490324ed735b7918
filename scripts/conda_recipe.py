"""Write the recipe of the conda package, for all systems, from pyproject.toml: rattler-build build -r FOLDER.

The package is made of the sdist, which lies beside the folder.

Usage: python -m scripts.conda_recipe FOLDER
"""

import json
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
CONDA_NAMES = {"dask": "dask-core", "matplotlib": "matplotlib-base"}
"""Names of packages on conda-forge that differ from those on PyPI."""


def conda_requirement(requirement: str) -> str:
    """Return a requirement of pyproject.toml as conda spells it: ``dask>=2025.1`` as ``dask-core >=2025.1``."""
    name, bounds = re.fullmatch(r"([\w-]+)(.*)", requirement).groups()  # type: ignore[union-attr]
    return f"{CONDA_NAMES.get(name, name)} {bounds}"


def conda_recipe() -> dict[str, Any]:
    """Return the recipe as the tables of its YAML file."""
    text = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    project = text["project"]
    name, version, python = project["name"], project["version"], f"python {project['requires-python']}"
    return {
        "package": {"name": name, "version": version},
        "source": {"path": f"../{name.replace('-', '_')}-{version}.tar.gz"},
        "build": {
            "noarch": "python",
            "script": "python -m pip install . --no-deps --no-build-isolation -vv",
            "python": {"entry_points": [f"{command} = {entry}" for command, entry in project["scripts"].items()]},
        },
        "requirements": {
            "host": [python, "pip", *map(conda_requirement, text["build-system"]["requires"])],
            "run": [python, *map(conda_requirement, project["dependencies"])],
        },
        "tests": [
            {"python": {"imports": ["atlas", "workers"]}},
            {"script": ["atlas systems", "atlas point --set omega=4 --set b=0.15"]},
        ],
        "about": {"summary": project["description"], "license": project["license"], "license_file": "LICENSE"},
    }


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "recipe.yaml").write_text(json.dumps(conda_recipe(), indent=2) + "\n", encoding="utf-8")  # YAML, too
    print(folder / "recipe.yaml")
