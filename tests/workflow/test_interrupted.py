"""A solve that is killed in the workflow: the next call goes on from its checkpoint, to the same bits."""

import pytest

from pdhe.netcdf import read_netcdf
from pdhe.study import load_study

# Belongs to no fingerprint, as little as the command line it is appended to.
KILLED = """

def _killed_once(arguments, solve=solve):
    import os, signal
    from pdhe.checkpoint import Keeper

    write = Keeper.write

    def killed(self, run):
        write(self, run)
        if self.written == 12 and not os.path.exists("killed"):
            open("killed", "w").close()
            os.kill(os.getpid(), signal.SIGKILL)

    Keeper.write = killed
    solve(arguments)


_killed_once.__doc__, _killed_once.__name__ = solve.__doc__, "solve"
solve = _killed_once
"""


@pytest.mark.slow
def test_a_killed_job_goes_on_with_the_next_call(pristine, tmp_path, monkeypatch):
    project = pristine.copy(tmp_path / "project")
    cli = project.folder / "pdhe/cli.py"
    cli.write_text(cli.read_text() + KILLED)
    project.edit("config/studies/smoke.yaml", "[5 mm, 10 mm]", "[10 mm]")
    monkeypatch.chdir(project.folder)
    case = next(case for case in load_study("config/studies/smoke.yaml").cases if case.name.startswith("wet"))
    target = f"results/store/solve/{case.solve_id}.nc"
    words = ("--configfile", "config/studies/smoke.yaml", "--", target)
    result, checkpoint = project.folder / target, project.folder / f"{target}.checkpoint"

    monkeypatch.setenv("PDHE_CHECKPOINT", "0")
    assert project.snakemake(*words).returncode != 0
    assert checkpoint.is_file() and not result.exists()
    done = project.snakemake(*words)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "going on from t = " in (project.folder / f"logs/solve/{case.solve_id}.log").read_text()
    assert result.is_file() and not checkpoint.exists()

    resumed = read_netcdf(result)
    result.unlink()
    monkeypatch.setenv("PDHE_CHECKPOINT", "off")
    assert project.snakemake(*words).returncode == 0
    arrays, attributes = read_netcdf(result)
    assert attributes == resumed[1]
    assert all(arrays[name].tobytes() == resumed[0][name].tobytes() for name in arrays if arrays[name].dtype != object)
