"""One module a command: HELP (one line), add_arguments(parser), run(args) -> exit status.

The module's docstring is the command's description. Heavy imports belong inside `run`.
"""

NAMES: tuple[str, ...] = (
    "quickstart", "demo", "info", "formats", "convert", "synthesize", "calibrate", "solve", "track",
    "evaluate", "compare", "data", "train", "finetune", "view", "render", "live",
)  # fmt: skip
"""Commands in the order of `poser --help`."""
