"""The sections of a report: each makes tables, figures, sentences and JSON from the results.

A section is a module here with ``section(report)``, which returns its part of the page, None if it is empty. To add
one, write the module, add it to ``SECTIONS`` in `evaluation.report.report`, and test it: page, Markdown and terminal
show it then. Its numbers in ``report.json`` are a class of the module, a field of `ReportDocument`; the schema follows.
"""
