"""Files that appear whole or not at all, end with a digest of all their bytes, and are checked when they are read.

The digest, the seal, is a comment in the format of gmsh. HDF5 and zip ignore what follows their end, so that one form
serves meshes, arrays and checkpoints, and every program that reads these formats still does. It is checked before any
library takes a file apart: a flipped bit in the structure of a file makes some fail, hang or read other numbers.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import re
import shutil
import struct
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pdhe.errors import PdheError

_SEAL = b"$Comments\npdhe-sha256 %s\n$EndComments\n"
_PATTERN = re.compile(re.escape(_SEAL).replace(b"%s", rb"([0-9a-f]{64})"))
_LENGTH = len(_SEAL % bytes(64))
_PIECE = 1 << 20
_ELF, _HEAD = b"\x7fELF\x02\x01", 64
"""First bytes of libraries of Linux with 64 bits, little end first, and the length of their header."""
PART = re.compile(r"\..+\.(?P<process>\d+)\.\d+\.part(\.\w+)?")
"""Names of files that are being written, with the number of the process that writes them."""


@contextlib.contextmanager
def moved_when_whole(path: str | os.PathLike[str], sealed: bool = False, ending: str = "") -> Iterator[Path]:
    """Give a name to write to, which is moved to its place afterwards, or removed where writing fails.

    Parameters
    ----------
    path
        The place; a link is followed. Devices and pipes are written to as they are.
    sealed
        Append a seal, and wait until all is on the disk.
    ending
        Of the name to write to, for programs that ask for one.

    Raises
    ------
    OSError
        Naming the place, if writing fails.
    """
    if os.path.exists(path) and not os.path.isfile(path):  # noqa: PTH110, PTH113 - any kind of path
        yield Path(path)
        return
    place = Path(os.path.realpath(path))
    temporary = place.with_name(f".{place.name}.{os.getpid()}.{threading.get_ident()}.part{ending}")
    try:
        yield temporary
        if sealed:
            seal(temporary)
        temporary.replace(place)
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(temporary), os.fsencode(temporary)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        with contextlib.suppress(OSError):
            # Whoever failed to write it may still hold it open: this gives its space back all the same.
            os.truncate(temporary, 0)
            temporary.unlink()


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text in UTF-8, whole or not at all."""
    with moved_when_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="")


def copy(source: Path, path: Path) -> None:
    """Copy a file, whole or not at all."""
    with moved_when_whole(path) as temporary:
        shutil.copyfile(source, temporary)


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object from a file that a command wrote; raise :class:`PdheError` naming it if it is damaged."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(content, dict):
            raise ValueError("no object")
    except ValueError as error:
        raise PdheError(f"{path}: not a usable file ({error}); delete it and run again") from error
    return content


def seal(path: Path) -> None:
    """Append the seal to a file, and wait until all of it is on the disk."""
    with path.open("rb+") as file:
        total = _digest(file, path.stat().st_size)
        file.seek(0, os.SEEK_END)
        file.write(_SEAL % total.encode())
        file.flush()
        os.fsync(file.fileno())


def intact(path: str | os.PathLike[str]) -> bool | None:
    """Tell whether the content of a file is the one that was sealed; None if it has no seal.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    with open(path, "rb") as file:  # noqa: PTH123 - any kind of path
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - _LENGTH))
        found = _PATTERN.fullmatch(file.read())
        return None if found is None else _digest(file, size - _LENGTH) == found[1].decode()


def damaged_library(path: str | os.PathLike[str]) -> bool:
    """Tell whether a shared library is not the one that was sealed, or is cut off, as far as that can be seen.

    Of one without a seal, the file is held against the place of its last part, the table of its sections, where it is
    one of Linux with 64 bits. A loader maps what is missing all the same, and the process ends without a word. What is
    no library at all is left to the loader.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    with open(path, "rb") as file:  # noqa: PTH123 - any kind of path
        head, size = file.read(_HEAD), file.seek(0, os.SEEK_END)
    if intact(path) is False:
        return True
    if len(head) < _HEAD or not head.startswith(_ELF):
        return False
    (table,), (each, count) = struct.unpack_from("<Q", head, 40), struct.unpack_from("<HH", head, 58)
    return size < table + each * count


def why_not_written(path: Path, problem: str) -> OSError:
    """Return the error that a library did not tell apart, by writing some more to a file that it failed to write."""
    try:
        with path.open("ab") as file:
            file.write(bytes(_PIECE))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        return error
    return OSError(f"{problem}; was there enough space?")


def check_place(path: str | os.PathLike[str]) -> None:
    """Make the folder of a place, and raise the :class:`OSError` with which writing a file there would fail, if any."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    if os.path.isdir(path):  # noqa: PTH112 - any kind of path
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    with contextlib.suppress(_Tried), moved_when_whole(path) as temporary:
        if temporary != Path(path):
            temporary.touch()
        raise _Tried


class _Tried(Exception):
    """Nothing is to be written."""


def _digest(file, size: int) -> str:
    total = hashlib.sha256()
    file.seek(0)
    while size > 0 and (piece := file.read(min(size, _PIECE))):
        total.update(piece)
        size -= len(piece)
    return total.hexdigest()
