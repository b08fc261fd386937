"""Compiled Abaqus user materials (UMAT): built from their source, loaded, called point by point.

What they are given: stresses and state variables at the start of an increment, small strains and their increments in
the order of Abaqus (11, 22, 33, 12, 13, 23; shear as the angle), deformation gradients, a field variable, no rotation,
no temperature.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numba
import numpy as np

from pdhe.errors import PdheError, SimulationError
from pdhe.kernels import umat as kernels
from pdhe.kernels.jit import as_float
from pdhe.provenance import digest
from pdhe.scene_umat import content_of
from pdhe.wholefile import damaged_library, intact, moved_when_whole

#: Stress components by what is assumed across the plate; None is a solid.
COMPONENTS = {"stress": 3, "strain": 4, None: 6}
#: Length of a material's name in Abaqus.
NAME = 80
#: Without contraction results are the same on all machines; without static locals a routine may run on all threads.
_FORTRAN = ("-O2", "-fPIC", "-shared", "-ffp-contract=off", "-frecursive")
#: By ending of a source: variable that names another compiler, compilers to look for, what they are told.
COMPILERS: dict[str, tuple[str, tuple[str, ...], tuple[str, ...]]] = {
    ".c": ("CC", ("cc", "gcc", "clang"), ("-O2", "-fPIC", "-shared", "-ffp-contract=off")),
    ".f": ("FC", ("gfortran",), (*_FORTRAN, "-ffixed-line-length-132")),
    ".for": ("FC", ("gfortran",), (*_FORTRAN, "-ffixed-line-length-132")),
    ".f90": ("FC", ("gfortran",), (*_FORTRAN, "-ffree-line-length-none")),
}
#: What user materials find in Abaqus.
_HEADER = "      implicit real*8 (a-h, o-z)\n      parameter (nprecd=2)\n"
_SHIM = "#include <stdlib.h>\n__attribute__((weak)) void xit_(void) { exit(42); }\n"
#: Whether libraries get a seal: the loader of Linux minds no bytes after the end.
SEALED = sys.platform.startswith("linux")
#: Strain of trial calls but the first, and the seconds after which they are given up.
TRIAL_STRAIN, TRIAL_TIME = 1e-8, 60


def build(source: Path, folder: Path | None = None) -> Path:
    """Compile a user material, unless this has been done before.

    Parameters
    ----------
    source
        ``.c``, ``.f``, ``.for`` (fixed form) or ``.f90`` (free form). ``ABA_PARAM.INC`` and ``XIT`` are there.
    folder
        Where libraries are kept, by the digest of source, files that it includes, compiler and options; the user's
        cache when None. One that is damaged is made anew.

    Returns
    -------
    Path
        The shared library.

    Raises
    ------
    PdheError
        Without a compiler, or with what it said.
    """
    source = Path(source)
    if source.suffix.lower() not in COMPILERS:
        raise PdheError(f"{source}: a user material is a {', '.join(COMPILERS)} or a compiled library (.so)")
    variable, names, options = COMPILERS[source.suffix.lower()]
    compiler = _compiler(source, variable, names)
    try:
        text = content_of(source)
        version = subprocess.run([*compiler, "--version"], capture_output=True, check=False).stdout
    except OSError as error:
        raise PdheError(f"{source}: cannot be compiled: {error}") from error
    if folder is None:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pdhe" / "umat"
    key = digest([text, version.hex(), *compiler, *options, _HEADER, _SHIM], 32)
    library = Path(folder) / f"{key}.so"
    if library.is_file() and (intact(library) or not SEALED):
        return library
    library.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as place, moved_when_whole(library, SEALED) as temporary:
        for name in ("ABA_PARAM.INC", "aba_param.inc"):
            Path(place, name).write_text(_HEADER)
        Path(place, "shim.c").write_text(_SHIM)
        done = subprocess.run(
            [*compiler, *options, "-I", place, "-I", str(source.resolve().parent), "-o", str(temporary.resolve()),
             str(source.resolve()), str(Path(place, "shim.c")), "-lm"],
            capture_output=True, text=True, errors="replace", check=False,
        )  # fmt: skip
        if done.returncode:
            raise PdheError(f"{source}: {' '.join(compiler)} does not compile it:\n{done.stderr.strip()[-2000:]}")
    return library


def _compiler(source: Path, variable: str, names: tuple[str, ...]) -> list[str]:
    given = shlex.split(os.environ.get(variable, ""))
    for words in [given] if given else [[name] for name in names]:
        if shutil.which(words[0]):
            return words
    raise PdheError(
        f"{source}: no compiler for it ({' '.join(given) or ', '.join(names)}); install one, name it in {variable}, "
        "or give a compiled library (.so)"
    )


@dataclass(frozen=True)
class UserMaterial:
    """A compiled user material with its constants.

    Attributes
    ----------
    library, symbol
        Shared library, and the routine in it.
    name
        What it is told as CMNAME, in capitals.
    properties
        As many as it asks for, in its own units: stresses in Pa if the body is in SI.
    state
        Initial values of its state variables.
    plane
        ``strain`` (NDI = 3, NSHR = 1), ``stress`` (2, 1) or None for a solid (3, 3).
    """

    library: Path
    name: str
    properties: tuple[float, ...] = ()
    state: tuple[float, ...] = ()
    plane: str | None = "strain"
    symbol: str = "umat_"
    address: int = field(default=0, compare=False)

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z][!-~]{0,79}", self.name):
            raise PdheError(
                f"user material: name {self.name!r}: needs a letter first, then up to 79 ASCII without blanks"
            )
        if self.plane not in COMPONENTS:
            raise PdheError(f"user material {self.name}: plane {self.plane!r}: needs strain, stress or None")
        for what, values in (("property", self.properties), ("initial state variable", self.state)):
            for number, value in enumerate(values, 1):
                if not np.isfinite(value):
                    raise PdheError(f"user material {self.name}: {what} {number} is {value}")
        if not self.address:
            object.__setattr__(self, "address", _address(Path(self.library), self.symbol))

    @property
    def components(self) -> int:
        """Number of stress components, NTENS."""
        return COMPONENTS[self.plane]

    @property
    def dimensions(self) -> int:
        """Rows of a displacement gradient."""
        return 3 if self.plane is None else 2


def _address(library: Path, symbol: str) -> int:
    if not library.is_file():
        raise PdheError(f"{library}: there is no such library")
    if damaged_library(library):
        # The system would end the process without a word, or run other code.
        raise PdheError(f"{library}: is damaged; delete it and give the same command again")
    try:
        loaded = ctypes.CDLL(str(library.resolve()))
    except OSError as error:
        raise PdheError(f"{library}: cannot be loaded: {error}; link what it needs into it") from error
    if not hasattr(loaded, symbol):
        others = [name for name in ("umat_", "umat", "UMAT", "umat__") if hasattr(loaded, name)]
        hint = f"it has '{others[0]}'" if others else f"`nm -D {library.name}` lists what it has"
        raise PdheError(f"{library}: has no routine '{symbol}'; {hint}")
    return ctypes.cast(loaded[symbol], ctypes.c_void_p).value or 0


class UserPoints:
    """Points of a user material with their history: stresses, state variables and energies at the last committed step.

    An equilibrium tries increments from there as often as it likes; :meth:`commit` makes the last one history.

    Parameters
    ----------
    material
        What all of them are made of.
    coordinates, sizes
        Places, m (n, dim), and characteristic lengths, m (n,).

    Attributes
    ----------
    gradient, stress, state, energy
        At the last committed step: displacement gradient, row by row (n, dim dim); components in the order of Abaqus,
        Pa (n, c); state variables (n, s); elastic, plastic and creep energy, J/m^3 (n, 3).
    field, target
        Field variable, which it is told as PREDEF and DPRED, at the last committed step and at the end of the next
        (n,); zero unless somebody sets them.
    tangent
        DDSDDE of the last trial, Pa (n, c, c).

    Raises
    ------
    PdheError
        If a trial of the first point ends the process, does not come back, or writes beyond what it was given.
    """

    def __init__(self, material: UserMaterial, coordinates: np.ndarray, sizes: np.ndarray) -> None:
        self.material, self.coordinates = material, as_float(coordinates)
        n, size, count = len(self.coordinates), material.components, len(material.state)
        self.sizes = as_float(sizes, (n,))
        self.gradient = np.zeros((n, material.dimensions**2))
        self.stress, self.energy = np.zeros((n, size)), np.zeros((n, 3))
        self.state = np.tile(as_float(material.state, (count,)), (n, 1))
        self.field = self.target = np.zeros(n)
        self.tangent = np.zeros((n, size, size))
        self.increments, self.time = 0, 0.0
        self._trial: tuple[np.ndarray, ...] | None = None
        self._make_scratch(max(1, min(n, numba.get_num_threads())))
        if n:
            self._probe()

    def _make_scratch(self, threads: int) -> None:
        k, material = kernels, self.material
        count, properties = len(material.state), as_float(material.properties)
        behind = k.STATEV + count + k.GUARD
        self._work = np.full((threads, behind + properties.size + k.GUARD), np.nan)
        self._work[:, : k.BEHIND] = 0.0
        self._work[:, k.STATEV : k.STATEV + count] = 0.0
        self._work[:, behind : behind + properties.size] = properties
        self._guards = np.ones(self._work.shape[1], bool)
        self._guards[: k.BEHIND] = False
        self._guards[k.STATEV : k.STATEV + count] = self._guards[behind : behind + properties.size] = False
        self._integers = np.zeros((threads, k.INTEGERS), np.int32)
        size = material.components
        direct = 3 if size > 3 else 2
        for place, value in (
            (k.NDI, direct), (k.NSHR, size - direct), (k.NTENS, size), (k.NSTATV, count), (k.NPROPS, properties.size),
            (k.NPT, 1), (k.LAYER, 1), (k.KSPT, 1), (k.JSTEP, 1), (k.JSTEP + 1, 1),
        ):  # fmt: skip
            self._integers[:, place] = value
        self._name = np.frombuffer(material.name.upper().ljust(NAME).encode("ascii"), np.uint8).copy()
        reals = (
            k.STRESS, k.STATEV, k.DDSDDE, k.SSE, k.SPD, k.SCD, k.RPL, k.DDSDDT, k.DRPLDE, k.DRPLDT, k.STRAN, k.DSTRAN,
            k.TIME, k.DTIME, k.TEMP, k.DTEMP, k.PREDEF, k.DPRED,
        )  # fmt: skip
        self._tables = np.zeros((threads, k.ARGUMENTS), np.int64)
        for thread in range(threads):
            real, whole = self._work[thread].ctypes.data, self._integers[thread].ctypes.data
            self._tables[thread] = [
                *(real + 8 * place for place in reals),
                self._name.ctypes.data,
                *(whole + 4 * place for place in (k.NDI, k.NSHR, k.NTENS, k.NSTATV)),
                real + 8 * behind, whole + 4 * k.NPROPS,
                *(real + 8 * place for place in (k.COORDS, k.DROT, k.PNEWDT, k.CELENT, k.DFGRD0, k.DFGRD1)),
                *(whole + 4 * place for place in (k.NOEL, k.NPT, k.LAYER, k.KSPT, k.JSTEP, k.KINC)),
            ]  # fmt: skip
        self._addresses = np.array([row.ctypes.data for row in self._tables], np.int64)

    def trial(self, gradient: np.ndarray, length: float = 1.0) -> np.ndarray:
        """Go from the last committed step to displacement gradients (n, dim dim) over an increment of time, s.

        Returns
        -------
        numpy.ndarray
            Stress tensors, Pa (n, dim dim).

        Raises
        ------
        SimulationError
            Names the first point whose stress or state is not finite, or that asks for a shorter increment.
        """
        after = as_float(gradient, self.gradient.shape)
        tensor, new, wanted = self._call(len(after), after, length)
        stress, state, energy = new
        bad = ~(np.isfinite(stress).all(axis=1) & np.isfinite(state).all(axis=1))
        if bad.any():
            self._refuse(int(np.argmax(bad)), after, "gives a stress or state variable that is not finite")
        if (wanted < 1.0).any():
            point = int(np.argmin(wanted))
            self._refuse(point, after, f"asks for an increment {wanted[point]:.3g} times as long (PNEWDT)")
        self._trial = (after.copy(), stress, state, energy)
        self._length = length
        return tensor

    def _call(self, n: int, after: np.ndarray, length: float):
        threads = len(self._addresses)
        starts = np.linspace(0, n, threads + 1).astype(np.int64)
        size = self.material.components
        new = (np.empty((n, size)), np.empty((n, self.state.shape[1])), np.empty((n, 3)))
        tangent, wanted, tensor = np.empty((n, size * size)), np.empty(n), np.empty((n, after.shape[1]))
        self._integers[:, kernels.KINC] = self.increments + 1
        kernels.advance(
            self.material.address, self._addresses, NAME, starts, self._work, self._integers, self.gradient[:n], after,
            self.coordinates[:n], self.sizes[:n], np.array([self.time, length]), self.field[:n], self.target[:n],
            self.stress[:n], self.state[:n],
            self.energy[:n], *new, tangent, wanted, tensor,
        )  # fmt: skip
        if not np.isnan(self._work[:, self._guards]).all():
            raise SimulationError(
                f"user material {self.material.name}: writes beyond its {self.state.shape[1]} state variables or its "
                f"{len(self.material.properties)} properties: give as many as it asks for"
            )
        # Fortran lays out column by column.
        self.tangent = tangent.reshape(n, size, size).swapaxes(1, 2) if n == len(self.gradient) else self.tangent
        return tensor, new, wanted

    def _refuse(self, point: int, after: np.ndarray, what: str) -> None:
        raise SimulationError(
            f"user material {self.material.name}: {what} at point {point}, x = {self.coordinates[point].tolist()} m, "
            f"increment {self.increments + 1}, displacement gradient {after[point].tolist()}; it was given "
            f"{len(self.material.properties)} properties and {self.state.shape[1]} state variables (what it reads "
            "beyond these is not a number)",
            point,
        )

    def commit(self) -> None:
        """Make the last trial the state that increments start from: once a converged step."""
        if self._trial is None:
            raise SimulationError("user material: nothing was tried since the last step")
        self.gradient, self.stress, self.state, self.energy = self._trial
        self._trial = None
        self.field = self.target
        self.time += self._length
        self.increments += 1

    @property
    def nbytes(self) -> int:
        """Memory of the history, of one trial beside it, and of the tangents, bytes."""
        kept = sum(array.nbytes for array in (self.gradient, self.stress, self.state, self.energy, self.field))
        return 2 * kept + self.tangent.nbytes

    def history(self) -> tuple:
        """All that later increments depend on; :meth:`recall` takes it."""
        return self.gradient, self.stress, self.state, self.energy, self.field, self.time, self.increments

    def recall(self, history: tuple) -> None:
        """Go back to an earlier history."""
        self.gradient, self.stress, self.state, self.energy, self.field, self.time, self.increments = history
        self.target, self._trial = self.field, None

    def _probe(self) -> None:
        """Strain a point in every way in a process of its own, which may crash or be ended by the routine."""
        threads = numba.get_num_threads()
        numba.set_num_threads(1)
        # Compiled (or read from disk) here, not over there.
        self._call(0, np.empty((0, self.gradient.shape[1])), 1.0)
        alive, tell = os.pipe()
        with tempfile.TemporaryFile() as said:
            with warnings.catch_warnings():
                # The other process runs nothing but the routine, on one thread.
                warnings.simplefilter("ignore", DeprecationWarning)
                child = os.fork()
            if child == 0:
                with contextlib.suppress(BaseException):
                    signal.signal(signal.SIGALRM, signal.SIG_DFL)
                    signal.alarm(TRIAL_TIME)
                    for stream in (1, 2):
                        os.dup2(said.fileno(), stream)
                    faulthandler.disable()
                    every = TRIAL_STRAIN * np.eye(self.gradient.shape[1])
                    for after in (np.zeros((1, len(every))), *every[:, None]):
                        with contextlib.suppress(SimulationError):
                            self._call(1, after, 1.0)
                    os.write(tell, b".")
                os._exit(0)
            numba.set_num_threads(threads)
            os.close(tell)
            came_back = os.read(alive, 1)
            os.close(alive)
            status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
            said.seek(0)
            words = said.read().decode("utf-8", "replace").strip()[-1000:]
        if came_back:
            return
        how = f"ended the process with status {status}"
        if status < 0:
            how = f"did not come back within {TRIAL_TIME} s" if -status == signal.SIGALRM else "crashed"
            how += f" ({signal.Signals(-status).name})"
        raise PdheError(
            f"user material {self.material.name}: {how} when tried with {len(self.material.properties)} properties, "
            f"{self.state.shape[1]} state variables, NTENS = {self.material.components}"
            + (f": {words}" if words else "")
        )


#: Newton steps of an increment with free components, and the stress left in them over the largest, or over the tangent
#: where there is none.
MOST_ITERATIONS, REMAINDER = 30, 1e-12


def drive(points: UserPoints, path: np.ndarray, free: tuple[int, ...] = (), length: float = 1.0) -> np.ndarray:
    """Take points through a path of strains, committing every increment.

    Parameters
    ----------
    points
        With their history; they go on from it.
    path
        Strains at the end of each increment in the order of Abaqus, shear as the angle (k, c).
    free
        Components whose stress stays zero: their strains are found by Newton's method with DDSDDE.
    length
        Time of an increment, s.

    Returns
    -------
    numpy.ndarray
        For each increment the strains and stresses of the first point (k, 2, c).

    Raises
    ------
    SimulationError
        If a free component's stress does not vanish, or as :meth:`UserPoints.trial`.
    """
    size, free, found = points.material.components, list(free), []
    if size == 4 and 2 in free:
        raise SimulationError("user material: the strain across a plate in plane strain is zero, it cannot be free")
    guess = _strains(points.gradient[0], size)[free]
    for strain in np.atleast_2d(as_float(path)):
        strain = strain.copy()
        strain[free] = guess
        for _ in range(MOST_ITERATIONS):
            gradient = np.tile(_gradient(strain, size), (len(points.stress), 1))
            points.trial(gradient, length)
            stress = points._trial[1][0]
            stiff = points.tangent[0][np.ix_(free, free)]
            least = np.abs(points.tangent[0]).max() * np.finfo(float).eps * np.abs(strain).max()
            if not free or np.abs(stress[free]).max() <= max(REMAINDER * np.abs(stress).max(), least):
                break
            strain[free] -= np.linalg.solve(stiff, stress[free])
        else:
            raise SimulationError(
                f"user material {points.material.name}: free stress components {stress[free].tolist()} Pa after "
                f"{MOST_ITERATIONS} iterations of increment {points.increments + 1}: DDSDDE does not belong to STRESS?"
            )
        points.commit()
        guess = strain[free].copy()
        found.append((strain, points.stress[0].copy()))
    return np.array(found)


_SHEARS = {3: [(0, 1)], 4: [(0, 1)], 6: [(0, 1), (0, 2), (1, 2)]}


def _gradient(strain: np.ndarray, size: int) -> np.ndarray:
    """Symmetric displacement gradient of some strains, row by row."""
    dim, direct = (3 if size == 6 else 2), (3 if size > 3 else 2)
    out = np.diag(strain[:dim]).astype(float)
    for (a, b), shear in zip(_SHEARS[size], strain[direct:], strict=True):
        out[a, b] = out[b, a] = 0.5 * shear
    return out.ravel()


def _strains(gradient: np.ndarray, size: int) -> np.ndarray:
    """Strains of a displacement gradient."""
    dim, direct = (3 if size == 6 else 2), (3 if size > 3 else 2)
    tensor, out = gradient.reshape(dim, dim), np.zeros(size)
    out[:dim] = np.diag(tensor)
    out[direct:] = [tensor[a, b] + tensor[b, a] for a, b in _SHEARS[size]]
    return out
