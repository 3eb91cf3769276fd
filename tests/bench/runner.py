"""Runs `treebake` as a user does, and keeps what several rows share."""

import json
import subprocess
import sys
import time
from functools import cache
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

TREES = Path(__file__).parents[3] / "shared/trees"


_MEASURED = """
import resource, treebake.cli
try:
    treebake.cli.main()
finally:
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2)  # Linux counts in KiB
"""


class NotMeasured(Exception):  # noqa: N818, it is no error
    """Why a row has no figure in this run."""


class Runner:
    """A folder for this run's bakes, and the commands that fill it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self.source = cache(self._source)
        self.asset = cache(self._asset)
        self.scores = cache(self._scores)
        self.light = cache(self._light)
        self.walked: dict[str, Any] = {}  # what `verify --forest` told

    def treebake(self, *arguments: object, allowed: tuple[int, ...] = (0,)) -> Any:
        """Run one command and return its JSON result."""
        command = [sys.executable, "-m", "treebake", *map(str, arguments), "--json", "--quiet"]
        done = subprocess.run(command, check=False, capture_output=True, text=True)
        if done.returncode not in allowed:
            raise RuntimeError(f"{' '.join(command)} failed: {done.stderr.strip()}")
        return json.loads(done.stdout)

    def _source(self, name: str) -> Path:
        """A tree of ../shared/trees, or a grown one by its species."""
        if "." in name:
            if not (TREES / name).exists():
                raise NotMeasured(f"{TREES / name} is absent")
            return TREES / name
        path = self.folder / f"{name}.glb"
        self.treebake("grow", name, "-o", path)
        return path

    def _asset(self, name: str, *options: str, into: str = "bakes") -> Path:
        """Bake a tree, from the first stage on, and return the asset's folder."""
        out = self.folder / into
        return Path(self.treebake("bake", self.source(name), "-o", out, "--force", *options)["asset"])

    def _scores(
        self,
        name: str,
        *options: str,
        into: str = "bakes",
        heights: tuple[int, ...],
        of: str = "cloud",
        sets: tuple[str, ...] = (),
    ) -> dict[int | str, Any]:
        """Verify one representation of a baked tree; returns the figures by height, and of "close" and "turn".

        sets: further flags of the verifier.
        """
        asset = self.asset(name, *options, into=into)
        choices = "--set", f"verify.heights={list(heights)}", "--set", f'verify.representations=["{of}"]', *sets
        found = self.treebake("verify", asset, "--source", self.source(name), *choices, *_configs(options))
        report = found["representations"][of]
        return {row["height"]: row for row in report["heights"]} | {
            "close": report["close_up"],
            "turn": report["turn"],
        }

    def _light(self, name: str, *options: str) -> dict[str, Any]:
        """How a baked tree takes light, by representation."""
        found = self.treebake(
            "verify", self.asset(name, *options), "--source", self.source(name), "--light", *_configs(options)
        )
        return dict(found["representations"])

    def manifest(self, name: str, *options: str, into: str = "bakes") -> Any:
        """The manifest of a baked tree."""
        return json.loads((self.asset(name, *options, into=into) / "manifest.json").read_text())

    def render_seconds(self, name: str) -> float:
        """R: the median time of one 1024 x 1024 render of the source, plain: one sample a pixel, nothing read back."""
        from treebake.gl.context import context
        from treebake.gl.draw import Drawing
        from treebake.gl.light import DAYLIGHT, shine
        from treebake.gl.view import ONE_TREE
        from treebake.meshes import read_mesh
        from treebake.verify.cameras import MARGIN, cameras

        mesh, gl = read_mesh(self.source(name)), context()
        drawing, target = Drawing(mesh), gl.simple_framebuffer((1024, 1024))

        shine(DAYLIGHT)

        def render(view: Any) -> None:
            target.clear()
            with gl.scope(target, gl.DEPTH_TEST):
                drawing.draw_solid(view, target, ONE_TREE)
            gl.finish()

        views = [camera.view(1024 - MARGIN) for camera in cameras(mesh, (0.0, 25.0, 60.0), 8)]
        render(views[0])  # the first one compiles
        return median(_timed(lambda view=view: render(view)) for view in views)

    def bake_memory(self, species: str, leaves: int, *options: str) -> float:
        """The greatest memory, in GB, of a bake of a grown tree with so many leaves."""
        path = self.folder / f"{species}_{leaves}.glb"
        self.treebake("grow", species, "--leaves", leaves, "-o", path)
        bake = ["bake", path, "-o", self.folder / "large", "--force", "-q", *options]
        command = [sys.executable, "-c", _MEASURED, *map(str, bake)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        return float(done.stdout.split()[-1])

    def bake_seconds(self, name: str, *options: str) -> float:
        """The wall time of `treebake bake` from process start to exit."""
        source = self.source(name)
        out = self.folder / "timed"
        return _timed(lambda: self.treebake("bake", source, "-o", out, "--force", *options))


def _configs(options: tuple[str, ...]) -> list[str]:
    return [word for pair in pairwise(options) if pair[0] == "--config" for word in pair]


def _timed(work: Any) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
