"""Pages of the site that are made from the code: the command reference from the parser."""

from __future__ import annotations

import argparse
import os
from typing import Any

from mkdocs.structure.files import File, Files


def on_files(files: Files, config: Any) -> Files:
    """Add the generated pages."""
    files.append(File.generated(config, "commands.md", content=commands_page()))
    return files


def commands_page() -> str:
    """Every command's help, in Markdown."""
    os.environ["COLUMNS"] = "96"  # argparse folds its help to the terminal
    from poser.__main__ import parser

    top = parser()
    action = next(a for a in top._actions if isinstance(a, argparse._SubParsersAction))
    helps = {choice.dest: choice.help or "" for choice in action._choices_actions}
    lines = [
        "# Commands",
        "",
        "Made from the program's own `--help`.",
        "",
        "| command | what it does |",
    ]
    lines += ["|---|---|"]
    lines += [f"| [`poser {name}`](#poser-{name}) | {helps[name]} |" for name in action.choices]
    lines += ["", "Exit status: 0 done, 1 could not do it, 2 wrong usage, 130 interrupted."]
    for name, command in action.choices.items():
        lines += ["", f"## poser {name}", "", "```text", command.format_help().rstrip(), "```"]
    return "\n".join(lines) + "\n"
