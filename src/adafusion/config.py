# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Nested frozen dataclasses from a YAML file and `key.sub=value` overrides, and back."""

from __future__ import annotations

import difflib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar, get_origin, get_type_hints

import cattrs
import cattrs.v
import yaml

from adafusion.files import write_text
from adafusion.types import UserError

T = TypeVar("T")


def _whole(value: Any, kind: type) -> int:
    """An int as the file means it: 47.5 is a mistake and not 47."""
    if isinstance(value, bool) or float(value) != int(float(value)):
        raise ValueError(f"{value!r} is no whole number")
    return int(float(value))


def _true_or_false(value: Any, kind: type) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{value!r} is neither true nor false")
    return value


def _from_list(kind: Any) -> Callable[[Any, Any], Any]:
    """Tuples from lists alone: a text would fall into its letters."""
    structure = _PLAIN.get_structure_hook(kind)

    def from_list(value: Any, kind: Any) -> Any:
        if isinstance(value, str):
            raise ValueError(f"{value!r} is one text; write a list, [{value}]")
        return structure(value, kind)

    return from_list


def _is_tuple(kind: Any) -> bool:
    origin: Any = get_origin(kind)
    return origin is tuple


def _strict() -> cattrs.Converter:
    converter = cattrs.Converter(forbid_extra_keys=True)
    converter.register_structure_hook(int, _whole)
    converter.register_structure_hook(bool, _true_or_false)
    return converter


_PLAIN, _CONVERTER = _strict(), _strict()
_CONVERTER.register_structure_hook_factory(_is_tuple, _from_list)


def load_config(cls: type[T], path: str | Path | None = None, overrides: Sequence[str] = ()) -> T:
    """Build the dataclass `cls` from its defaults, a YAML file, then `loss.margin=12.5` overrides.

    Raises UserError, naming the file and the key, for a misspelt key, a value of the wrong type and
    a value that the dataclass itself refuses.
    """
    values = {} if path is None else _read_yaml(Path(path))
    return _overridden(cls, values, overrides, path)


def change_config(config: T, overrides: Sequence[str]) -> T:
    """Give a configuration dataclass with some keys changed by `key.sub=value` overrides.

    Raises UserError as `load_config` does.
    """
    return _overridden(type(config), to_plain(config), overrides)


def configs_folder() -> Path:
    """Folder of the configurations and splits that come with the package."""
    package = Path(str(files("adafusion")))
    packaged, checkout = package / "configs", package.parents[1] / "configs"
    return packaged if packaged.is_dir() else checkout


def from_plain(cls: type[T], values: Mapping[str, Any]) -> T:
    """Build a nest of dataclasses from plain values, as YAML and JSON hold them.

    What is left out takes its default. Raises ValueError that names the key, for a misspelt one
    with what was probably meant.
    """
    if not isinstance(values, Mapping):
        raise ValueError(f"{cls.__name__} must hold named values, not {values!r}")
    _refuse_unknown_keys(cls, values)
    try:
        return _CONVERTER.structure(values, cls)
    except Exception as error:
        messages = cattrs.transform_error(error, path=cls.__name__, format_exception=_explain)
        # where the class as a whole refused a value, its own words name the key
        said = (message.removesuffix(f" @ {cls.__name__}") for message in messages)
        raise ValueError("; ".join(said)) from error


def to_plain(config: Any) -> dict[str, Any]:
    """Give a nest of dataclasses as values that YAML and JSON can hold."""
    return _lists(_CONVERTER.unstructure(asdict(config)))


def identity(config: Any) -> str:
    """Canonical text of a nest of dataclasses, for fingerprints: what differs from the defaults.

    So what was fingerprinted keeps its name when a later version learns a further setting, as long
    as that setting's default does what was done before.
    """
    return json.dumps(_lists(_CONVERTER.unstructure(_changed(config))), sort_keys=True)


def _changed(config: Any) -> dict[str, Any]:
    changed = {}
    for field in fields(config):
        value = getattr(config, field.name)
        default = field.default_factory() if callable(field.default_factory) else field.default
        if value != default:
            changed[field.name] = _changed(value) if is_dataclass(value) else value
    return changed


def save_config(config: Any, path: str | Path) -> None:
    """Write the effective configuration as YAML that `load_config` reads back to an equal value."""
    write_text(path, dump_config(config))


def dump_config(config: Any) -> str:
    """Give a configuration dataclass as YAML text."""
    return yaml.safe_dump(to_plain(config), sort_keys=False, default_flow_style=None, width=88)


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UserError(f"{path}: no such configuration file") from None
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise UserError(f"{path}: not readable as YAML: {error}") from error
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise UserError(f"{path}: must hold `key: value` lines, not {type(values).__name__}")
    return values


def _overridden(
    cls: type[T],
    values: dict[str, Any],
    overrides: Sequence[str],
    path: str | Path | None = None,
) -> T:
    for override in overrides:
        _apply(values, override)
    try:
        return from_plain(cls, values)
    except ValueError as error:
        where = " ".join([*([str(path)] if path else []), *overrides]) or "defaults"
        raise UserError(f"{where}: {error}") from error


def _apply(values: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    if not equals or not key:
        raise UserError(f"override {override!r}: write key=value, as in loss.margin=12.5")
    *groups, last = key.split(".")
    for group in groups:
        inner = values.setdefault(group, {})
        if not isinstance(inner, dict):
            raise UserError(f"override {override!r}: {group} is a value, not a group of keys")
        values = inner
    try:
        values[last] = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise UserError(f"override {override!r}: {text!r} is no YAML value: {error}") from error


def _refuse_unknown_keys(cls: type, values: Mapping[str, Any], group: str = "") -> None:
    """Say which key is unknown and which one was probably meant; types are checked elsewhere."""
    known = get_type_hints(cls)
    names = [f.name for f in fields(cls)]
    for key, value in values.items():
        if key not in names:
            near = difflib.get_close_matches(str(key), names, n=1)
            meant = f"did you mean {group}{near[0]}?" if near else f"choose from {', '.join(names)}"
            raise ValueError(f"unknown key {group}{key}; {meant}")
        if is_dataclass(known[key]) and isinstance(value, Mapping):
            _refuse_unknown_keys(known[key], value, f"{group}{key}.")


def _explain(error: BaseException, kind: Any) -> str:
    """What was wrong in the words of whoever refused it, a dataclass or a number's parser."""
    said = isinstance(error, (ValueError, TypeError)) and str(error)
    return str(error) if said else cattrs.v.format_exception(error, kind)


def _lists(value: Any) -> Any:
    """Tuples as lists: YAML has no tuples."""
    if isinstance(value, dict):
        return {key: _lists(inner) for key, inner in value.items()}
    if isinstance(value, (tuple, list)):
        return [_lists(inner) for inner in value]
    return value
