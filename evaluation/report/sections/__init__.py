"""The sections of a report, each from what stands in its data to tables, figures, sentences and JSON.

A section is a module here with ``section(report)``, which returns its part of the page, None without anything to show.
To add one, write it, give it a line in ``SECTIONS`` of `evaluation.report.report`, and test it: page, Markdown and
terminal show it then. What of it stands in ``report.json`` has a key in ``to_json`` there, and in the schema.
"""
