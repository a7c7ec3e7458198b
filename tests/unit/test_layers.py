# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The picture of the package as code: imports only ever point down it."""

from __future__ import annotations

import ast
from pathlib import Path

import adafusion

ROOT = Path(adafusion.__file__).parent
# A module may import from its own part and from the layers below; parts of one layer are siblings.
LAYERS: list[set[str]] = [
    {"__main__"},
    {"cli"},
    {"experiments"},
    {"doctor"},
    {"training", "evaluation", "report"},
    {"mapping"},
    {"models", "losses", "sim"},
    {"preprocess", "search", "readers"},
    {"datasets"},
    {"geometry", "config", "provenance"},
    {"files", "workers"},
    {"types", "threads"},
]
LEVEL = {part: level for level, parts in enumerate(LAYERS) for part in parts}


def part_of(path: Path) -> str:
    return path.relative_to(ROOT).with_suffix("").parts[0]


def imported_parts(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    parts = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            if node.module == "adafusion":
                parts |= {alias.name for alias in node.names if alias.name in LEVEL}
            elif node.module.startswith("adafusion."):
                parts.add(node.module.split(".")[1])
        elif isinstance(node, ast.Import):
            parts |= {a.name.split(".")[1] for a in node.names if a.name.startswith("adafusion.")}
    return parts


def test_imports_point_down() -> None:
    wrong = [
        f"{path.relative_to(ROOT)} imports {target}"
        for path in sorted(ROOT.rglob("*.py"))
        if path != ROOT / "__init__.py"
        for target in imported_parts(path) - {part_of(path)}
        if LEVEL[target] <= LEVEL[part_of(path)]
    ]
    assert not wrong, "\n".join(wrong)


def test_every_part_has_its_layer() -> None:
    parts = {part_of(path) for path in ROOT.rglob("*.py")} - {"__init__"}
    assert parts == set(LEVEL)


def test_the_synthetic_world_is_built_from_the_ground_up() -> None:
    """Town, then run, then sensing: each imports from itself and those before alone."""
    order = ["numeric", "town", "run", "sensing"]
    wrong = []
    for path in sorted((ROOT / "sim").rglob("*.py")):
        part = path.relative_to(ROOT / "sim").with_suffix("").parts[0]
        if part not in order:
            continue  # studio, simulate and what else puts the three together
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(
                "adafusion.sim."
            ):
                target = (node.module or "").split(".")[2]
                if target not in order[: order.index(part) + 1]:
                    wrong.append(f"{path.relative_to(ROOT)} imports {target}")
    assert not wrong, "\n".join(wrong)
