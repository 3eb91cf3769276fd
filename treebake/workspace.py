"""The work folder of one tree: each stage's result in one file, stamped with what it was made from.

`WORK/stages/NAME.npz` holds one dataclass of arrays with its stamp (what it was made from: the digests of the inputs,
the stage's settings and its code) and its digest (what it holds). A stage whose stamp matches is not run again; a stage
that was redone with the same outcome keeps its digest and so leaves the later ones alone.
"""

import hashlib
import importlib
import json
import os
import zipfile
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from treebake.errors import WorkspaceError
from treebake.files import atomic

T = TypeVar("T")
_PACKAGE = Path(__file__).parent
# What every stage builds on, part of every version.
_GROUND = (
    "model",
    "geometry",
    "flatten",
    "planes",
    "packing",
    "coverage",
    "checks",
    "placements",
    "lookup",
    "leaf_cards",
    "nearest",
    "unwrap",
    "images",
    "compression",
    "pictures",
    "crossed",
    "brightness",
    "gl",
    "tubes",
)
_DAMAGED = (OSError, KeyError, ValueError, TypeError, AttributeError, zipfile.BadZipFile)


class Announce(Protocol):
    """Called around each stage, so that a command can show what is running."""

    def __call__(self, stage: str, *, skipped: bool = False) -> AbstractContextManager[object]:
        """Enter when the stage starts, exit when its result is on the disk."""


class Result(Generic[T]):
    """A value that a stage takes or makes, with the digest of its content; read from disk only when it is used."""

    def __init__(self, digest: str, read: Callable[[], T]) -> None:
        self.digest = digest
        self._read = cache(read)

    @classmethod
    def of(cls, value: T) -> "Result[T]":
        """Wrap a value that is no stage's result. O(bytes)."""
        return cls(_Encoder.of(value).digest, lambda: value)

    @classmethod
    def of_files(cls, files: Sequence[Path], read: Callable[[], T]) -> "Result[T]":
        """What is read from files, known by their bytes. O(bytes)."""
        return cls(_digest([hashlib.sha256(file.read_bytes()).hexdigest() for file in files]), read)

    @classmethod
    def together(cls, results: "Sequence[Result[Any]]") -> "Result[tuple[Any, ...]]":
        """Several results as one, whose value is the tuple of theirs."""
        return Result(_digest([result.digest for result in results]), lambda: tuple(each.value for each in results))

    @property
    def value(self) -> T:
        """The value. Raises WorkspaceError where its file is damaged."""
        return self._read()

    def part(self, name: str) -> "Result[Any]":
        """One field of the value."""
        return Result(f"{self.digest}.{name}", lambda: getattr(self.value, name))


@dataclass(frozen=True)
class Workspace:
    """The work folder at `folder`, made when the first result is written."""

    folder: Path
    force: bool = False  # run every stage, whatever its stamp
    announce: Announce = field(default=lambda _stage, *, skipped=False: nullcontext(skipped))

    def run(self, stage: Callable[..., T], settings: Any, *inputs: Result[Any], name: str = "") -> Result[T]:
        """Return stage(*inputs, settings), from the work folder where it is up to date, else run and kept.

        name: under which it is kept, the stage's own by default. Raises whatever the stage raises, and WorkspaceError
        where the result cannot be written.
        """
        name = name or stage.__name__
        path = self._path(name)
        made_of = [result.digest for result in inputs]
        stamp = _digest([name, made_of, asdict(settings), _code(stage.__module__)])
        with suppress(*_DAMAGED):  # an absent or damaged file is simply made again
            header = _read_header(path)
            if header["stamp"] == stamp and not self.force:
                with self.announce(name, skipped=True), suppress(OSError):
                    os.utime(path)  # tells make that it is up to date
                return Result(header["digest"], lambda: _read_value(path))
        with self.announce(name):
            return self.keep(name, stage(*(result.value for result in inputs), settings), stamp, made_of)

    def keep(self, name: str, value: T, stamp: str = "", made_of: Sequence[str] = ()) -> Result[T]:
        """Write a value into the work folder. Raises WorkspaceError where it cannot be written."""
        encoded = _Encoder.of(value)
        digest = encoded.digest
        header = {"stamp": stamp, "made_of": made_of, "digest": digest, "structure": encoded.structure}
        text = np.frombuffer(json.dumps(header).encode(), np.uint8)
        with atomic(self._path(name)) as file:
            np.savez(file, text, *encoded.arrays, allow_pickle=False)
        return Result(digest, lambda: value)

    def read(self, name: str, command: str, *inputs: Result[Any]) -> Result[Any]:
        """Return what an earlier command left.

        Raises WorkspaceError, naming that command, where it is missing or was made from other inputs than these.
        """
        path = self._path(name)
        try:
            header = _read_header(path)
        except FileNotFoundError as error:
            raise WorkspaceError(f"{self.folder} has no result of {name}; make it with: {command}") from error
        except _DAMAGED as error:
            raise WorkspaceError(f"{path} is damaged; make it again with: {command}") from error
        if inputs and header["made_of"] != [result.digest for result in inputs]:
            raise WorkspaceError(f"{path} is older than what it is made from; finish it with: {command}")
        return Result(header["digest"], lambda: _read_value(path))

    def _path(self, name: str) -> Path:
        return self.folder / "stages" / f"{name}.npz"


@dataclass
class _Encoder:
    """A value as JSON and a list of arrays; an object or array that occurs twice is stored once."""

    objects: list[Any] = field(default_factory=list)
    arrays: list[NDArray[Any]] = field(default_factory=list)
    seen: dict[int, Any] = field(default_factory=dict)  # id -> how it was encoded
    root: Any = None

    @classmethod
    def of(cls, value: Any) -> "_Encoder":
        encoder = cls()
        encoder.root = encoder.encode(value)
        return encoder

    def encode(self, value: Any) -> Any:
        if isinstance(value, Enum):
            return {"enum": [_name(type(value)), value.value]}
        if value is None or isinstance(value, (bool, int, float, str)):
            return value
        if isinstance(value, tuple):
            return [self.encode(item) for item in value]
        if id(value) not in self.seen:
            self.seen[id(value)] = self.encode_object(value)
        return self.seen[id(value)]

    def encode_object(self, value: Any) -> dict[str, int]:
        if isinstance(value, np.ndarray):
            self.arrays.append(np.ascontiguousarray(value))
            return {"array": len(self.arrays) - 1}
        if not is_dataclass(value):
            raise TypeError(f"a stage's result holds a {type(value).__name__}, which is no array and no dataclass")
        self.objects.append([_name(type(value)), {f.name: self.encode(getattr(value, f.name)) for f in fields(value)}])
        return {"object": len(self.objects) - 1}

    @property
    def structure(self) -> list[Any]:
        return [self.objects, self.root]

    @property
    def digest(self) -> str:
        digest = hashlib.sha256(json.dumps(self.structure).encode())
        for array in self.arrays:
            digest.update(f"{array.dtype.str}{array.shape}".encode())
            digest.update(array.data if array.size else b"")
        return digest.hexdigest()


def _read_header(path: Path) -> dict[str, Any]:
    with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
        header: dict[str, Any] = json.loads(file["arr_0"].tobytes())
        return header


def _read_value(path: Path) -> Any:
    try:
        structure = _read_header(path)["structure"]
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            return _decode(structure, [file[name] for name in file.files[1:]])
    except _DAMAGED as error:
        raise WorkspaceError(f"{path} is damaged; run the command that made it again with --force") from error


def _decode(structure: list[Any], arrays: list[NDArray[Any]]) -> Any:
    encoded_objects, root = structure
    objects: list[Any] = []

    def decode(item: Any) -> Any:
        match item:
            case {"array": index}:
                return arrays[index]
            case {"object": index}:
                return objects[index]
            case {"enum": [name, value]}:
                return _class(name)(value)
            case list():
                return tuple(map(decode, item))
            case _:
                return item

    for name, values in encoded_objects:
        objects.append(_class(name)(**{key: decode(value) for key, value in values.items()}))
    return decode(root)


def _name(kind: type[Any]) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _class(name: str) -> Any:
    module, qualified = name.split(":")
    if module.split(".")[0] != "treebake":
        raise ValueError(f"{name} is no class of treebake")
    return getattr(importlib.import_module(module), qualified)


@cache
def _code(module: str) -> str:
    """The version of a stage: a digest of its own file or package, and of what every stage builds on."""
    own = [_PACKAGE.joinpath(*module.split(".")[1:3])]  # treebake.stages.NAME, with what is below it
    if own[0].parent.name == "verify":  # whose parts build on each other, and on how assets are read
        own = [_PACKAGE / room for room in ("verify", "asset", "formats", "meshes", "glb")]
    parts = [*own, *(_PACKAGE / name for name in _GROUND)]
    roots = [root for part in parts for root in (part, part.with_suffix(".py"))]
    files = [file for root in roots for file in ([root] if root.is_file() else sorted(root.rglob("*")))]
    return _digest([[file.name, file.read_text("utf-8")] for file in files if file.suffix in {".py", ".glsl"}])


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
