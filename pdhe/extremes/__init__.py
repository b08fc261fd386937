"""Extremes: scenes at and beyond the edge of what makes sense, each run to a stated outcome.

A case is either right within a bound or refused before it runs, with a reason. Each group is one module with a list
``CASES`` of :class:`~pdhe.extremes.outcome.Extreme`; it is registered by one line in
:data:`pdhe.extremes.registry.EXTREMES`. Rows, reports and the verdict are those of :mod:`pdhe.verification`.
"""
