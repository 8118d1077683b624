"""A story in its forms: an HTML page, Markdown, tables for a terminal, and every figure as SVG."""
