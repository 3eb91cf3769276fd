"""Khronos' glTF validator for tests: skips visibly where node or the npm package is absent."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

_HERE = Path(__file__).parent


def assert_valid(*paths: Path) -> None:
    """Assert that each GLB file has no error and no warning."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed, so the glTF validator cannot run")
    if not (_HERE / "node_modules/gltf-validator").exists():
        pytest.skip("the glTF validator is not installed: run `npm ci` in tests/")
    command = ["node", str(_HERE / "gltf_validate.mjs"), *map(str, paths)]
    reports = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    assert len(reports) == len(paths)
    for path, report in reports.items():
        assert (report["errors"], report["warnings"]) == (0, 0), f"{path}: {report['messages']}"
