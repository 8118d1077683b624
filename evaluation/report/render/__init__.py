"""The report in other forms: Markdown, and every figure as an SVG file."""
