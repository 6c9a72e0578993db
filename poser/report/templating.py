"""The pages' templates: files of `poser/report/templates`, what is filled in escaped."""

from __future__ import annotations

from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup


def fill(name: str, **values: Any) -> Markup:
    """The template with the values filled in; a name that it lacks is an error."""
    return Markup(_templates().get_template(name).render(**values))


@cache
def _templates() -> Environment:
    made = Environment(
        loader=PackageLoader("poser.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    return made
