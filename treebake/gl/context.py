"""The one OpenGL context of the process, off-screen (EGL, OpenGL 3.3 core)."""

from functools import cache
from pathlib import Path

import moderngl

from treebake.errors import GraphicsError

_SHADERS = Path(__file__).parent / "shaders"

# Where all shaders find what lights them.
LIGHT_BLOCK = 0
SHADOW_UNIT = 15


@cache
def context() -> moderngl.Context:
    """Open the off-screen context on first use and return it.

    The library names carry their version because Debian ships the unversioned ones in -dev packages only.

    Raises GraphicsError where EGL or OpenGL cannot be loaded.
    """
    try:
        gl = moderngl.create_context(
            require=330, standalone=True, backend="egl", libgl="libGL.so.1", libegl="libEGL.so.1"
        )
    except Exception as error:
        raise GraphicsError(
            f"no off-screen OpenGL 3.3 on this machine ({error}); on Debian or Ubuntu install it with: "
            "apt-get install libegl1 libgl1 libgl1-mesa-dri"
        ) from error
    gl.gc_mode = "auto"
    return gl


def leave_framebuffer() -> None:
    """Bind a framebuffer that stays, before the one in use is freed: a scope goes back to what was bound before it."""
    _nowhere().use()


@cache
def _nowhere() -> moderngl.Framebuffer:
    return context().simple_framebuffer((1, 1))


def program(name: str, *defines: str) -> moderngl.Program:
    """Compile `shaders/NAME.glsl`: both stages in one file, told apart by VERTEX_STAGE and FRAGMENT_STAGE.

    A line `#include "other.glsl"` is replaced by that file. defines: names of a variant; a software renderer runs both
    sides of every branch, so what is drawn in another way is a variant and no branch.
    """
    return _program(context(), name, *defines)


@cache
def _program(gl: moderngl.Context, name: str, *defines: str) -> moderngl.Program:
    source = "".join(f"#define {define}\n" for define in defines) + _source(f"{name}.glsl")
    head = "#version 330 core\n#define {}_STAGE\n"
    made = gl.program(vertex_shader=head.format("VERTEX") + source, fragment_shader=head.format("FRAGMENT") + source)
    if "Light" in made:
        made["Light"].binding = LIGHT_BLOCK
    if "shadow_map" in made:
        made["shadow_map"] = SHADOW_UNIT
    return made


def _source(name: str) -> str:
    lines = (_SHADERS / name).read_text(encoding="utf-8").split("\n")
    return "\n".join(_source(line.split('"')[1]) if line.startswith("#include") else line for line in lines)
