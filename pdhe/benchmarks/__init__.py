"""Benchmarks: how fast the program is, and compared with what.

A benchmark is a module with ``run(**settings) -> Report``. Times and rates are shown without a verdict, since machines
differ and are shared; counts of work are judged, since they do not. What a ratio compares was measured in turns in one
run.
"""
