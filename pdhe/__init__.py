"""pdhe: reproducible studies of hydrogen-assisted fracture."""

import importlib

_OFFERED = {"open_study": "pdhe.collection"}
"""What can be had from the package itself, and where it is: loaded when it is asked for, as it takes half a second."""

__all__ = ["open_study"]


def __getattr__(name: str) -> object:
    if name in _OFFERED:
        return getattr(importlib.import_module(_OFFERED[name]), name)
    raise AttributeError(f"module 'pdhe' has no attribute '{name}'")
