"""The real trees that some tests use, and a visible skip where they are absent."""

from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / ".." / "shared" / "trees"


def tree(name: str) -> Path:
    """The path of a real tree, such as "ez_oak_large.glb"; skips the test where the trees are not there."""
    path = (FOLDER / name).resolve()
    if not path.exists():
        pytest.skip(f"needs the real tree {name} in ../shared/trees")
    return path
