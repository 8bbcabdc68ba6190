"""The pages that are made of the code: which there are, and what makes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from tools.site.api_page import api_page
from tools.site.commands_page import commands_page
from tools.site.keys_page import keys_page
from tools.site.objects_page import objects_page

MADE: Mapping[str, Callable[[], str]] = {
    "reference/objects.md": objects_page,
    "reference/keys.md": keys_page,
    "reference/commands.md": commands_page,
    "reference/api.rst": api_page,
}
