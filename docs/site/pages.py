"""A hook of MkDocs: pages that are written elsewhere, forwards from old addresses, origin and age of tables."""

import posixpath
import re
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import typer
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from typer.cli import get_docs_for_click

FIRMWARE = "../hardware/firmware/README.md"
FIRMWARE_LINK = re.compile(r"\]\((?:\.\./)+hardware/firmware/README\.md")
INCLUDED = re.compile(r'^--8<-- "(docs/results/tables/\w+\.md)"$', re.MULTILINE)
"""A line that includes a table of results."""
ORIGIN = re.compile(r"<!-- (.+); commit (\w+); ([\d-]+) -->")
"""The first line of a table of results: command, commit, date."""
WRITTEN = re.compile(rf"\A{ORIGIN.pattern}\n+(# .+\n+)")
"""The beginning of a page that a command wrote: such a line, and its title."""
PLUGIN = re.compile(r"^# the file that `sysid-evo plugin new (\w+) --kind (\w+)` writes\n", re.MULTILINE)
"""A line in place of the file that this command writes."""
EXAMPLE = re.compile(r"^# the file docs/(examples/\w+\.py)\n", re.MULTILINE)
"""A line in place of this file."""
PROGRAM = ("sysid_evo", "model_zoo", "evaluation", "hardware")
"""The folders of the program that is measured."""
FAMILIES = "<!-- sysid-evo models list --format markdown -->"
"""The line of a page in place of which the table of all families is shown."""
FILE_NAMED = re.compile(r"\[(?:[\w.]+/)*(\w+)\.md\]\(")
"""The beginning of a link whose text is the name of a file, as on a page that is read without the site."""
FORWARDS = {
    "kernels": "extending/kernels",
    "noise": "robustness",
    "paper": "results/paper",
    "readers": "extending/reader",
    "scaling": "results/scaling",
    "shift": "adaptation",
    "strategies": "extending/strategy",
    "studies/recipes": "results/studies/procedures",
}
"""Pages that have moved: old name and new name, without the ending."""
LONG = 1000
"""Characters that one sentence on a command never has."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are no files of the folder."""
    firmware = (Path(config.docs_dir) / FIRMWARE).read_text()
    files.append(File.generated(config, "reference/commands.md", content=commands()))
    files.append(File.generated(config, "reference/contracts.md", content=contracts()))
    for old, new in FORWARDS.items():
        files.append(File.generated(config, f"{old}.html", content=forward(old, new)))
    files.append(File.generated(config, "firmware.md", content=re.sub(r"\]\(\.\./\.\./docs/", "](", firmware)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, **_: object) -> str:
    """Adapt links to the site, show the plugins that are written, and write above each table how it was made."""
    from sysid_evo.testing.template import plugin_text

    up = "../" * page.file.src_uri.count("/")
    markdown = FIRMWARE_LINK.sub(f"]({up}firmware.md", markdown)
    markdown = FILE_NAMED.sub(lambda found: f"[{found[1].replace('_', ' ')}](", markdown)
    markdown = PLUGIN.sub(lambda found: plugin_text(found[1], found[2]), markdown)
    docs = Path(config.docs_dir)
    markdown = EXAMPLE.sub(lambda found: (docs / found[1]).read_text(encoding="utf-8"), markdown)
    if FAMILIES in markdown:
        markdown = markdown.replace(FAMILIES, families())
    root = Path(config.config_file_path).parent
    markdown = WRITTEN.sub(lambda found: found[4] + origin_line(found, docs), markdown)
    return INCLUDED.sub(lambda found: origin(root / found[1]) + found[0], markdown)


def origin(table: Path) -> str:
    """Return the line above a table: its command, commit, date and age, from its first line."""
    found = ORIGIN.match(table.read_text(encoding="utf-8"))
    if found is None:
        raise PluginError(f"{table}: expected '<!-- COMMAND; commit COMMIT; DATE -->' in its first line")
    return origin_line(found, table.parent)


def origin_line(found: re.Match[str], folder: Path) -> str:
    """Return command, commit, date and age of a first line that is found in a file of ``folder``."""
    command = f"`{found[1]}`" if found[1].startswith(("python", "sysid-evo")) else found[1]
    return f"*{', '.join([command, f'commit {found[2]}', found[3], *age(folder, found[2])])}*\n\n"


@cache
def age(folder: Path, commit: str) -> tuple[str, ...]:
    """Return how many commits were made after this one, and how many of them changed the program.

    Nothing without the whole history, as in an unpacked archive, or if the commit is not in it.
    """
    if _git(folder, "rev-parse", "--is-shallow-repository") != "false":
        return ()
    later = _git(folder, "rev-list", "--count", f"{commit}..HEAD")
    changed = _git(folder, "rev-list", "--count", f"{commit}..HEAD", "--", *(f":/{name}" for name in PROGRAM))
    if later is None:
        return ()
    since = "none of which changed" if changed == "0" else f"{changed} of which changed"
    return (f"measured {later} commits before this page was built, {since} the program",)


def _git(folder: Path, *words: str) -> str | None:
    """Return what git prints, None if it fails or is missing."""
    try:
        done = subprocess.run(["git", *words], cwd=folder, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def families() -> str:
    """Return the table of all families, as ``sysid-evo models list --format markdown`` prints it."""
    from sysid_evo.cli.plugins import families_as_markdown

    return families_as_markdown()


def forward(old: str, new: str) -> str:
    """Return the page at an old address, which leads to the new one."""
    address = posixpath.relpath(f"{new}.html", posixpath.dirname(old) or ".")
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><meta http-equiv="refresh" content="0; url={address}">'
        f'<title>Moved</title><p>This page has moved: <a href="{address}">{posixpath.basename(new)}</a>.</p></html>\n'
    )


def commands() -> str:
    """Return the page of the command line: the help of every command, and the settings of a file, as Markdown."""
    from sysid_evo.cli.app import loaded

    command = loaded()
    context = typer.Context(command, info_name="sysid-evo")
    written = get_docs_for_click(obj=command, ctx=context, name="sysid-evo", title="Command line")
    for part in _all_of(command):
        written = written.replace(f"`: {part.get_short_help_str()}\n", f"`: {part.get_short_help_str(LONG)}\n")
    return re.sub(r"(?m)^\* `--(install|show)-completion`.*\n", "", written) + settings()


def settings() -> str:
    """Return the table of the settings of an experiment, as Markdown."""
    from evaluation.experiment import FILE, Experiment
    from sysid_evo.settings import option_of

    rows = ["| setting | option | default | description |", "|---|---|---|---|"]
    for name, field in Experiment.model_fields.items():
        info = option_of(Experiment, name)
        option = f"`{info.option or '--' + name.replace('_', '-')}`" if info.panel else ""
        default = "" if field.default in (None, "", ()) else f"`{field.default}`"
        rows.append(f"| `{name}` | {option} | {default} | {field.description} |")
    head = f"\n## Settings of `{FILE}`\n\nThe same settings are the keywords of `evaluation.compare`.\n\n"
    return head + "\n".join(rows) + "\n"


def contracts() -> str:
    """Return the page of the contracts: every rule that `sysid-evo plugin check` tries, kind by kind."""
    from hardware import CONTRACTS
    from sysid_evo.testing.contract import rule_of

    page = "# Contracts of plugins\n\n`sysid-evo plugin check NAME` tries these sentences, and so does `check_KIND`.\n"
    for kind, contract in CONTRACTS.items():
        page += f"\n## A {kind}\n\n" + "".join(f"- {rule_of(check)}\n" for check in contract.checks)
    return page


def _all_of(command: Any) -> Iterator[Any]:
    """Yield the commands of a group, and those of its groups."""
    for part in getattr(command, "commands", {}).values():
        yield part
        yield from _all_of(part)
