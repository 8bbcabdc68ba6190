"""What users reach from canfb.__all__ is documented: every name, every field, every parameter."""

import dataclasses
import enum
import inspect
import re
from collections.abc import Iterator
from typing import Any

import canfb
from folding import each

# A name in a docstring may leave out the unit, and write blanks for underscores.
UNIT = re.compile(r"_(s|hz|counts|cycles|rad|rad_s|rad_s2)$")
REFERENCE = re.compile(r":(?:func|class|meth):`([\w.]+)`")
EVIDENT = {"self", "cls", "args", "kwargs", "message"}
# Gaps that are known; who closes one takes it from this list.
KNOWN_GAPS: dict[str, set[str]] = {"CorrectionTable.from_bytes": {"data"}, "Tracker.skip": {"elapsed"}}


def public_names() -> Iterator[tuple[str, Any]]:
    """The names of canfb.__all__, and the public methods and properties of the classes among them."""
    for name in canfb.__all__:
        thing = getattr(canfb, name)
        yield name, thing
        if not inspect.isclass(thing) or issubclass(thing, enum.Enum):
            continue
        for attribute, member in vars(thing).items():
            member = getattr(member, "__func__", member)
            if not attribute.startswith("_") and (inspect.isfunction(member) or isinstance(member, property)):
                yield f"{name}.{attribute}", member


PUBLIC = dict(public_names())


def resolve(reference: str, owner: str) -> Any:
    """What :func:`...` in the docstring of `owner` means, None for what is not ours."""
    short = reference.removeprefix("canfb.")
    for name in (f"{owner.partition('.')[0]}.{short}", short, short.rpartition(".")[2]):
        if name in PUBLIC:
            return name
    return None


def text_of(name: str, seen: frozenset[str] = frozenset()) -> str:
    """The docstring with those of the class, of the base classes and of what it refers to."""
    thing = PUBLIC[name]
    texts = [inspect.getdoc(thing) or ""]
    if inspect.isclass(thing):
        texts += [base.__doc__ or "" for base in thing.__mro__[1:] if base.__module__.startswith("canfb")]
    elif "." in name:
        texts.append(PUBLIC[name.partition(".")[0]].__doc__ or "")
    for reference in REFERENCE.findall(texts[0]):
        other = resolve(reference, name)
        if other is not None and other not in seen | {name}:
            texts.append(text_of(other, seen | {name}))
    return " ".join(texts)


def parameters_of(thing: Any) -> set[str]:
    if inspect.isclass(thing):
        if issubclass(thing, enum.Enum) or (issubclass(thing, Exception) and "__init__" not in vars(thing)):
            return set()
        if dataclasses.is_dataclass(thing):
            return {field.name for field in dataclasses.fields(thing)}
    return set(inspect.signature(thing).parameters)


def is_spoken_of(parameter: str, text: str) -> bool:
    words = " ".join(re.findall(r"[a-z0-9]+", text.lower()))
    return any(
        f" {name.lower().replace('_', ' ')} " in f" {words} " for name in (parameter, UNIT.sub("", parameter))
    )


@each("name", PUBLIC)
def test_every_name_has_a_docstring_of_its_own(name: str) -> None:
    text = PUBLIC[name].__doc__ or ""
    assert len(text.split()) >= 2
    assert not text.startswith(f"{name}("), "made by dataclass or NamedTuple, not written"


@each("name", [name for name, thing in PUBLIC.items() if not isinstance(thing, property)])
def test_every_parameter_and_field_is_spoken_of(name: str) -> None:
    text = text_of(name)
    missing = {parameter for parameter in parameters_of(PUBLIC[name]) if not is_spoken_of(parameter, text)}
    assert missing - EVIDENT == KNOWN_GAPS.get(name, set())


def test_the_known_gaps_are_of_names_that_exist() -> None:
    assert set(KNOWN_GAPS) <= set(PUBLIC)


def test_a_parameter_that_is_not_spoken_of_is_found() -> None:
    assert not is_spoken_of("elapsed", "Forget speed and phase.")
    assert not is_spoken_of("cycles", "Skip one cycle.")
    assert is_spoken_of("sine_offset_counts", "with a sine offset")
    assert parameters_of(canfb.Track) == {"cycles", "phase", "residual", "ok"}
    assert "conditioning" in text_of("calibrate_from_zero_crossings"), "by the function it refers to"
