"""A hook of MkDocs for pages that are written elsewhere: the commands themselves, and the firmware's own page."""

import re
from pathlib import Path

import typer
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from typer.cli import get_docs_for_click

FIRMWARE = "../hardware/firmware/README.md"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are no files of the folder."""
    firmware = (Path(config.docs_dir) / FIRMWARE).read_text()
    files.append(File.generated(config, "reference/commands.md", content=commands()))
    files.append(File.generated(config, "firmware.md", content=re.sub(r"\]\(\.\./\.\./docs/", "](", firmware)))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Lead links to the firmware's page to where it stands on the site."""
    return markdown.replace(f"]({FIRMWARE})", "](firmware.md)")


def commands() -> str:
    """Return the page of the command line: what ``--help`` says of every command, as Markdown."""
    from sysid_evo.cli.app import app

    command = typer.main.get_command(app)
    context = typer.Context(command, info_name="sysid-evo")
    written = get_docs_for_click(obj=command, ctx=context, name="sysid-evo", title="Command line")
    return re.sub(r"(?m)^\* `--(install|show)-completion`.*\n", "", written)
