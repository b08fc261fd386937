from pdhe.verification.graded import fine_tip, plate_run, run


def test_graded_meshes_are_no_worse_than_uniform_ones(tmp_path):
    """The strip among them: its energies on graded triangles over those on uniform ones, and the size of its cells."""
    report = run(
        side=0.05,
        growths=(0.15,),
        ratios=(3.015,),
        strip_cells=(36, 10),
        heights=tuple(range(24, 30)),
        spacing=2e-3,
        end=2.8e6,
        lengths=(1e-3,),
        others=(),
        finer=None,
    )
    assert report.passed, [row for row in report.rows if not row.passed]
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_a_tip_five_times_finer_costs_less_than_twice_as_much():
    """The plate of the thesis at 1 mm in hydrogen until the crack has run through the fine part, 3.4 mm."""
    spacing, end = 1e-3, 1.6e6
    uniform = plate_run({"spacing": spacing, "cells": "triangle"}, end)
    finer = plate_run(fine_tip(spacing / 5.0, 2.0 * spacing, 0.8 * spacing, 5.0 * spacing), end)
    assert finer.result["crack_extension"].values.max() > 2.0 * spacing
    # Measured 1.00, and 0.10 of the bonds; at the end of the topic's runs 0.89.
    assert finer.until(end) < 2.0 * uniform.until(end)
