"""Verification: what is checked, against what, and how well it holds.

Each topic is one module with one function that takes settings and returns a
:class:`~pdhe.verification.report.Report`; it is registered by one line in :data:`pdhe.verification.topics.TOPICS`. The
tests call the same functions with small settings, the workflow with the full ones.
"""
