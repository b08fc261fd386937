"""Compiled user materials: what they are told, their closed forms, equilibria with a history, and what goes wrong."""

import shutil
import struct
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
import xarray as xr

from pdhe import cli
from pdhe.errors import PdheError, SimulationError
from pdhe.increments import Increments, Steps
from pdhe.kernels import umat as kernels
from pdhe.materials.umat import UserMaterial, UserPoints, build, drive
from pdhe.materials.user import UserBody
from pdhe.solvers import Equilibrium
from pdhe.store import check
from pdhe.wholefile import damaged_library
from tests.lattices import YOUNG, make_body

SOURCES = Path(__file__).parents[2] / "config/umat"
NU, YIELD, HARDENING = 0.29, 250e6, 2e9
STEEL = (YOUNG, NU, YIELD, HARDENING)
SIGNATURE = (
    "double *stress, double *statev, double *ddsdde, double *sse, double *spd, double *scd, double *rpl, "
    "double *ddsddt, double *drplde, double *drpldt, double *stran, double *dstran, double *time, double *dtime, "
    "double *temp, double *dtemp, double *predef, double *dpred, char *cmname, int *ndi, int *nshr, int *ntens, "
    "int *nstatv, double *props, int *nprops, double *coords, double *drot, double *pnewdt, double *celent, "
    "double *dfgrd0, double *dfgrd1, int *noel, int *npt, int *layer, int *kspt, int *jstep, int *kinc, long length"
)


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    folder = tmp_path_factory.mktemp("libraries")

    def get(name, code=None):
        compiler = "gfortran" if name.endswith(".f") else "cc"
        if shutil.which(compiler) is None:
            pytest.skip(f"no {compiler} here")
        source = SOURCES / name
        if code is not None:
            source = folder / name
            source.write_text(f"#include <string.h>\nvoid umat_({SIGNATURE}) {{ {code} }}\n")
        return build(source, folder)

    return get


def one(library, properties=STEEL, state=(0.0,), plane="strain", name="steel"):
    material = UserMaterial(library, name, properties, state, plane)
    return UserPoints(material, np.zeros((1, material.dimensions)), np.ones(1))


def user_body(library, properties=STEEL, state=(0.0,), plane="strain", **options):
    x, reference = make_body(model="correspondence", plane=plane, **options)
    material = UserMaterial(library, "elastic-1", properties, state, plane)
    return x, reference, UserBody(reference.bonds, reference.model, x, reference.volume, material)


def uniaxial_stress(path):
    """Stress and plastic strain of a bar: elastic, or back on a yield stress that has grown."""
    plastic, total, found = 0.0, 0.0, []
    for strain in path:
        trial = YOUNG * (strain - plastic)
        more = max(abs(trial) - YIELD - HARDENING * total, 0.0) / (YOUNG + HARDENING)
        plastic, total = plastic + np.sign(trial) * more, total + more
        found.append((YOUNG * (strain - plastic), total))
    return np.array(found).T


def uniaxial_strain(path):
    """Stresses along and across, and plastic strain, where nothing moves across: the deviator is a bar of 2 G."""
    shear, bulk = YOUNG / (2 + 2 * NU), YOUNG / (3 - 6 * NU)
    plastic, total, found = 0.0, 0.0, []
    for strain in path:
        trial = 2 * shear * strain - 3 * shear * plastic
        more = max(abs(trial) - YIELD - HARDENING * total, 0.0) / (3 * shear + HARDENING)
        plastic, total = plastic + np.sign(trial) * more, total + more
        mises = 2 * shear * strain - 3 * shear * plastic
        found.append((bulk * strain + 2 / 3 * mises, bulk * strain - mises / 3, total))
    return np.array(found).T


# Elastic, yielding, unloading, yielding the other way.
PATH = np.array([1e-3, 2e-3, 5e-3, 9e-3, 7.5e-3, 2e-3, -4e-3])


@pytest.mark.parametrize("name", ["j2.c", "j2.f"])
def test_a_bar_yields_and_unloads_by_its_closed_form(library, name):
    points, strains = one(library(name), plane=None), np.zeros((len(PATH), 6))
    strains[:, 0] = PATH
    totals, stresses = [], []
    for strain in strains:
        stresses.append(drive(points, strain, free=(1, 2, 3, 4, 5))[0, 1])
        totals.append(points.state[0, 0])
    stress, total = uniaxial_stress(PATH)
    # Measured 2e-15; Newton's method leaves up to 1e-12 across.
    np.testing.assert_allclose(np.array(stresses)[:, 0], stress, rtol=1e-11)
    np.testing.assert_allclose(totals, total, rtol=1e-11, atol=1e-17)
    assert np.abs(np.array(stresses)[:, 1:]).max() < 1e-11 * YIELD


@pytest.mark.parametrize("name", ["j2.c", "j2.f"])
def test_every_node_of_a_stretched_plate_has_the_closed_form(library, name):
    x, _, body = user_body(library(name), perturb=0.2)
    for strain, along, across, total in zip(PATH, *uniaxial_strain(PATH), strict=True):
        stress = body.stress(np.column_stack([strain * x[:, 0], np.zeros(len(x))]))
        body.points.commit()
        # Measured 3e-15: gradients carry the round-off of positions over distances, gathered in the history.
        np.testing.assert_allclose(stress[:, 0, 0], along, rtol=1e-12)
        np.testing.assert_allclose(stress[:, 1, 1], across, rtol=1e-12)
        np.testing.assert_allclose(body.points.stress[:, 2], across, rtol=1e-12)
        np.testing.assert_allclose(body.points.state[:, 0], total, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("plane", ["strain", "stress"])
def test_an_elastic_user_material_is_the_model_that_is_built_in(library, plane):
    _, reference, body = user_body(library("elastic.c"), (YOUNG, NU), (), plane, perturb=0.2)
    u = 1e-7 * np.random.default_rng(3).normal(size=body.coordinates.shape)
    force = reference.force(u)
    # Measured 1e-16.
    np.testing.assert_allclose(body.force(u), force, rtol=0.0, atol=1e-12 * np.abs(force).max())
    np.testing.assert_allclose(body.tangent().force(u), force, rtol=0.0, atol=1e-12 * np.abs(force).max())
    body.points.commit()
    np.testing.assert_allclose(body.energy(u), reference.energy(u), rtol=1e-12)


def held(x):
    left, right = x[:, 0] < 3e-3, x[:, 0] > 9e-3
    fixed = np.zeros(x.shape, bool)
    fixed[left | right] = True
    return fixed, right


def stretched(x, right, strain):
    prescribed = np.zeros_like(x)
    prescribed[right, 0] = strain * 12e-3
    return prescribed


def test_an_elastic_equilibrium_is_that_of_the_linear_solver(library):
    x, reference, body = user_body(library("elastic.c"), (YOUNG, NU), ())
    fixed, right = held(x)
    spacing = np.full(len(x), 1e-3)
    u, _ = Increments(body, fixed, spacing, 1e-11).step(np.zeros_like(x), stretched(x, right, 1e-3))
    linear = Equilibrium(reference, fixed, x, spacing, 1e-11, 500)
    expected, _ = linear.solve(np.zeros_like(x), stretched(x, right, 1e-3))
    # Measured 2e-13 of the largest displacement.
    np.testing.assert_allclose(u, expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())


def test_a_plastic_equilibrium_balances_and_its_history_advances_once_a_step(library):
    x, _, body = user_body(library("j2.c"))
    fixed, right = held(x)
    increments, u = Increments(body, fixed, np.full(len(x), 1e-3)), np.zeros_like(x)
    work, before = 0.0, np.zeros_like(x)
    for number, strain in enumerate((1e-3, 4e-3, 8e-3, 6e-3, -2e-3), 1):
        old, plastic = u, body.points.state.copy()
        u, force = increments.step(u, stretched(x, right, strain))
        assert body.points.increments == number
        assert (body.points.state >= plastic).all()
        assert increments.residuals[-1] < 1e-8
        # Quadratic: 0.3, 2e-3, 1e-7, 1e-11 measured in the last increment.
        assert len(increments.residuals) <= 5
        assert np.abs(force.sum(axis=0)).max() < 1e-9 * np.abs(force).sum()
        work -= 0.5 * np.sum((force + before) * (u - old))
        before = force
    assert body.points.state.min() == 0.0 or body.points.state.max() > 1e-2
    # All that the supports did went into plastic work, but for the trapezia of five large steps (6 % measured).
    assert work == pytest.approx(body.energy(u).sum() + np.sum(body.volume * body.points.energy[:, 1]), rel=0.1)


def test_a_step_without_equilibrium_leaves_the_history(library):
    x, _, body = user_body(library("j2.c"))
    fixed, right = held(x)
    increments = Increments(body, fixed, np.full(len(x), 1e-3), most_iterations=2, cuts=1)
    with pytest.raises(SimulationError, match=r"increment 1 not reached: .*; largest residual at node \d+, x = "):
        increments.step(np.zeros_like(x), stretched(x, right, 8e-3))
    assert body.points.increments == 0 and not body.points.state.any() and not body.points.stress.any()
    increments = Increments(body, fixed, np.full(len(x), 1e-3), cuts=0, max_iterations=1)
    with pytest.raises(SimulationError, match=r"in 1 iterations; largest residual at node \d+, x = .*; raise solver"):
        increments.step(np.zeros_like(x), stretched(x, right, 8e-3))


def test_increments_are_cut_where_the_material_asks_for_it(library):
    code = """
        for (int k = 0; k < 4; k++) if (dstran[k] > 1.1e-3) *pnewdt = 0.5;
        for (int k = 0; k < 4; k++) { stress[k] += 1e11 * dstran[k]; ddsdde[5 * k] = 1e11; }
        statev[0] += *dtime; statev[1] += 1.0;
    """
    x, _, body = user_body(library("shorter.c", code), (), (0.0, 0.0))
    body_fixed = np.ones(x.shape, bool)
    increments = Increments(body, body_fixed, np.full(len(x), 1e-3))
    u, _ = increments.step(np.zeros_like(x), np.column_stack([4e-3 * x[:, 0], 0.0 * x[:, 1]]), 8.0)
    assert body.points.increments == 4 and body.points.time == 8.0
    assert (body.points.state == [8.0, 4.0]).all()
    np.testing.assert_allclose(u[:, 0], 4e-3 * x[:, 0], rtol=1e-14)
    np.testing.assert_allclose(body.points.stress[:, 0], 4e8, rtol=1e-10)
    # Too long by far: refused, and all is as it was.
    with pytest.raises(SimulationError, match="PNEWDT"):
        increments.step(u, np.column_stack([4.0 * x[:, 0], 0.0 * x[:, 1]]))
    assert body.points.increments == 4 and (body.points.state == [8.0, 4.0]).all()


def test_steps_are_written_with_units(library, tmp_path):
    x, _, body = user_body(library("j2.c"))
    steps = Steps(body)
    for strain in (1e-3, 3e-3):
        u = np.column_stack([strain * x[:, 0], 0.0 * x[:, 1]])
        body.force(u)
        body.points.commit()
        steps.note(u)
    steps.write(tmp_path / "steps.nc")
    with xr.open_dataset(tmp_path / "steps.nc", decode_times=False) as found:
        assert found["stress"].dims == ("time", "node", "entry") and found["stress"].attrs["units"] == "Pa"
        np.testing.assert_array_equal(found["time"], [1.0, 2.0])
        np.testing.assert_array_equal(found["stress"][1], body.points.stress)
        np.testing.assert_allclose(
            found["state_variables"][:, :, 0].max("node"), uniaxial_strain([1e-3, 3e-3])[2], rtol=1e-9
        )
        np.testing.assert_array_equal(found["displacement"][1], u)
        assert found.attrs["user_material"] == "elastic-1"


def test_the_tangent_of_j2_is_the_derivative_of_its_stress(library):
    points = one(library("j2.c"), plane=None)
    strain = np.array([3e-3, -1e-3, 5e-4, 2e-3, -1e-3, 7e-4])
    drive(points, 0.5 * strain)

    def stress(strains):
        drive_to = np.array([[strains[0], strains[3] / 2, strains[4] / 2], [strains[3] / 2, strains[1], strains[5] / 2],
                             [strains[4] / 2, strains[5] / 2, strains[2]]])  # fmt: skip
        points.trial(drive_to.reshape(1, 9))
        return points._trial[1][0]

    stress(strain)
    tangent, h = points.tangent[0].copy(), 1e-8
    found = np.column_stack([(stress(strain + h * e) - stress(strain - h * e)) / (2 * h) for e in np.eye(6)])
    # Measured 3e-11: cancellation.
    np.testing.assert_allclose(found, tangent, rtol=0.0, atol=1e-9 * np.abs(tangent).max())


def test_it_is_told_where_and_when_it_is(library):
    code = """
        double told[16] = {time[0], time[1], *dtime, *kinc, *noel, *celent, coords[0], coords[1], coords[2],
                           dfgrd0[0], dfgrd1[3], dfgrd1[1], *ntens, length, strncmp(cmname, "HERE ", 5), cmname[79]};
        memcpy(statev, told, sizeof told);
        for (int k = 0; k < *ntens; k++) stress[k] = 100.0 * stran[k] + dstran[k] + 1e4 * props[k];
    """
    material = UserMaterial(library("told.c", code), "Here", (1.0, 2.0, 3.0, 4.0), (0.0,) * 16, "strain")
    points = UserPoints(material, [[1.0, 2.0], [3.0, 4.0]], [5.0, 6.0])
    points.trial(np.tile([0.1, 0.2, 0.3, 0.4], (2, 1)), 0.5)
    points.commit()
    tensor = points.trial(np.tile([0.2, 0.3, 0.5, 0.7], (2, 1)), 0.25)
    points.commit()
    expected = [0.5, 0.5, 0.25, 2, 2, 6, 3, 4, 0, 1.1, 0.3, 0.5, 4, 80, 0, ord(" ")]
    np.testing.assert_allclose(points.state[1], expected, rtol=1e-15)
    # 11, 22, 33, 12; the shear is 0.5 at first and grows by 0.3.
    components = [1e4 + 10.1, 2e4 + 40.3, 3e4, 4e4 + 50.3]
    np.testing.assert_allclose(points.stress[0], components, rtol=1e-14)
    np.testing.assert_allclose(tensor[0], [components[0], components[3], components[3], components[1]], rtol=1e-14)


def test_threads_do_not_change_anything(library):
    found = []
    most, before = numba.config.NUMBA_NUM_THREADS, numba.get_num_threads()
    for threads in sorted({1, min(2, most)}):
        numba.set_num_threads(threads)
        try:
            x, _, body = user_body(library("j2.c"))
            found.append(body.force(1e-6 * np.random.default_rng(0).normal(size=x.shape)))
        finally:
            numba.set_num_threads(before)
    assert np.array_equal(found[0], found[-1])


def test_one_compiled_kernel_serves_every_material_and_is_kept_on_disk(library):
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        for name in ("elastic.c", "j2.c"):
            one(library(name), *((YOUNG, NU), ()) if name == "elastic.c" else (), name="elastic")
    finally:
        numba.set_num_threads(before)
    compiled = kernels.advance._serial
    assert len(compiled.signatures) == 1
    assert sum(compiled.stats.cache_hits.values()) + sum(compiled.stats.cache_misses.values()) == 1
    assert list(Path(compiled.stats.cache_path).glob("umat.advance_serial-*.nbc"))


@pytest.mark.parametrize(
    "code, message",
    [
        ("*(volatile int *)0 = 1;", r"crashed \(SIGSEGV\).*with 4 properties"),
        ("for (int k = 0; k < 4; k++) statev[1 + k] = 0.0;", "writes beyond its 1 state variables or its 4 properties"),
        ("props[4] = 1.0;", "writes beyond"),
        ("stress[0] = props[4];", "not finite at point 0.*given 4 properties and 1 state variables"),
        ("statev[0] = 0.0 / 0.0;", "not finite"),
        ("*pnewdt = 0.25;", r"an increment 0.25 times as long \(PNEWDT\)"),
    ],
)
def test_what_a_bad_routine_does_is_said(library, code, message):
    with pytest.raises(PdheError, match=message):
        one(library(f"bad{abs(hash(code))}.c", code)).trial(np.zeros((1, 4)))


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"properties": STEEL[:3]}, "ended the process with status 42.*with 3 properties.*needs 4 properties"),
        ({"properties": (float("nan"), 0.3, 1.0, 1.0)}, "property 1 is nan"),
        ({"state": ()}, "ended the process"),
        ({"name": "with blank"}, "name 'with blank'"),
        ({"plane": "both"}, "plane 'both'"),
    ],
)
def test_bad_properties_are_refused(library, changes, message):
    with pytest.raises(PdheError, match=message):
        one(library("j2.c"), **changes)


def test_a_material_looks_at_its_name(library):
    with pytest.raises(PdheError, match="no material COPPER"):
        one(library("elastic.c"), (YOUNG, NU), (), name="copper")


def test_a_missing_routine_or_library_is_named(library, tmp_path):
    with pytest.raises(PdheError, match="no routine 'other_'; it has 'umat_'"):
        UserMaterial(library("j2.c"), "steel", symbol="other_")
    with pytest.raises(PdheError, match="no such library"):
        UserMaterial(tmp_path / "none.so", "steel")
    (tmp_path / "text.so").write_text("nothing")
    with pytest.raises(PdheError, match="cannot be loaded"):
        UserMaterial(tmp_path / "text.so", "steel")


def test_a_missing_compiler_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("FC", raising=False)
    with pytest.raises(PdheError, match=r"j2\.f: no compiler for it \(gfortran\)"):
        build(SOURCES / "j2.f", tmp_path)
    monkeypatch.setenv("CC", "none -O3")
    with pytest.raises(PdheError, match=r"no compiler for it \(none -O3\)"):
        build(SOURCES / "j2.c", tmp_path)
    with pytest.raises(PdheError, match="a user material is a"):
        build(tmp_path / "material.py", tmp_path)


def test_what_the_compiler_says_is_shown_and_nothing_is_kept(library, tmp_path):
    library("j2.c")
    (tmp_path / "wrong.c").write_text("void umat_( { }\n")
    with pytest.raises(PdheError, match=r"does not compile it:\n.*error"):
        build(tmp_path / "wrong.c", tmp_path / "kept")
    assert not list((tmp_path / "kept").iterdir())


def test_a_source_is_compiled_once(library, tmp_path):
    library("j2.c")
    (tmp_path / "mine.c").write_bytes((SOURCES / "j2.c").read_bytes())
    first = build(tmp_path / "mine.c", tmp_path / "kept")
    stamp = first.stat().st_mtime_ns
    assert build(tmp_path / "mine.c", tmp_path / "kept") == first and first.stat().st_mtime_ns == stamp
    (tmp_path / "mine.c").write_text((SOURCES / "j2.c").read_text() + "\n/* changed */\n")
    assert build(tmp_path / "mine.c", tmp_path / "kept") != first


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="libraries have a seal on Linux only")
def test_a_damaged_library_is_told_or_made_anew(library, tmp_path):
    """Half of one ended the process by SIGBUS; another constant in it gave other stresses."""
    library("j2.c")
    (tmp_path / "mine.c").write_bytes((SOURCES / "j2.c").read_bytes())
    kept = build(tmp_path / "mine.c", tmp_path / "kept")
    whole = kept.read_bytes()
    place = whole.index(struct.pack("<d", 3.0)) + 6
    flipped = whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :]
    for spoilt in (b"", whole[: len(whole) // 2], whole[:-500], flipped):
        kept.write_bytes(spoilt)
        other = tmp_path / "store" / "umat" / "mine.so"
        other.parent.mkdir(parents=True, exist_ok=True)
        other.write_bytes(spoilt)
        assert list(check(other)) == ["is damaged"]
        with pytest.raises(
            PdheError, match=r"mine\.so: (is damaged; delete it and give the same command|cannot be loaded)"
        ):
            one(other)
        assert build(tmp_path / "mine.c", tmp_path / "kept") == kept and kept.read_bytes() == whole
    # One that somebody else compiled has no seal.
    foreign = tmp_path / "foreign.so"
    foreign.write_bytes(whole[: whole.rindex(b"$Comments")])
    assert not damaged_library(foreign)
    one(foreign)


def test_the_command_line_takes_a_point_through_a_path(library, tmp_path, monkeypatch, capsys):
    library("j2.c")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    given = [str(SOURCES / "j2.c"), "--properties", "[207e9, 0.29, 250e6, 2e9]", "--state", "[0]", "--plane", "solid"]
    table = tmp_path / "table.csv"
    more = ["--strains", "[1e-3, 5e-3, 2e-3]", "--free", "[2, 3, 4, 5, 6]", "--out", str(table)]
    assert cli.main(["umat-check", *given, *more]) == 0
    rows = np.genfromtxt(table, delimiter=",", names=True)
    np.testing.assert_allclose(rows["stress_11"], uniaxial_stress([1e-3, 5e-3, 2e-3])[0], rtol=1e-10)
    assert cli.main(["umat-check", *given, "--strains", "[[1, 2, 3, 4, 5, 6, 7]]"]) == 1
    assert cli.main(["umat-check", *given, "--strains", "{}"]) == 1
    assert "needs a JSON list" in capsys.readouterr().err
    assert cli.main(["umat-build", str(SOURCES / "j2.c"), "--out", str(tmp_path / "j2.so")]) == 0
    UserMaterial(tmp_path / "j2.so", "steel")
