"""canfb.objects against the EDS files: each name is the object that its words say."""

import re
from dataclasses import fields
from typing import NamedTuple

from canfb import Conditioning, eds_path, objects
from canfb.device.od.eds import read
from canfb.objects import Multiplexer
from folding import each

NAMES = {name: value for name, value in vars(objects).items() if isinstance(value, Multiplexer)}
ENTRY = re.compile(r"^([0-9A-F]{4})(?:sub([0-9A-F]+))?$", re.IGNORECASE)


def words(text: str) -> set[str]:
    """Words of a name or a text, small letters, without the s of a plural."""
    return {word.lower().removesuffix("s") for word in re.findall(r"[A-Za-z0-9]+", text)}


class Said(NamedTuple):
    """The words of an entry, and those of the object that it is part of."""

    own: set[str]
    above: set[str]


def entries_of(eds: str) -> dict[Multiplexer, Said]:
    contents = read(eds_path(eds))
    names = {section: contents[section]["ParameterName"] for section in filter(ENTRY.match, contents)}
    found = {}
    for section, name in names.items():
        index, _, subindex = section.partition("sub")
        found[Multiplexer(int(index, 16), int(subindex or "0", 16))] = Said(words(name), words(names[index]))
    return found


MODULE, INTERFACE = entries_of("canfb-module"), entries_of("encoder-interface")


@each("name", NAMES)
def test_a_name_is_the_object_that_its_words_say(name: str) -> None:
    """Of all entries with these words, the one with the fewest others, in its own name above all."""
    entries = INTERFACE if name.startswith("INTERFACE_") else MODULE
    said = words(name.removeprefix("INTERFACE_"))
    fitting = {place: theirs for place, theirs in entries.items() if said <= theirs.own | theirs.above}
    assert fitting, f"no object of the EDS is called {sorted(said)}"
    others = {
        place: (len(one.own - said), len((one.own | one.above) - said)) for place, one in fitting.items()
    }
    assert NAMES[name] == min(others, key=others.__getitem__)


def test_conditioning_has_the_order_of_its_fields() -> None:
    for field, place in zip(fields(Conditioning), objects.CONDITIONING, strict=True):
        assert words(field.name) - {"count", "rad", ""} == MODULE[place].own


@each(
    "name, value",
    [(name, value) for name, value in vars(objects).items() if type(value) is int and value > 0],
)
def test_an_index_is_the_object_that_its_words_say(name: str, value: int) -> None:
    kind, _, what = name.partition("_")
    assert MODULE[Multiplexer(value)].above >= words(f"{kind} {what or 'communication'} 1 parameter")
