"""A hook of MkDocs: every tutorial can be downloaded as a notebook, made from the same page.

Files of a page are written by cells, its commands run in cells, and pictures are those that the commands make. Without
jupytext (extra `docs`) the site has no notebooks.
"""

import importlib.util
import re

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

FENCE = re.compile(r"(^```\w*\n.*?^```$)", re.DOTALL | re.MULTILINE)
FILE_NAME = re.compile(r"# (\w+\.(?:py|toml))\n")
PICTURE = re.compile(r"!\[([^\]]*)\]\(\.\./images/(\w+)-([\w-]+)\.svg\)")
LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((?!https?:)[^)]*\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a notebook for each tutorial."""
    for file in files.documentation_pages():
        if has_notebook(file):
            name = file.src_uri.removesuffix(".md") + ".ipynb"
            files.append(File.generated(config, name, content=notebook(file.content_string)))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Link the notebook below the title of its page."""
    if not has_notebook(page.file):
        return markdown
    title, rest = markdown.split("\n", 1)
    return f"{title}\n\n[Download this page as a notebook]({page.file.name}.ipynb)\n{rest}"


def has_notebook(file: File) -> bool:
    """Return whether there is a notebook for a page."""
    return file.src_uri.startswith("tutorials/") and importlib.util.find_spec("jupytext") is not None


def notebook(markdown: str) -> str:
    """Return the notebook (JSON) of a page."""
    import jupytext

    parts = [cell(part) if part.startswith("```") else text(part) for part in FENCE.split(markdown)]
    made = jupytext.reads("".join(parts), fmt="md")
    made.metadata["kernelspec"] = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return str(jupytext.writes(made, fmt="ipynb"))


def cell(block: str) -> str:
    """Return a block as a cell that writes its file, runs its commands or its Python; others are left as they are."""
    language, code = block.removeprefix("```").split("\n", 1)
    if named := FILE_NAME.match(code):
        return f"```python\n%%writefile {named[1]}\n{code}"
    return f"```python\n%%sh -e\n{code}" if language == "sh" else block


def text(part: str) -> str:
    """Return text without links to other pages, and with the pictures that its commands make."""
    return PICTURE.sub(r"![\1](runs/\2/figures/\3.svg)", LINK.sub(r"\1", part))
