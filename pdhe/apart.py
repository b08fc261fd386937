"""Work in a process of its own, for libraries that hear of no signal until they are done.

Python looks at signals between two of its instructions, and one call of gmsh may take minutes. Here the process that
was told to do something waits, hears the signal at once and ends the one that works.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable

from pdhe.errors import PdheError

_DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG of prctl(2)


def apart(work: Callable[[], None]) -> None:
    """Do something in a fork of this process, which ends at once when this one is interrupted.

    On systems other than Linux and in threads, which hear of no signals, it is done in this process. What it changes
    outside of files is lost; what this process writes to files at the same time is not its own.

    Parameters
    ----------
    work
        What to do. It must not use threads of its own, nor locks that other threads may hold.

    Raises
    ------
    PdheError, OSError, MemoryError
        As ``work`` raises them.
    PdheError
        If the process is ended from outside, or crashes.
    RuntimeError
        For any other error of ``work``, with its traceback as text.
    """
    if not sys.platform.startswith("linux") or threading.current_thread() is not threading.main_thread():
        work()
        return
    origin = os.getpid()
    reading, writing = os.pipe()
    child: int | None = os.fork()
    if child == 0:
        _work_and_end(work, writing, origin)
    try:
        os.close(writing)
        with os.fdopen(reading, "rb") as stream:
            told = stream.read()
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        child = None
    finally:
        if child is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
            with contextlib.suppress(ChildProcessError):
                os.waitpid(child, 0)
    if status < 0:
        raise PdheError(f"the process that did this ended by {signal.Signals(-status).name}; was there enough memory?")
    _raise(json.loads(told))


def _work_and_end(work: Callable[[], None], writing: int, origin: int) -> None:
    """Do the work and end the process, telling the one that waits how it went."""
    told: dict[str, object] = {"kind": "other", "text": "nothing was told"}
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, signal.SIG_DFL)
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL, 0, 0, 0)
        if os.getppid() == origin:
            work()
            told = {"kind": "done"}
    except PdheError as error:
        told = {"kind": "refused", "text": str(error)}
    except OSError as error:
        place = error.filename if error.filename is None else os.fsdecode(error.filename)
        told = {"kind": "system", "number": error.errno, "text": error.strerror or str(error), "place": place}
    except MemoryError as error:
        told = {"kind": "memory", "text": str(error)}
    except BaseException:
        told = {"kind": "other", "text": traceback.format_exc()}
    finally:
        # Nothing of what the other process has open or still to do at its end is this one's.
        with contextlib.suppress(OSError):
            os.write(writing, json.dumps(told).encode())
        os._exit(0)


def _raise(told: dict) -> None:
    if told["kind"] == "refused":
        raise PdheError(told["text"])
    if told["kind"] == "system":
        raise OSError(told["number"], told["text"], told["place"])
    if told["kind"] == "memory":
        raise MemoryError(told["text"])
    if told["kind"] != "done":
        raise RuntimeError(told["text"])
