"""Files appear whole or not at all."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from treebake.errors import WorkspaceError


def cache_folder() -> Path | None:
    """Where files are kept that can be made again: treebake/ in the user's cache folder; None without a home."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "treebake"
    except RuntimeError:
        return None


@contextmanager
def atomic(path: Path) -> Iterator[BinaryIO]:
    """Open a file for writing that takes the name `path` only once it is complete and on the disk.

    Missing parent folders are made. Whatever interrupts the writing, an older file of that name stays as it was and no
    temporary file stays behind. Raises WorkspaceError where it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
            try:
                yield file  # type: ignore[misc]  # the wrapper of tempfile is a BinaryIO in all but name
                file.flush()
                os.fsync(file.fileno())
                Path(file.name).chmod(0o644)
                Path(file.name).replace(path)
            except BaseException:
                Path(file.name).unlink(missing_ok=True)
                raise
    except OSError as error:
        why = error.strerror or str(error)
        raise WorkspaceError(f"{path} cannot be written ({why}); choose a writable folder with free space") from error
