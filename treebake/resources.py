"""Where the files that ship beside the code are: `data/` and `configs/`."""

from pathlib import Path

from treebake.errors import SettingsError

_PACKAGE = Path(__file__).parent


def resource(relative: str) -> Path:
    """The path of a shipped file, e.g. "data/chestnut.toml"; inside the package when installed, beside it in a clone.

    Raises SettingsError where there is no such file.
    """
    for root in (_PACKAGE, _PACKAGE.parent):
        if (root / relative).exists():
            return root / relative
    raise SettingsError(f"{relative} is not part of this treebake installation; reinstall treebake")
