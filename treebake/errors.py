"""Every error that treebake raises on purpose.

TreebakeError                 the one base class that the command line catches (exit 2)
├── InputError                the given file cannot be used
│   ├── MeshError             not a mesh, empty, non-finite, index out of range ...
│   └── UnsupportedError      a named feature of the format that treebake does not decode
├── SettingsError             an unknown key, a value out of range, settings that contradict
├── BudgetError               the result does not fit: atlas too small, triangle budget unreachable
├── WorkspaceError            the work folder is missing a stage, or its output cannot be written
├── AssetError                a published asset that is damaged or of an unknown version
└── GraphicsError             no usable OpenGL, or the driver refused

A message says what is wrong, where, and what to do about it, in one line.
"""


class TreebakeError(Exception):
    """Base of every error that treebake raises on purpose; its text is one line for the user."""


class InputError(TreebakeError):
    """The given file cannot be used."""


class MeshError(InputError):
    """The file was read, and what it holds is not a usable triangle mesh."""


class UnsupportedError(InputError):
    """The file needs a named feature that treebake does not decode."""


class SettingsError(TreebakeError):
    """A setting is unknown, out of range, or contradicts another."""


class BudgetError(TreebakeError):
    """The result does not fit into the asked budget."""


class WorkspaceError(TreebakeError):
    """The work folder lacks a stage's result, or an output cannot be written."""


class AssetError(TreebakeError):
    """A published asset is damaged, incomplete or of an unknown version."""


class GraphicsError(TreebakeError):
    """No usable OpenGL, or the driver refused a request."""
