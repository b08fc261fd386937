"""Processes that stay warm between the jobs of one run of the workflow, so that imports are paid for once a core.

A job is still one command with its own log, exit status and result. Where ``PDHE_WARM`` names a folder, ``python -m
pdhe`` hands its arguments and its output streams to a process that waits there, one for each job that runs at a time,
and starts one if there is none; anything in the way of that, and it does the work itself. Such a process ends with the
run of the workflow it belongs to, whose process number ends the name of the folder. SIGTERM and SIGINT are passed on to
it by the command that waits, so that a solve takes a last checkpoint; when that command is killed, it takes SIGTERM for
it, and ends if that is of no use.
"""

import contextlib
import fcntl
import os
import signal
import socket
import stat
import sys
from collections.abc import Sequence

COMMANDS = ("mesh", "nodes", "solve", "history", "figures", "animate")
"""Commands that a warm process runs: those of which a study has one or more a case."""

MANY_CASES = 8
"""Solutions from which on the workflow keeps processes warm; fewer are solved each in a process of its own."""

MOST_MEMORY = 1 << 30
"""Peak memory in bytes above which a process is not kept."""

_MOST_PROCESSES = 256
_ACCEPTED, _HEADER = b"+", 16
_LOOK_EVERY = 0.5  # s, for the end of the run
_PATIENCE = 15.0  # s, for the end of a command whose caller is gone: more than a solve waits for its next checkpoint


def main(arguments: Sequence[str]) -> int:
    """Run a command line in a warm process where there are such, here otherwise, and return its exit status."""
    folder = os.environ.get("PDHE_WARM")
    if folder and arguments and arguments[0] in COMMANDS:
        status = _delegate(folder, arguments)
        if status is not None:
            return status
    from pdhe.cli import main as run

    return run(arguments)


def folder_for(process: int) -> str:
    """Return the name of the folder of the run of a workflow with this process number."""
    import tempfile

    return os.path.join(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir(), f"pdhe-{os.geteuid()}-{process}")


def _delegate(folder: str, arguments: Sequence[str]) -> int | None:
    """Have a warm process run the arguments; return its exit status, or None if none could be had."""
    lock = None
    try:
        with contextlib.suppress(FileExistsError):
            os.mkdir(folder, 0o700)
        found = os.lstat(folder)
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.geteuid() or found.st_mode & 0o077:
            return None
        lock, place = _free_place(folder)
        connection = _connected(folder, place, arguments)
        if connection is None:
            return None
        with connection:
            status = _wait(connection)
    except OSError:
        return None
    finally:
        if lock is not None:
            os.close(lock)
    if not status:
        sys.stderr.write("error: the process that ran this ended without a word; was there enough memory?\n")
        return 1
    return int(status)


def _wait(connection: socket.socket) -> bytes:
    """Wait for the end of a command, passing signals on to it."""

    def forward(number: int, _: object) -> None:
        with contextlib.suppress(OSError):
            connection.send(bytes([number]))

    heard = [n for n in (signal.SIGTERM, signal.SIGINT) if signal.getsignal(n) is not signal.SIG_IGN]
    before = {number: signal.signal(number, forward) for number in heard}
    try:
        return connection.recv(4)
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def _free_place(folder: str) -> tuple[int, str]:
    """Lock the first place without a job; the lock goes with this process. Threads are part of its name."""
    threads = "".join(filter(str.isalnum, os.environ.get("NUMBA_NUM_THREADS", "")))
    for number in range(_MOST_PROCESSES):
        place = os.path.join(folder, f"{threads}-{number}")
        lock = os.open(f"{place}.lock", os.O_CREAT | os.O_RDWR, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
        else:
            return lock, place
    raise OSError("no free place")


def _connected(folder: str, place: str, arguments: Sequence[str]) -> socket.socket | None:
    """Hand the arguments to the process of a place, or to a new one if there is none or it was about to end."""
    for start in (False, True):
        if start:
            _start(folder, place)
        connection = socket.socket(socket.AF_UNIX)
        try:
            connection.connect(f"{place}.socket")
            body = b"\0".join(map(os.fsencode, (os.getcwd(), *arguments)))
            socket.send_fds(connection, [b"%*d" % (_HEADER, len(body))], [1, 2])
            connection.sendall(body)
            if connection.recv(1) == _ACCEPTED:
                return connection
        except OSError:
            if start:
                raise
        connection.close()
    return None


def _start(folder: str, place: str) -> None:
    """Start the process of a place. It inherits its socket, so that one can connect at once."""
    import subprocess

    with contextlib.suppress(FileNotFoundError):
        os.unlink(f"{place}.socket")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(f"{place}.socket")
        listener.listen(1)
        number = listener.fileno()
        subprocess.Popen(
            [sys.executable, "-m", "pdhe.warm", str(number), folder, place],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=[number],
            start_new_session=True,
        )


def serve(listener: socket.socket, owner: int) -> None:
    """Run one command after the other until the run of the workflow is over or a command failed unforeseen."""
    import resource

    listener.settimeout(_LOOK_EVERY)
    while _alive(owner):
        try:
            connection, _ = listener.accept()
        except TimeoutError:
            continue
        with connection:
            connection.settimeout(None)
            go_on = _serve_one(connection)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
        if not go_on or peak > MOST_MEMORY:
            return


def _serve_one(connection: socket.socket) -> bool:
    """Run one command; tell whether this process is fit for another."""
    import threading

    header, streams, _, _ = socket.recv_fds(connection, _HEADER, 2)
    body = b""
    while len(header) == _HEADER and len(body) < int(header):
        part = connection.recv(int(header) - len(body))
        if not part:
            break
        body += part
    if len(header) < _HEADER or len(body) < int(header):
        return True
    for stream, number in zip(streams, (1, 2), strict=True):
        os.dup2(stream, number)
        os.close(stream)
    folder, *arguments = map(os.fsdecode, body.split(b"\0"))
    connection.sendall(_ACCEPTED)

    done = threading.Event()

    def watch() -> None:
        # What is sent are numbers of signals; the read ends when whoever waits for this command is gone.
        received = b"-"
        while received:
            try:
                received = connection.recv(1)
            except OSError:
                received = b""
            if done.is_set():
                return
            os.kill(os.getpid(), received[0] if received else signal.SIGTERM)
        if not done.wait(_PATIENCE):
            os._exit(1)

    # Outside a command, such as in the instant before it begins, a signal ends the process as it ends any other.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Thread(target=watch, daemon=True).start()
    status, fit = _run(folder, arguments)
    sys.stdout.flush()
    sys.stderr.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for number in (1, 2):
        os.dup2(nowhere, number)
    os.close(nowhere)
    done.set()
    with contextlib.suppress(OSError):
        connection.sendall(b"%d" % status)
    return fit


def _run(folder: str, arguments: Sequence[str]) -> tuple[int, bool]:
    """Run a command line in a folder as a process of its own would: exit status, and whether nothing went wrong."""
    from pdhe.cli import main as run

    try:
        os.chdir(folder)
        return run(arguments), True
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 1, True
    except BaseException:
        import traceback

        traceback.print_exc()
        return 1, False


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _serve_from_command_line() -> None:
    number, folder, place = sys.argv[1:]
    with socket.socket(fileno=int(number)) as listener:
        owner = int(folder.rpartition("-")[2])
        serve(listener, owner)
        if not _alive(owner):
            # Nobody comes any more; the last one out removes the folder.
            for path in (f"{place}.socket", f"{place}.lock"):
                with contextlib.suppress(OSError):
                    os.unlink(path)
            with contextlib.suppress(OSError):
                os.rmdir(folder)


if __name__ == "__main__":
    _serve_from_command_line()
