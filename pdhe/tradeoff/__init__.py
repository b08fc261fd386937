"""Speed against accuracy, measured: designed sets of runs, their errors against a converged reference, their cost.

The design stands in ``config/studies/tradeoff.yaml``. :mod:`pdhe.tradeoff.design` reads it,
:mod:`pdhe.tradeoff.measure` runs one scene of it, and :mod:`pdhe.tradeoff.page` gathers all of them.
"""
