# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What an experiment is, as data: rows of trainings, judged under protocols.

Every row may learn from the same number of frame passes through each sensor's network (but in the
pilot, which looks for that number); a row is a chain of trainings, where one may start from the
branches of others. `catalogue.py` holds them all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from adafusion.training import TrainConfig
from adafusion.types import UserError

if TYPE_CHECKING:
    from adafusion.experiments.study import Study

Recipe = Callable[[str], TrainConfig]  # from the name of a file in configs/

EVALUATIONS = 8  # on validation, of each training, beside that before its first batch


@dataclass(frozen=True, kw_only=True)
class Training:
    """One training of a chain: what it learns with, for how long, and whose branches it takes."""

    name: str
    config: TrainConfig  # seed, batches, init and evaluations are set when the data is known
    passes: int
    starts_from: tuple[Training, ...] = ()
    evaluations: int = EVALUATIONS

    def chain(self) -> Iterator[Training]:
        """All trainings that lead to this one, and this one last."""
        for source in self.starts_from:
            yield from source.chain()
        yield self


@dataclass(frozen=True, kw_only=True)
class Published:
    """The paper's own numbers on Oxford RobotCar, in percent; None where it prints none."""

    at_1: float | None
    at_1_percent: float | None


@dataclass(frozen=True, kw_only=True)
class Row:
    """One system of a table."""

    label: str
    training: Training  # the last of its chain
    published: Published | None = None
    reconstruction: bool = False  # neither code nor full text is public: built from what is known
    pretrained: bool = False  # the image network starts from ImageNet


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """Rows under protocols. The first protocol sorts the table and is the one of the verdicts.

    Without any, the rows are judged on validation alone: what an experiment decides for others must
    not be decided by the test set.
    """

    name: str
    words: str
    rows: tuple[Row, ...]
    protocols: tuple[str, ...]
    seeds: tuple[int, ...]
    verdicts: tuple[tuple[str, str], ...] = ()  # labels: does the first do better than the second?
    study: Study | None = None  # what is looked at beside the table
    studied: tuple[str, ...] = ()  # labels: the study needs at least one of these rows

    def only(self, labels: list[str]) -> Experiment:
        """The same experiment with some of its rows.

        UserError for a label that is none, and where the study would have nothing to look at.
        """
        if not labels:
            raise UserError(f"--rows: name some of {', '.join(row.label for row in self.rows)}")
        known = {row.label.lower() for row in self.rows}
        wanted = {label.lower() for label in labels}
        unknown = [label for label in labels if label.lower() not in known]
        if unknown:
            raise UserError(
                f"{self.name} has no row {', '.join(unknown)}: "
                "choose from " + ", ".join(row.label for row in self.rows)
            )
        if self.studied and wanted.isdisjoint(label.lower() for label in self.studied):
            raise UserError(f"{self.name} needs at least one row of {', '.join(self.studied)}")
        rows = tuple(row for row in self.rows if row.label.lower() in wanted)
        pairs = tuple(pair for pair in self.verdicts if {p.lower() for p in pair} <= wanted)
        return replace(self, rows=rows, verdicts=pairs)
